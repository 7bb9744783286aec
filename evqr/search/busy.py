"""Where in a window enough happens for a code: the part of the image that is searched."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from evqr.config import FinderConfig
from evqr.events.window import Window
from evqr.fit.region import Region

TILE = 16
"""Events are counted on tiles of so many pixels a side."""

SAMPLES = 2048
"""Events that are counted, of all of them: the others lie where these lie."""

GRAIN = 32
"""Searched regions grow in steps of so many cells, so that their buffers are used again."""


def busy_region(window: Window, cfg: FinderConfig) -> Region:
    """Give the part of a window that is searched, cut into cells for the smallest modules.

    It holds every tile with clearly more events than the quietest tiles have by chance, but for tiles without
    such a neighbour, and a margin of a tile; where noise is all over the image it is the whole of it.

    Parameters
    ----------
    window : Window
        Of events.
    cfg : FinderConfig
        Settings.

    Returns
    -------
    region : Region
        Its corner lies on a corner of the cells that the whole image is cut into.
    """
    cell = cfg.smallest_module_px / cfg.cells_a_module
    most = math.ceil(window.height / cell), math.ceil(window.width / cell)
    high, wide = -(-window.height // TILE), -(-window.width // TILE)
    step = -(-len(window) // SAMPLES) or 1
    x, y = window.events.x[::step], window.events.y[::step]
    tile = (y // TILE).astype(np.int64) * wide + x // TILE
    counts = np.bincount(tile, minlength=high * wide)
    # sorted: to part them takes ten times as long where most are alike
    quiet = min(float(np.sort(counts)[: len(counts) // 4 + 1].mean()), float(counts.mean()) / 4)
    busy = counts.reshape(high, wide) > 2.0 + quiet + 3.0 * math.sqrt(quiet)
    around = np.zeros((high + 2, wide + 2), bool)
    around[1:-1, 1:-1] = busy
    busy &= around[:-2, 1:-1] | around[2:, 1:-1] | around[1:-1, :-2] | around[1:-1, 2:]
    (first_y, rows), (first_x, columns) = (
        _span(np.any(busy, axis=axis), cell, cells) for axis, cells in zip((1, 0), most, strict=True)
    )
    return Region(first_x * cell - 0.5, first_y * cell - 0.5, cell, rows, columns)


def _span(busy: NDArray[np.bool_], cell: float, most: int) -> tuple[int, int]:
    """Give the first of so many cells along an axis, and how many hold the busy tiles and a margin."""
    places = np.flatnonzero(busy)
    if not len(places):
        return 0, most
    first = max(0, math.floor((places[0] - 1) * TILE / cell))
    last = min(most, math.ceil((places[-1] + 2) * TILE / cell))
    count = min(most, -(-(last - first) // GRAIN) * GRAIN)
    return max(0, min(first - (count - (last - first)) // 2, most - count)), count
