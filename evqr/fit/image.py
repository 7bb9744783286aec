"""Images of regions: events deposited on their cells, blurred, with the pixels' lag undone.

Regions of one launch may differ in size: arrays are as large as the largest, the cells of each begin at the
first, and what lies beyond them is 0.
"""

from __future__ import annotations

import functools
import operator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evqr.events.batch import EventBatch
from evqr.events.window import Window
from evqr.fit.region import GRAIN, Regions
from evqr.motion import Motions
from evqr.workspace import EventRoom, Images, Keeper, Staging, Step, Workspace

COARSE_GRAIN = 4 * GRAIN
"""Arrays that several regions share grow in steps of so many cells."""


class Cells(Keeper):
    """Cells (N, 2, height, width) for events of N windows, one grid for ON and one for OFF events each.

    Attributes
    ----------
    device : (N, 2, height, width) float32, on the device
        The cells.
    """

    def __init__(self, count: int, height: int, width: int, workspace: Workspace) -> None:
        self.device = workspace.empty(count, 2, height, width)
        self._held: tuple[tuple[Window, ...], Motions, Regions] | None = None

    def take(self, batch: EventBatch, motions: Motions, regions: Regions) -> bool:
        """Tell whether these events are to be deposited: not where the same were the last time."""
        held, self._held = self._held, (batch.windows, motions, regions)
        return held is None or not (
            len(held[0]) == len(batch)
            and all(map(operator.is_, held[0], batch.windows))
            and np.array_equal(held[1].velocity, motions.velocity)
            and np.array_equal(held[2], regions)
        )


class Deposit(Step):
    """Events, transported to the middle of their windows, on cells."""

    def __init__(
        self, events: EventRoom, cells: Cells, workspace: Workspace, staging: Staging | None = None
    ) -> None:
        super().__init__(workspace, staging, events)
        count = cells.device.shape[0]
        self._events, self._cells = events, cells.device
        self._ptr = self._staging.input((count, 2), np.int32)
        self._t_ref = self._staging.input((count,), np.int32)
        self._motion = self._staging.input((count, 2))
        # no cell is without a size, of rows without a window either
        self._frame = self._staging.input((count, 3), value=1.0)
        self._extent = self._staging.input((count, 2), np.int32)

    def write(self, batch: EventBatch, motions: Motions, regions: Regions) -> None:
        """Say which events, how they move and where the cells are, a window a row."""
        self._ptr.fill(batch.window_ptr)
        self._t_ref.fill(batch.t_ref_us)
        # times on the device are in microseconds
        self._motion.fill(motions.velocity * 1e-6)
        self._frame.host[: len(regions)] = regions[:, :3] + (0.5, 0.5, 0.0)
        self._extent.fill(regions[:, 3:])

    def launch(self) -> None:
        """Launch the kernels one by one."""
        events = self._events
        self._backend.clear(self._cells)
        self._backend.deposit_packed_events(
            events.x, events.y, events.stamp, self._ptr.device, self._t_ref.device, self._motion.device,
            self._frame.device, self._extent.device, self._cells,
        )  # fmt: skip


class Sharpen(Step):
    """Blurs deposits and undoes the pixels' lag, for some pairs of lags each: images (N, height, width).

    Image n is of the cells of window ``n // each``.
    """

    def __init__(
        self, cells: Cells, blur_cells: float, workspace: Workspace, staging: Staging | None = None,
        each: int = 1,
    ) -> None:  # fmt: skip
        super().__init__(workspace, staging)
        windows, _, height, width = cells.device.shape
        count = windows * each
        self._cells, self._each = cells.device, each
        self._direction, self._lag = self._staging.input((count, 2)), self._staging.input((count, 2))
        self._scratch = workspace.scratch("lag_operator", N=count, Y=height, X=width)
        self._which = workspace.put(np.arange(windows, dtype=np.int32).repeat(each))
        self._extent = self._staging.input((count, 2), np.int32)
        self._taps = workspace.put(blur_taps(blur_cells))
        self.images = Images(workspace.empty(count, height, width))

    def write(
        self,
        motions: Motions,
        regions: Regions,
        lags_px: ArrayLike,
    ) -> None:
        """Say which lags (ON, OFF) along which motion, those of each window together."""
        each = self._each
        self._direction.fill(_repeated(motions.direction, each))
        self._lag.fill(np.asarray(lags_px).reshape(-1, 2) / _repeated(regions[:, 2:3], each))
        self._extent.fill(_repeated(regions[:, 3:], each))

    def launch(self) -> None:
        """Launch the kernels one by one."""
        self._backend.lag_operator(
            self._cells, self._which, self._direction.device, self._lag.device, self._taps,
            self._extent.device, *self._scratch, self.images.device,
        )  # fmt: skip


def _repeated(rows: NDArray[Any], each: int) -> NDArray[Any]:
    return rows if each == 1 else rows.repeat(each, axis=0)


def cells_for(regions: Regions, *, workspace: Workspace) -> Cells:
    """Give the cells for windows' events on a region each, which the next on as large ones overwrite."""
    count = count_for(len(regions))
    if count == 1:
        height, width = map(int, regions[0, 3:].tolist())
    else:
        largest = regions[:, 3:].max(axis=0)
        height, width = (np.ceil(largest / COARSE_GRAIN).astype(int) * COARSE_GRAIN).tolist()
    return workspace.once(("cells", count, height, width), lambda: Cells(count, height, width, workspace))


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
