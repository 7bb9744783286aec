"""Levels of a pyramid, one below the other in an image."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def parts_of_levels(rows, extent) -> Iterator[tuple[int, int, tuple[slice, slice]]]:
    """Give window, level, and what of the image is the window's part of the level."""
    batch, levels, _ = extent.shape
    for b in range(batch):
        for k in range(levels):
            of_level = np.flatnonzero((rows[:, 0] == k) & (rows[:, 1] < extent[b, k, 0]))
            if len(of_level):
                yield b, k, (slice(of_level[0], of_level[-1] + 1), slice(0, extent[b, k, 1]))
