"""The image around one code: events brought onto cells that are a fixed fraction of a module."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.config import StageOneConfig
from evqr.model import QUIET_MODULES
from evqr.windows import Window
from evqr.workspace import Workspace

BLUR_CELLS = 0.55
"""Blur of a region's image beyond that of the deposit, whose tent has 0.41 [cells]."""

GRAIN = 16
"""Regions grow in steps of so many cells, so that their buffers are used again."""


@dataclass(frozen=True, eq=False)
class Region:
    """A rectangle of the image, cut into cells.

    Attributes
    ----------
    x, y            outer corner of the first cell [px]
    cell            size of a cell [px]
    height, width   [cells]
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


def outline(pose: NDArray[np.float64], size: int, margin: float = 0.0) -> NDArray[np.float64]:
    """Corners (4, 2) of a code of ``size`` modules in px: top-left, top-right, bottom-right, bottom-left."""
    near, far = -margin, size + margin
    corners = pose @ np.array([[near, far, far, near], [near, near, far, far], [1.0, 1.0, 1.0, 1.0]])
    return (corners[:2] / corners[2]).T


def module_px(pose: NDArray[np.float64], size: int) -> float:
    """Size of a module at the centre of a code [px]."""
    c = size / 2.0
    x, y, z = pose @ (c, c, 1.0)
    jacobian = (pose[:2, :2] - np.outer((x / z, y / z), pose[2, :2])) / z
    return math.sqrt(abs(float(np.linalg.det(jacobian))))


def region_around(
    pose: NDArray[np.float64], size: int, cfg: StageOneConfig, *, margin_px: float = 0.0
) -> Region:
    """Give the region that holds a code and its quiet zone."""
    corners = outline(pose, size, QUIET_MODULES + 1.0)
    cell = module_px(pose, size) / cfg.cells_a_module
    low, high = corners.min(axis=0) - margin_px, corners.max(axis=0) + margin_px
    width, height = (math.ceil(extent / cell / GRAIN) * GRAIN for extent in high - low)
    return Region(float(low[0]), float(low[1]), cell, height, width)


def events_near(window: Window, velocity: NDArray[np.float64], region: Region) -> Window:
    """Keep the events of a window that can reach a region: the others are dropped once for all."""
    reach = 0.5 * window.seconds * np.abs(velocity) + 3.0 * region.cell
    return window.keep(
        (window.x > region.x - reach[0])
        & (window.x < region.x + region.width * region.cell + reach[0])
        & (window.y > region.y - reach[1])
        & (window.y < region.y + region.height * region.cell + reach[1])
    )


def deposit(window: Window, velocity: NDArray[np.float64], region: Region, *, workspace: Workspace) -> Any:
    """Bring a window's events, transported to its middle, onto a region's cells (1, 2, height, width).

    The buffer is used again by the next deposit on a region of this size.
    """
    cells = workspace.buffer("deposit", (1, 2, region.height, region.width))
    workspace.clear(cells)
    workspace.backend.deposit_events(
        workspace.put(window.x),
        workspace.put(window.y),
        workspace.put(window.t),
        workspace.put(window.p),
        workspace.put(np.array([0, len(window)], np.int32)),
        workspace.put(velocity[None].astype(np.float32)),
        workspace.put(np.array([[region.x + 0.5, region.y + 0.5, region.cell]], np.float32)),
        cells,
    )
    return cells


def sharpen(
    cells: Any,
    velocity: NDArray[np.float64],
    region: Region,
    lags_px: list[tuple[float, float]],
    *,
    workspace: Workspace,
) -> Any:
    """Blur a deposit and undo the pixels' lag, for each pair of lags (ON, OFF) [px]: (N, height, width)."""
    count = len(lags_px)
    direction = velocity / max(float(np.hypot(*velocity)), 1e-9)
    images = workspace.buffer("sharp", (count, region.height, region.width))
    workspace.backend.lag_operator(
        cells,
        workspace.table(("first deposit", count), np.zeros(count, np.int32)),
        workspace.put(np.tile(direction.astype(np.float32), (count, 1))),
        workspace.put(np.array(lags_px, np.float32) / np.float32(region.cell)),
        workspace.table(("blur taps",), blur_taps(BLUR_CELLS)),
        workspace.buffer("sharp rows", (count, 2, region.height, region.width)),
        images,
    )
    return images


@functools.cache
def blur_taps(sigma: float) -> NDArray[np.float32]:
    """(2, 5): a Gaussian on five cells that sums to 1, and its slope, exact for a linear image."""
    steps = np.arange(-2, 3)
    blur = np.exp(-0.5 * (steps / sigma) ** 2)
    slope = steps * blur
    return np.stack([blur / blur.sum(), slope / (slope * steps).sum()]).astype(np.float32)
