"""The motion-compensated events of windows on cells of every size that is searched, in one image a window.

The levels of a pyramid lie one below the other, with zeros between them, which templates may hang over.  So
one launch works on all levels of all windows, whatever their number.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.config import FinderConfig
from evqr.events.batch import EventBatch
from evqr.fit.image import Cells, Deposit, Sharpen
from evqr.fit.region import Region, regions_of
from evqr.motion import Motion, Motions
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


@functools.lru_cache(maxsize=256)
def parts_of(levels: tuple[Level, ...], own: tuple[Level, ...], half: int) -> NDArray[np.float64]:
    """Give for each level the part (K, 4) that a window with levels of its own has of the image there.

    First row, rows, columns, and the size of a cell; what would be on a coarser level than the window has is
    on its coarsest.
    """
    placed = [*zip(levels, own, strict=False)]
    placed += placed[-1:] * (len(levels) - len(placed))
    rows = [(at.top - half, its.rows + 2 * half, its.columns + 2 * half, its.cell) for at, its in placed]
    return closed(np.array(rows))


class Places:
    """Where poses are in the images of a pyramid: each in a part of one, a level and the zeros around it.

    A pose is relative to its part: where a level lies depends on the windows beside.

    Attributes
    ----------
    image_idx : (N,) int32
        The window of each.
    image_part : (N, 3) int32
        First row, rows and columns of the part.
    """

    def __init__(self, window: NDArray[np.intp], level: NDArray[np.float64]) -> None:
        self.image_idx = window.astype(np.int32)
        self.image_part = level[:, :3].astype(np.int32)
        self._cell, self._shift = level[:, 3, None, None], level[:, 4:, None]

    def in_cells(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """Give poses (N, 3, 3) in px of the sensor as such in cells of their parts."""
        made = pose.copy()
        made[:, :2] = pose[:, :2] / self._cell + self._shift * pose[:, 2:]
        return made

    def in_px(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """Give poses (N, 3, 3) in cells as such in px, the last number of each 1."""
        made = pose / pose[:, 2:, 2:]
        made[:, :2] = (made[:, :2] - self._shift * made[:, 2:]) * self._cell
        return made


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
        # of every level of every window its part of the image, the size of a cell, and where the corner lies
        self._levels = np.ones((count, len(self.levels), 6))
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
        for k, region in enumerate(regions):
            own, levels = levels_of(region.height, region.width, self._cfg), self._levels[k]
            levels[:, :4] = parts_of(self.levels, own or self.levels[:1], self._cfg.half)
            levels[:, 4] = self._cfg.half - 0.5 - region.x / levels[:, 3]
            levels[:, 5] = self._cfg.half - 0.5 - region.y / levels[:, 3]
        moving, placed = Motions.of(motions), regions_of(regions)
        self._deposit.write(batch, moving, placed)
        self._sharpen.write(moving, placed, lags)

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

    @property
    def finest(self) -> Any:
        """The finest level (B, rows, columns), on the device."""
        half, level = self._cfg.half, self.levels[0]
        return self._whole[:, level.top : level.top + level.rows, half : half + level.columns]

    def finest_of(self, windows: Sequence[int]) -> list[NDArray[np.float32]]:
        """Give the finest level of some windows, (rows, columns) of their regions, on the host."""
        half, top, whole = self._cfg.half, self.levels[0].top, self._workspace.get(self._whole)
        return [
            whole[k, top : top + self.regions[k].height, half : half + self.regions[k].width] for k in windows
        ]

    def places(self, window: NDArray[np.intp], pose: NDArray[np.float64], cells_a_module: float) -> Places:
        """Give the places of affine poses (N, 3, 3) [px] in windows (N,).

        Each is on the level on which its modules have so many cells, nearly.
        """
        size = np.abs(pose[:, 0, 0] * pose[:, 1, 1] - pose[:, 0, 1] * pose[:, 1, 0])
        steps = np.log(size) * (0.5 / math.log(self._cfg.scale_ratio))
        first = math.log(cells_a_module * self.levels[0].cell) / math.log(self._cfg.scale_ratio)
        level = np.minimum(np.maximum(np.round(steps - first), 0.0), len(self.levels) - 1)
        of_each = window * len(self.levels) + level.astype(np.intp)
        return Places(window, self._levels.reshape(-1, 6)[of_each])
