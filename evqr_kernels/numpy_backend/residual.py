"""Residual of the brightness change; the formulas are in ``warp_backend/residual.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def brightness_residual(luminance, events_image, motion, residual_out) -> None:
    """Slope of the luminance along the motion, plus the events' image; overwrites."""
    dx, dy = _slope(luminance, axis=2), _slope(luminance, axis=1)
    residual_out[:] = dx * motion[:, 0, None, None] + dy * motion[:, 1, None, None] + events_image


def brightness_residual_adjoint(
    luminance, motion, adj_residual, rows_out, adj_luminance_out, adj_motion_out
) -> None:
    """Adjoint of `brightness_residual` in luminance and motion; overwrites."""
    adj_x = _slope_adjoint(adj_residual * motion[:, 0, None, None], axis=2)
    adj_y = _slope_adjoint(adj_residual * motion[:, 1, None, None], axis=1)
    adj_luminance_out[:] = adj_x + adj_y
    adj_motion_out[:, 0] = (adj_residual * _slope(luminance, axis=2)).sum(axis=(1, 2))
    adj_motion_out[:, 1] = (adj_residual * _slope(luminance, axis=1)).sum(axis=(1, 2))


def _slope(image: NDArray, axis: int) -> NDArray:
    """Central differences; beyond the border lies the border's own pixel."""
    moved = np.moveaxis(image, axis, -1)
    padded = np.concatenate([moved[..., :1], moved, moved[..., -1:]], axis=-1)
    return np.moveaxis(image.dtype.type(0.5) * (padded[..., 2:] - padded[..., :-2]), -1, axis)


def _slope_adjoint(adj: NDArray, axis: int) -> NDArray:
    """Transpose of `_slope`; beyond the border lies minus the border's own pixel."""
    moved = np.moveaxis(adj, axis, -1)
    padded = np.concatenate([-moved[..., :1], moved, -moved[..., -1:]], axis=-1)
    return np.moveaxis(adj.dtype.type(0.5) * (padded[..., :-2] - padded[..., 2:]), -1, axis)
