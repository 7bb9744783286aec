"""Images of regions: events deposited on their cells, blurred, with the pixels' lag undone.

Regions of one launch may differ in size: arrays are as large as the largest, the cells of each begin at the
first, and what lies beyond them is 0.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evqr.events.batch import EventBatch
from evqr.fit.region import GRAIN, Region
from evqr.motion import Motion
from evqr.workspace import EventRoom, Images, Step, Workspace

COARSE_GRAIN = 4 * GRAIN
"""Arrays that several regions share grow in steps of so many cells."""


class Deposit(Step):
    """Events, transported to the middle of their windows, on cells (N, 2, height, width)."""

    def __init__(self, events: EventRoom, count: int, height: int, width: int, workspace: Workspace) -> None:
        super().__init__(workspace.backend)
        self._events = events
        self._ptr, self._t_ref = workspace.mirror((count, 2), np.int32), workspace.mirror((count,), np.int32)
        self._motion, self._frame = workspace.mirror((count, 2)), workspace.mirror((count, 3))
        self._extent = workspace.mirror((count, 2), np.int32)
        self._frame.host[:] = 1.0  # no cell is without a size, of rows without a window either
        self.cells = workspace.empty(count, 2, height, width)
        self._written: tuple[Any, ...] = ()

    @property
    def extent(self) -> Any:
        """Rows and columns (N, 2) of each region, on the device."""
        return self._extent.device

    def write(self, batch: EventBatch, motions: Sequence[Motion], regions: Sequence[Region]) -> bool:
        """Say which events, how they move and where the cells are, a window a row.

        Tells whether the step is to be run: not where it was the same the last time.
        """
        written = (*batch.windows, *motions, *regions)
        if len(written) == len(self._written) and all(map(_is, written, self._written)):
            return False
        self._written = written
        for motion in motions:
            if not motion.uniform:
                raise NotImplementedError("events are deposited for motions of 2 parameters, got 6")
        self._ptr.fill(batch.window_ptr)
        self._t_ref.fill(batch.t_ref_us)
        # times on the device are in microseconds
        self._motion.fill(np.array([motion.parameters for motion in motions]) * 1e-6)
        frame = [(region.x + 0.5, region.y + 0.5, region.cell) for region in regions]
        self._frame.host[: len(frame)] = frame
        self._frame.push()
        self._extent.fill([(region.height, region.width) for region in regions])
        return True

    def launch(self) -> None:
        """Launch the kernels one by one."""
        events = self._events
        self._backend.clear(self.cells)
        self._backend.deposit_packed_events(
            events.x, events.y, events.stamp, self._ptr.device, self._t_ref.device, self._motion.device,
            self._frame.device, self._extent.device, self.cells,
        )  # fmt: skip


def _is(one: object, other: object) -> bool:
    return one is other


class Sharpen(Step):
    """Blurs deposits and undoes the pixels' lag, for some pairs of lags each: images (N, height, width).

    Image n is of deposit ``n // each``.
    """

    def __init__(self, deposit: Deposit, blur_cells: float, workspace: Workspace, each: int = 1) -> None:
        super().__init__(workspace.backend)
        windows, _, height, width = deposit.cells.shape
        count = windows * each
        self._deposit, self._each = deposit, each
        self._direction, self._lag = workspace.mirror((count, 2)), workspace.mirror((count, 2))
        self._scratch = workspace.scratch("lag_operator", N=count, Y=height, X=width)
        self._which = workspace.put(np.arange(windows, dtype=np.int32).repeat(each))
        self._extent = None if each == 1 else workspace.mirror((count, 2), np.int32)
        self._taps = workspace.put(blur_taps(blur_cells))
        self.images = Images(workspace.empty(count, height, width))

    def write(
        self,
        motions: Sequence[Motion],
        regions: Sequence[Region],
        lags_px: ArrayLike,
    ) -> None:
        """Say which lags (ON, OFF) along which motion, those of each window together."""
        each = self._each
        self._direction.fill(_repeated([motion.direction for motion in motions], each))
        cells = _repeated([(region.cell,) for region in regions], each)
        self._lag.fill(np.array(lags_px).reshape(-1, 2) / cells)
        if self._extent is not None:
            self._extent.fill(_repeated([(region.height, region.width) for region in regions], each))

    def launch(self) -> None:
        """Launch the kernels one by one."""
        extent = self._deposit.extent if self._extent is None else self._extent.device
        self._backend.lag_operator(
            self._deposit.cells, self._which, self._direction.device, self._lag.device, self._taps, extent,
            *self._scratch, self.images.device,
        )  # fmt: skip


def _repeated(rows: ArrayLike, each: int) -> NDArray[Any]:
    values = np.array(rows)
    return values if each == 1 else values.repeat(each, axis=0)


def depositing(
    batch: EventBatch, motions: Sequence[Motion], regions: Sequence[Region], *, workspace: Workspace
) -> tuple[Deposit, bool]:
    """Make ready to deposit windows' events on a region each, over the last deposit on as large ones.

    Also tells whether the step is to be run: not where that last deposit was the same.
    """
    events = workspace.events(batch)
    count = count_for(len(regions))
    height, width = regions[0].height, regions[0].width
    if count > 1:
        height = -(-max(region.height for region in regions) // COARSE_GRAIN) * COARSE_GRAIN
        width = -(-max(region.width for region in regions) // COARSE_GRAIN) * COARSE_GRAIN
    step = workspace.once(
        ("deposit", count, height, width, events.capacity),
        lambda: Deposit(events, count, height, width, workspace),
    )
    return step, step.write(batch, motions, regions)


def count_for(count: int) -> int:
    """Give how many rows steps have for so many windows: a power of two, so that they are used again."""
    return 1 << max(count - 1, 0).bit_length()


@functools.cache
def blur_taps(sigma: float) -> NDArray[np.float32]:
    """(2, 5): a Gaussian on five cells that sums to 1, and its slope, exact for a linear image."""
    steps = np.arange(-2, 3)
    blur = np.exp(-0.5 * (steps / sigma) ** 2)
    slope = steps * blur
    return np.stack([blur / blur.sum(), slope / (slope * steps).sum()]).astype(np.float32)
