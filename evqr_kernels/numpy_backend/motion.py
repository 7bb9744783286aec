"""Displacement between two images; the formulas are in ``warp_backend/motion.py``."""

from __future__ import annotations

import numpy as np


def motion_correlation(
    images_inout, clip, radius, found_out, rows_out, energy_rows_out, correlation_out, energy_out
) -> None:
    """Correlate pairs of images over a square of shifts; clips them in place, overwrites the rest."""
    np.clip(images_inout, -clip, clip, out=images_inout)
    first, second = images_inout[:, 0], images_inout[:, 1]
    _, height, width = first.shape
    padded = np.pad(second, ((0, 0), (radius, radius), (radius, radius)))
    for j in range(2 * radius + 1):
        for i in range(2 * radius + 1):
            rows_out[:, :, j, i] = (first * padded[:, j : j + height, i : i + width]).sum(axis=2)
    correlation_out[:] = rows_out[..., : 2 * radius + 1].sum(axis=1)
    energy_rows_out[..., 0], energy_rows_out[..., 1] = (first**2).sum(axis=2), (second**2).sum(axis=2)
    energy_out[:] = energy_rows_out.sum(axis=1)


def surface_peak(surface, smoother, rows_out, smooth_out, peak_out) -> None:
    """Blur surfaces and find their highest interior point to a fraction of a step; overwrites."""
    rows_out[:] = smoother @ surface
    smooth_out[:] = rows_out @ smoother.T
    size = surface.shape[1]
    y, x = (g.ravel() for g in np.mgrid[-1:2, -1:2])
    fit = np.linalg.pinv(np.stack([np.ones(9), x, y, x * x, x * y, y * y], axis=1))
    for b, smooth in enumerate(smooth_out):
        inner = smooth[1:-1, 1:-1]
        row, column = (int(k) + 1 for k in np.unravel_index(inner.argmax(), inner.shape))
        c = fit @ smooth[row - 1 : row + 2, column - 1 : column + 2].ravel()
        hessian = np.array([[2.0 * c[3], c[4]], [c[4], 2.0 * c[5]]])
        offset = np.zeros(2)
        if hessian[0, 0] < 0.0 and np.linalg.det(hessian) > 0.0:
            offset = np.clip(-np.linalg.solve(hessian, c[1:3]), -1.0, 1.0)
        peak_out[b] = column - size // 2 + offset[0], row - size // 2 + offset[1], smooth[row, column]
