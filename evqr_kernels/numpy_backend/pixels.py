"""What each pixel saw: counts and last times; the formulas are in ``warp_backend/pixels.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evqr_kernels.numpy_backend.splat import window_of_event


def time_surface(x, y, t, weight, window_ptr, decay, surface_out) -> None:
    """Last time of each pixel and polarity, or how far that has decayed; overwrites."""
    event, window, row, column = pixels_of(x, y, window_ptr, *surface_out.shape[2:])
    surface_out[:] = -np.inf
    # of NaN it is what was there before
    np.fmax.at(surface_out, (window, (weight[event] < 0).astype(int), row, column), t[event])
    if decay > 0:
        surface_out[:] = np.exp(surface_out / surface_out.dtype.type(decay))


def event_histogram(x, y, weight, window_ptr, counts_out) -> None:
    """Count events by pixel and polarity; accumulates."""
    event, window, row, column = pixels_of(x, y, window_ptr, *counts_out.shape[2:])
    np.add.at(counts_out, (window, (weight[event] < 0).astype(int), row, column), 1)


def pixels_of(x, y, window_ptr, height, width) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Events that lie in a window and in the image: index, window, row, column."""
    half = x.dtype.type(0.5)
    column, row = np.floor(x + half), np.floor(y + half)
    window = window_of_event(window_ptr, len(x))
    use = (window >= 0) & (row >= 0) & (column >= 0) & (row < height) & (column < width)
    return np.flatnonzero(use), window[use], row[use].astype(int), column[use].astype(int)
