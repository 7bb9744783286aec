"""The motion-compensated events of windows on cells of every size that is searched, in one image a window.

The levels of a pyramid lie one below the other, with zeros between them, which templates may hang over.  So
one launch works on all levels of all windows, whatever their number.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.config import FinderConfig
from evqr.events.batch import EventBatch
from evqr.fit.image import Cells, Deposit, Sharpen
from evqr.fit.region import Region
from evqr.motion import Motion
from evqr.symbol.space import closed
from evqr.workspace import EventRoom, Images, Staging, Step, Workspace

BLUR_CELLS = 0.55
"""Blur of the finest image beyond that of the deposit [cells]."""


@dataclass(frozen=True)
class Level:
    """A level of a pyramid.

    Attributes
    ----------
    cell : float [px]
        Size of a cell.
    module_px : float [px]
        Size of the modules that are searched on it.
    top : int [cells]
        Row of the image in which it begins.
    rows, columns : int [cells]
        Its size.
    """

    cell: float
    module_px: float
    top: int
    rows: int
    columns: int


@functools.lru_cache(maxsize=64)
def levels_of(rows: int, columns: int, cfg: FinderConfig) -> tuple[Level, ...]:
    """Give the levels over so many cells of the finest: as many as hold a template.

    Each answers for half a step of module size on either side.
    """
    smallest, largest, ratio = cfg.smallest_module_px, cfg.largest_module_px, cfg.scale_ratio
    side = 2 * cfg.half + 1
    levels: list[Level] = []
    top = cfg.half
    for k in range(1 + round(math.log(largest / smallest) / math.log(ratio))):
        if min(rows, columns) < side:
            break
        module_px = smallest * ratio**k
        levels.append(Level(module_px / cfg.cells_a_module, module_px, top, rows, columns))
        top += rows + cfg.half
        rows, columns = math.ceil(rows / ratio), math.ceil(columns / ratio)
    return tuple(levels)


@dataclass(frozen=True, eq=False)
class Layout:
    """Where levels lie in the image of a pyramid, as the kernels take it.

    Attributes
    ----------
    rows : (Y - 2 half, 2) int32
        Of each row of a response the level, or -1, and which row of the level it is.
    sizes : (K, 2) float32 [px]
        Of each level the size of a cell, and of a module.
    """

    rows: NDArray[np.int32]
    sizes: NDArray[np.float32]


@functools.lru_cache(maxsize=64)
def layout_of(levels: tuple[Level, ...], cfg: FinderConfig) -> Layout:
    """Give where levels lie."""
    last = levels[-1]
    rows = np.full((last.top + last.rows - cfg.half, 2), -1, np.int32)
    for k, level in enumerate(levels):
        part = rows[level.top - cfg.half :][: level.rows]
        part[:, 0], part[:, 1] = k, np.arange(level.rows)
    sizes = np.array([(level.cell, level.module_px) for level in levels], np.float32)
    return Layout(closed(rows), closed(sizes))


class Pyramid(Step):
    """The levels over regions of windows.

    Attributes
    ----------
    levels : tuple of Level
        Finest first.
    layout : Layout
        Where they lie.
    images : Images
        One image a window, all of its levels; until the next search in a region of this size.
    busy : (B,) float32, on the device
        Cells of the finest level that are not 0.
    parts : (B, K, 3) int32
        First row, rows and columns of the part of its image that a window's level and the zeros around it
        take.  A pose is relative to it: where the level lies depends on the windows beside.
    """

    def __init__(
        self,
        events: EventRoom,
        count: int,
        rows: int,
        columns: int,
        cfg: FinderConfig,
        workspace: Workspace,
        staging: Staging,
    ) -> None:
        super().__init__(workspace, staging)
        self._cfg, self._count, self._workspace = cfg, count, workspace
        self.levels = levels_of(rows, columns, cfg)
        self.layout = layout_of(self.levels, cfg)
        self.regions: list[Region] = []
        self.parts = np.zeros((count, len(self.levels), 3), np.int32)
        self._deepest = np.zeros(count, np.intp)
        self._corners = np.zeros((0, 2))
        height, width = len(self.layout.rows) + 2 * cfg.half, columns + 2 * cfg.half
        self._whole = workspace.empty(count, height, width)
        workspace.backend.clear(self._whole)
        self.images = Images(self._whole)
        self.busy = workspace.empty(count)
        cells = Cells(count, rows, columns, workspace)
        self._deposit = Deposit(events, cells, workspace, staging)
        self._sharpen = Sharpen(cells, BLUR_CELLS, workspace, staging)

    def write(
        self,
        batch: EventBatch,
        motions: Sequence[Motion],
        regions: Sequence[Region],
        lags_px: Sequence[tuple[float, float] | None],
    ) -> None:
        """Say which events, how they move, where the finest cells are, and which lag is undone."""
        on, off = self._cfg.lag_cells
        cells = [region.cell for region in regions]
        lags = [lag or (on * cell, off * cell) for lag, cell in zip(lags_px, cells, strict=True)]
        self.regions = list(regions)
        self._corners = np.array([(region.x, region.y) for region in regions])
        around = 2 * self._cfg.half
        self.parts[...] = 0
        for k, region in enumerate(regions):
            own = levels_of(region.height, region.width, self._cfg)
            self._deepest[k] = max(len(own) - 1, 0)
            for n, (level, place) in enumerate(zip(own, self.levels, strict=False)):
                self.parts[k, n] = place.top - self._cfg.half, level.rows + around, level.columns + around
        self._deposit.write(batch, motions, regions)
        self._sharpen.write(motions, regions, lags)

    def launch(self) -> None:
        """Launch the kernels one by one."""
        backend, cfg, workspace = self._backend, self._cfg, self._workspace
        self._deposit.launch()
        self._sharpen.launch()
        finer = self._sharpen.images.device
        for k, level in enumerate(self.levels):
            image = self._whole[:, level.top : level.top + level.rows, cfg.half : cfg.half + level.columns]
            if k == 0:
                scratch = workspace.scratch("clip_outliers", B=self._count, Y=level.rows)
                backend.clip_outliers(finer, cfg.clip, *scratch, image, self.busy)
            else:
                sizes = {"Y": finer.shape[1], "X": finer.shape[2], "ratio": cfg.scale_ratio}
                scratch = workspace.scratch("reduce_image", B=self._count, **sizes)
                backend.reduce_image(finer, cfg.scale_ratio, *scratch, image)
            finer = image

    def from_px(self, window: NDArray[np.intp], level: NDArray[np.intp]) -> NDArray[np.float64]:
        """Give maps (N, 3, 3) of px to cells of `parts`, for the windows and levels (N,) of some poses."""
        cell, shift = self._maps(window, level)
        maps = np.zeros((len(cell), 3, 3))
        maps[:, 0, 0] = maps[:, 1, 1] = 1.0 / cell
        maps[:, :2, 2] = shift
        maps[:, 2, 2] = 1.0
        return maps

    def to_px(self, window: NDArray[np.intp], level: NDArray[np.intp]) -> NDArray[np.float64]:
        """Give maps (N, 3, 3) of cells of `parts` to px."""
        cell, shift = self._maps(window, level)
        maps = np.zeros((len(cell), 3, 3))
        maps[:, 0, 0] = maps[:, 1, 1] = cell
        maps[:, :2, 2] = -shift * cell[:, None]
        maps[:, 2, 2] = 1.0
        return maps

    def _maps(
        self, window: NDArray[np.intp], level: NDArray[np.intp]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Size of a cell (N,) [px], and where the first pixel lies (N, 2) [cells]."""
        cell = self.layout.sizes[level, 0].astype(np.float64)
        return cell, self._cfg.half - 0.5 - self._corners[window] / cell[:, None]

    def level_for(
        self, window: NDArray[np.intp], pose: NDArray[np.float64], cells_a_module: float
    ) -> NDArray[np.intp]:
        """Give the levels (N,) on which modules of affine poses (N, 3, 3) [px] have so many cells, nearly."""
        size = np.sqrt(np.abs(pose[:, 0, 0] * pose[:, 1, 1] - pose[:, 0, 1] * pose[:, 1, 0]))
        steps = np.log(size / cells_a_module / self.levels[0].cell) / math.log(self._cfg.scale_ratio)
        return np.clip(np.round(steps), 0, self._deepest[window]).astype(np.intp)
