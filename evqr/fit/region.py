"""The image around one code: events brought onto cells that are a fixed fraction of a module."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig
from evqr.fit.model import quiet_modules
from evqr.geometry import bounds, bounds_each, module_px, module_px_each
from evqr.symbol.space import CodeSpace

GRAIN = 16
"""Regions grow in steps of so many cells, so that their buffers are used again."""


class Region(NamedTuple):
    """A rectangle of the image, cut into cells.

    Attributes
    ----------
    x, y : float [px]
        Outer corner of the first cell.
    cell : float [px]
        Size of a cell.
    height, width : int [cells]
        Of the region.
    """

    x: float
    y: float
    cell: float
    height: int
    width: int

    @property
    def from_px(self) -> NDArray[np.float64]:
        """(3, 3) map of px to cells, integers at cell centres."""
        s = 1.0 / self.cell
        return np.array([[s, 0.0, -self.x * s - 0.5], [0.0, s, -self.y * s - 0.5], [0.0, 0.0, 1.0]])

    @property
    def to_px(self) -> NDArray[np.float64]:
        """(3, 3) map of cells to px."""
        s = self.cell
        return np.array([[s, 0.0, self.x + 0.5 * s], [0.0, s, self.y + 0.5 * s], [0.0, 0.0, 1.0]])


Regions: TypeAlias = "NDArray[np.float64]"
"""Regions side by side, (N, 5): a row a `Region`."""


def regions_of(regions: Sequence[Region] | Regions) -> Regions:
    """Put regions side by side."""
    return np.asarray(regions, np.float64)


def in_cells(regions: Regions, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give poses (N, 3, 3) in px of the sensor as poses in cells of a region each."""
    found, cell = pose.copy(), regions[:, 2, None, None]
    found[:, :2] -= (regions[:, :2, None] + 0.5 * cell) * pose[:, 2:]
    found[:, :2] /= cell
    return found


def in_px(regions: Regions, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give poses (N, 3, 3) in cells of a region each in px of the sensor; their last number is 1."""
    cell = regions[:, 2, None, None]
    found = pose / pose[:, 2:, 2:]
    corner = (regions[:, :2, None] + 0.5 * cell) * found[:, 2:]
    found[:, :2] *= cell
    found[:, :2] += corner
    return found


def regions_around(
    pose: NDArray[np.float64],
    shape: NDArray[Any],
    quiet: NDArray[Any],
    cfg: AlignConfig,
    *,
    margin_px: float = 0.0,
) -> Regions:
    """Give the regions that hold a code each and its quiet zone.

    Parameters
    ----------
    pose : (N, 3, 3) float64
        Code coordinates to px.
    shape : (N, 2) int [modules]
        Rows and columns.
    quiet : (N,) int [modules]
        What the model covers of the quiet zone.
    cfg : AlignConfig
        Settings.
    margin_px : float [px]
        Around that.

    Returns
    -------
    regions : (N, 5) float64
        A row a `Region`.
    """
    begin, end = bounds_each(pose, shape, quiet + 1.0)
    cell = module_px_each(pose, shape) / cfg.cells_a_module
    grains = np.ceil((end - begin + 2.0 * margin_px) / cell[:, None] / GRAIN)
    return np.column_stack([begin - margin_px, cell, grains[:, ::-1] * GRAIN])


def region_around(
    pose: NDArray[np.float64], space: CodeSpace, cfg: AlignConfig, *, margin_px: float = 0.0
) -> Region:
    """Give the region that holds a code and its quiet zone: that of `regions_around`, to the bit."""
    left, top, right, bottom = bounds(pose, space.shape, quiet_modules(space) + 1.0)
    cell = module_px(pose, space.shape) / cfg.cells_a_module
    margin = 2.0 * margin_px
    height = math.ceil((bottom - top + margin) / cell / GRAIN) * GRAIN
    width = math.ceil((right - left + margin) / cell / GRAIN) * GRAIN
    return Region(left - margin_px, top - margin_px, cell, height, width)
