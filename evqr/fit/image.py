"""The image of a region: events deposited on its cells, blurred, with the pixels' lag undone."""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.events.batch import EventBatch
from evqr.fit.region import Region
from evqr.motion import Motion
from evqr.workspace import EventRoom, Images, Step, Workspace


class Deposit(Step):
    """Events, transported to the middle of their windows, on cells (B, 2, height, width)."""

    def __init__(self, events: EventRoom, count: int, height: int, width: int, workspace: Workspace) -> None:
        super().__init__(workspace.backend)
        self._events = events
        self._ptr, self._extent = (workspace.mirror((count, 2), np.int32) for _ in range(2))
        self._t_ref, self._motion = workspace.mirror((count,), np.int32), workspace.mirror((count, 2))
        self._frame = workspace.mirror((count, 3))
        self._frame.host[:] = 1.0  # no cell is without a size, of rows without a window either
        self.cells = workspace.empty(count, 2, height, width)
        self._written: tuple[Any, ...] = ()

    def holds(self, batch: EventBatch, motions: Sequence[Motion], regions: Sequence[Region]) -> bool:
        """Whether that is what was written last, so that the cells need not be made again."""
        given = *batch.windows, *motions, *regions
        return len(given) == len(self._written) and all(map(operator.is_, given, self._written))

    def write(self, batch: EventBatch, motions: Sequence[Motion], regions: Sequence[Region]) -> None:
        """Say which events, how they move and where the cells are; the step is to be run then.

        There may be fewer windows than there is room for; those cells stay empty.
        """
        if not all(motion.uniform for motion in motions):
            raise NotImplementedError("events are deposited for motions of 2 parameters, got 6")
        self._written = *batch.windows, *motions, *regions
        count = len(batch)
        self._ptr.host[:count], self._ptr.host[count:] = batch.window_ptr, 0
        self._t_ref.host[:count] = batch.t_ref_us
        for k, (motion, region) in enumerate(zip(motions, regions, strict=True)):
            self._motion.host[k] = motion.velocity * 1e-6  # times on the device are in microseconds
            self._frame.host[k] = region.x + 0.5, region.y + 0.5, region.cell
            self._extent.host[k] = region.height, region.width
        for mirror in (self._ptr, self._t_ref, self._motion, self._frame, self._extent):
            mirror.push()

    def launch(self) -> None:
        """Launch the kernels one by one."""
        events = self._events
        self._backend.clear(self.cells)
        self._backend.deposit_packed_events(
            events.x, events.y, events.stamp, self._ptr.device, self._t_ref.device, self._motion.device,
            self._frame.device, self._extent.device, self.cells,
        )  # fmt: skip


class Sharpen(Step):
    """Blurs a deposit and undoes the pixels' lag, for N pairs of lags: images (N, height, width)."""

    def __init__(self, cells: Any, count: int, blur_cells: float, workspace: Workspace) -> None:
        super().__init__(workspace.backend)
        height, width = cells.shape[2:]
        self._cells = cells
        self._direction, self._lag = workspace.mirror((count, 2)), workspace.mirror((count, 2))
        self._scratch = workspace.scratch("lag_operator", N=count, Y=height, X=width)
        self._first = workspace.put(np.zeros(count, np.int32))
        self._taps = workspace.put(blur_taps(blur_cells))
        self._extent = workspace.put(np.full((count, 2), (height, width), np.int32))
        self.images = Images(workspace.empty(count, height, width))

    def write(self, motion: Motion, region: Region, lags_px: Sequence[tuple[float, float]]) -> None:
        """Say which lags (ON, OFF) along which motion."""
        self._direction.write(motion.direction)
        self._lag.write(np.divide(lags_px, region.cell))

    def launch(self) -> None:
        """Launch the kernels one by one."""
        self._backend.lag_operator(
            self._cells, self._first, self._direction.device, self._lag.device, self._taps, self._extent,
            *self._scratch, self.images.device,
        )  # fmt: skip


def depositing(
    batch: EventBatch, motions: Sequence[Motion], regions: Sequence[Region], *, workspace: Workspace
) -> tuple[Deposit, bool]:
    """Make ready to deposit windows' events, each on a region: over the last deposit on any of that size.

    Also tells whether the step is to be run: not where that last deposit was the same.
    """
    events, count = workspace.events(batch), 1 << (len(batch) - 1).bit_length()
    height = max(region.height for region in regions)
    width = max(region.width for region in regions)
    step = workspace.once(
        ("deposit", count, height, width, events.capacity),
        lambda: Deposit(events, count, height, width, workspace),
    )
    if step.holds(batch, motions, regions):
        return step, False
    step.write(batch, motions, regions)
    return step, True


@functools.cache
def blur_taps(sigma: float) -> NDArray[np.float32]:
    """(2, 5): a Gaussian on five cells that sums to 1, and its slope, exact for a linear image."""
    steps = np.arange(-2, 3)
    blur = np.exp(-0.5 * (steps / sigma) ** 2)
    slope = steps * blur
    return np.stack([blur / blur.sum(), slope / (slope * steps).sum()]).astype(np.float32)
