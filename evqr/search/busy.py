"""Where in a window enough happens for a code: the part of the image that is searched."""

from __future__ import annotations

import functools
import math
import operator

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
    tile = np.multiply(y // TILE, wide, dtype=np.intp)
    tile += x // TILE
    counts = np.bincount(tile, minlength=high * wide)
    quiet = min(_quietest(counts, len(counts) // 4 + 1), len(tile) / len(counts) / 4)
    busy = counts.reshape(high, wide) > 2.0 + quiet + 3.0 * math.sqrt(quiet)
    rows = _with_neighbours(np.packbits(busy, axis=1, bitorder="little"))
    across = functools.reduce(operator.or_, rows)
    down = sum(bool(row) << k for k, row in enumerate(rows))
    (first_y, tall), (first_x, broad) = (
        _span(places, cell, cells) for places, cells in zip((down, across), most, strict=True)
    )
    return Region(first_x * cell - 0.5, first_y * cell - 0.5, cell, tall, broad)


# in Python, as what is done once a window: these are few numbers


def _quietest(counts: NDArray[np.intp], many: int) -> float:
    """Give the mean of the so many least of counts."""
    total, left = 0, many
    for value, there in enumerate(np.bincount(counts).tolist()):
        total += value * min(there, left)
        left -= min(there, left)
        if not left:
            break
    return total / many


def _with_neighbours(bits: NDArray[np.uint8]) -> list[int]:
    """Give rows of tiles as whole numbers, a bit a tile: those that have one beside, above or below."""
    rows = [int.from_bytes(row, "little") for row in map(bytes, bits)]
    return [
        row & (row << 1 | row >> 1 | above | below)
        for above, row, below in zip([0, *rows], rows, [*rows[1:], 0], strict=False)
    ]


def _span(busy: int, cell: float, most: int) -> tuple[int, int]:
    """Give the first of so many cells along an axis, and how many hold the busy tiles and a margin."""
    if not busy:
        return 0, most
    first_tile, last_tile = (busy & -busy).bit_length() - 1, busy.bit_length() - 1
    first = max(0, math.floor((first_tile - 1) * TILE / cell))
    last = min(most, math.ceil((last_tile + 2) * TILE / cell))
    count = min(most, -(-(last - first) // GRAIN) * GRAIN)
    return max(0, min(first - (count - (last - first)) // 2, most - count)), count
