"""The image of a region: events deposited on its cells, blurred, with the pixels' lag undone."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.events.window import Window
from evqr.fit.region import Region
from evqr.motion import Motion
from evqr.workspace import EventSlots, Images, Step, Workspace


class Deposit(Step):
    """Events, transported to the middle of their window, on cells (1, 2, height, width)."""

    def __init__(self, events: EventSlots, height: int, width: int, workspace: Workspace) -> None:
        super().__init__(workspace.backend)
        self._events = events
        self._ptr, self._motion = workspace.mirror((2,), np.int32), workspace.mirror((1, 2))
        self._frame = workspace.mirror((1, 3))
        self.cells = workspace.empty(1, 2, height, width)
        self._written: tuple[Window, Motion, Region] | None = None

    def holds(self, window: Window, motion: Motion, region: Region) -> bool:
        """Whether that is what was written last, so that the cells need not be made again."""
        last = self._written
        return last is not None and last[0] is window and last[1] is motion and last[2] is region

    def write(self, window: Window, motion: Motion, region: Region) -> None:
        """Say which events, how they move and where the cells are; the step is to be run then."""
        if not motion.uniform:
            raise NotImplementedError("events are deposited for motions of 2 parameters, got 6")
        self._written = window, motion, region
        self._ptr.write((0, len(window)))
        self._motion.write(motion.velocity * 1e-6)  # times on the device are in microseconds
        self._frame.write((region.x + 0.5, region.y + 0.5, region.cell))

    def launch(self) -> None:
        """Launch the kernels one by one."""
        events = self._events
        self._backend.clear(self.cells)
        self._backend.deposit_events(
            events.x, events.y, events.t, events.p, self._ptr.device, self._motion.device, self._frame.device,
            self.cells,
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
    window: Window, motion: Motion, region: Region, *, workspace: Workspace
) -> tuple[Deposit, bool]:
    """Make ready to deposit a window's events on a region, over the last deposit on one of this size.

    Also tells whether the step is to be run: not where that last deposit was the same.
    """
    events = workspace.events(window)
    step = workspace.once(
        ("deposit", region.height, region.width, events.capacity),
        lambda: Deposit(events, region.height, region.width, workspace),
    )
    if step.holds(window, motion, region):
        return step, False
    step.write(window, motion, region)
    return step, True


@functools.cache
def blur_taps(sigma: float) -> NDArray[np.float32]:
    """(2, 5): a Gaussian on five cells that sums to 1, and its slope, exact for a linear image."""
    steps = np.arange(-2, 3)
    blur = np.exp(-0.5 * (steps / sigma) ** 2)
    slope = steps * blur
    return np.stack([blur / blur.sum(), slope / (slope * steps).sum()]).astype(np.float32)
