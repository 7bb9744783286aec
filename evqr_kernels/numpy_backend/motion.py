"""Displacement between two images; the formula is in ``warp_backend/motion.py``."""

from __future__ import annotations

import numpy as np


def motion_correlation(first, second, radius, rows_out, correlation_out) -> None:
    """Correlate two images over a square of shifts; overwrites."""
    _, height, width = first.shape
    padded = np.pad(second, ((0, 0), (radius, radius), (radius, radius)))
    for j in range(2 * radius + 1):
        for i in range(2 * radius + 1):
            rows_out[:, :, j, i] = (first * padded[:, j : j + height, i : i + width]).sum(axis=2)
    correlation_out[:] = rows_out[..., : 2 * radius + 1].sum(axis=1)
