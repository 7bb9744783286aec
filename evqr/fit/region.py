"""The image around one code: events brought onto cells that are a fixed fraction of a module."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig
from evqr.fit.model import quiet_modules
from evqr.geometry import bounds_each, module_px_each
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
    scale = 1.0 / regions[:, 2:3]
    off = -regions[:, :2] * scale - 0.5
    found = pose.copy()
    found[:, :2] = scale[:, :, None] * pose[:, :2] + off[:, :, None] * pose[:, 2:]
    return found


def in_px(regions: Regions, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give poses (N, 3, 3) in cells of a region each in px of the sensor; their last number is 1."""
    scale = regions[:, 2:3]
    off = regions[:, :2] + 0.5 * scale
    found = pose.copy()
    found[:, :2] = scale[:, :, None] * pose[:, :2] + off[:, :, None] * pose[:, 2:]
    found /= pose[:, 2:, 2:]
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
    found = np.empty((len(pose), 5))
    found[:, :2] = begin - margin_px
    cell = found[:, 2] = module_px_each(pose, shape) / cfg.cells_a_module
    grains = np.ceil((end - begin + 2.0 * margin_px) / cell[:, None] / GRAIN)
    found[:, 3:] = grains[:, ::-1] * GRAIN
    return found


def region_around(
    pose: NDArray[np.float64], space: CodeSpace, cfg: AlignConfig, *, margin_px: float = 0.0
) -> Region:
    """Give the region that holds a code and its quiet zone."""
    shape, quiet = np.array([space.shape]), np.array([quiet_modules(space)])
    x, y, cell, height, width = regions_around(pose[None], shape, quiet, cfg, margin_px=margin_px)[0].tolist()
    return Region(x, y, cell, int(height), int(width))
