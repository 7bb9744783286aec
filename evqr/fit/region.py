"""The image around one code: events brought onto cells that are a fixed fraction of a module."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig
from evqr.fit.model import quiet_modules
from evqr.geometry import bounds, module_px
from evqr.symbol.space import CodeSpace

GRAIN = 16
"""Regions grow in steps of so many cells, so that their buffers are used again."""


Pose = list[list[float]]
"""A pose (3, 3) as Python has it."""


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

    # in Python, as what is done once a window: these are few numbers

    def in_cells(self, pose: Pose) -> Pose:
        """Give a pose (3, 3) in px of the sensor as one in cells."""
        s = 1.0 / self.cell
        x, y = -self.x * s - 0.5, -self.y * s - 0.5
        (a, b, c), (d, e, f), (g, h, i) = pose
        first = [s * a + x * g, s * b + x * h, s * c + x * i]
        return [first, [s * d + y * g, s * e + y * h, s * f + y * i], [g, h, i]]

    def in_px(self, pose: Pose) -> Pose:
        """Give a pose (3, 3) in cells as one in px of the sensor, whose last number is 1."""
        s = self.cell
        x, y = self.x + 0.5 * s, self.y + 0.5 * s
        (a, b, c), (d, e, f), (g, h, i) = pose
        return [
            [(s * a + x * g) / i, (s * b + x * h) / i, (s * c + x * i) / i],
            [(s * d + y * g) / i, (s * e + y * h) / i, (s * f + y * i) / i],
            [g / i, h / i, 1.0],
        ]


def region_around(
    pose: NDArray[np.float64], space: CodeSpace, cfg: AlignConfig, *, margin_px: float = 0.0
) -> Region:
    """Give the region that holds a code and its quiet zone."""
    left, top, right, bottom = bounds(pose, space.shape, quiet_modules(space) + 1.0)
    cell = module_px(pose, space.shape) / cfg.cells_a_module
    margin = 2.0 * margin_px
    height = math.ceil((bottom - top + margin) / cell / GRAIN) * GRAIN
    width = math.ceil((right - left + margin) / cell / GRAIN) * GRAIN
    return Region(left - margin_px, top - margin_px, cell, height, width)
