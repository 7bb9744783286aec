"""Displacement between two images; the formulas are in ``warp_backend/motion.py``."""

from __future__ import annotations

import numpy as np

from evqr_kernels.operations.images import NEWTON_STEPS, taps_beside


def motion_correlation(
    images_inout,
    quiet,
    clip,
    radius,
    found_out,
    rows_out,
    energy_rows_out,
    busy_out,
    correlation_out,
    energy_out,
) -> None:
    """Correlate pairs of images over a square of shifts; clips them in place, overwrites the rest."""
    energy_rows_out[..., 2:] = (images_inout**2).sum(axis=3).transpose(0, 2, 1)
    energy = energy_rows_out[..., 2:].sum(axis=(1, 2))
    busy_out[:] = (energy < quiet[:, 0]) | (energy > quiet[:, 1])
    np.clip(images_inout, -clip, clip, out=images_inout)
    energy_rows_out[..., :2] = (images_inout**2).sum(axis=3).transpose(0, 2, 1)
    energy_out[:] = energy_rows_out[..., :2].sum(axis=1)
    correlation_out[:] = 0.0
    for b in np.flatnonzero(busy_out):
        first, second = images_inout[b]
        height, width = first.shape
        padded = np.pad(second, radius)
        for j in range(2 * radius + 1):
            for i in range(2 * radius + 1):
                rows_out[b, :, j, i] = (first * padded[j : j + height, i : i + width]).sum(axis=1)
        correlation_out[b] = rows_out[b, ..., : 2 * radius + 1].sum(axis=0)


def surface_peak(surface, half, filled_out, rows_out, peak_out) -> None:
    """Blur surfaces and find their highest point to a fraction of a step; overwrites."""
    size, middle = surface.shape[1], surface.shape[1] // 2
    filled_out[:] = surface
    beside = sum(surface[:, middle + j, middle + i] for j, i in ((0, -1), (0, 1), (-1, 0), (1, 0)))
    filled_out[:, middle, middle] = np.maximum(surface[:, middle, middle], beside / 4)
    reach = taps_beside(half)
    inside = slice(reach, size - reach)
    kernel = _window(np.arange(-reach, reach + 1, dtype=surface.dtype), half)[0]
    for b, one in enumerate(filled_out):
        rows = np.stack([one[:, k : size - 2 * reach + k] for k in range(2 * reach + 1)], axis=2) @ kernel
        rows_out[b, :size, inside] = rows
        smooth = np.stack([rows[k : size - 2 * reach + k] for k in range(2 * reach + 1)], axis=2) @ kernel
        row, column = (int(k) + reach for k in np.unravel_index(smooth.argmax(), smooth.shape))
        at, x, y, height = np.arange(size, dtype=surface.dtype), 0.0, 0.0, 0.0
        for step in range(NEWTON_STEPS + 1):
            across, down = column - middle + x, row - middle + y
            if step >= 2 and across * across + down * down >= 1.0:
                one[middle, middle] = _value_at(surface[b], middle + 2.0 * across, middle + 2.0 * down)
            (k, kx, kxx), (g, gy, gyy) = _window(at - column - x, half), _window(at - row - y, half)
            height, slope_x, slope_y = g @ one @ k, g @ one @ kx, gy @ one @ k
            xx, xy, yy = g @ one @ kxx, gy @ one @ kx, gyy @ one @ k
            determinant = xx * yy - xy * xy
            if step == NEWTON_STEPS or not (xx < 0.0 and determinant > 0.0):
                break
            x = np.clip(x - (yy * slope_x - xy * slope_y) / determinant, -1.0, 1.0)
            y = np.clip(y - (xx * slope_y - xy * slope_x) / determinant, -1.0, 1.0)
        peak_out[b] = column - middle + x, row - middle + y, height / half**2


def _value_at(image, x: float, y: float) -> float:
    """Interpolate between four entries; beyond the border it is as there."""
    at_y, at_x = (int(np.clip(np.floor(v), 0, len(image) - 2)) for v in (y, x))
    x, y = (float(np.clip(v, 0.0, 1.0)) for v in (x - at_x, y - at_y))
    (a, b), (c, d) = image[at_y : at_y + 2, at_x : at_x + 2]
    return (1.0 - y) * ((1.0 - x) * a + x * b) + y * ((1.0 - x) * c + x * d)


def _window(r, half):
    """Give k(r) = cos^2(pi r / 2 half), and its first and second derivatives by the point that r is from."""
    turn = np.pi / half
    inside, angle = np.abs(r) < half, turn * r
    cos, sin = np.cos(angle), np.sin(angle)
    return inside * 0.5 * (1.0 + cos), inside * 0.5 * turn * sin, inside * -0.5 * turn * turn * cos
