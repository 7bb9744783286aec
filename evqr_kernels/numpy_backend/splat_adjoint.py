"""Adjoint of splats; the formulas are in ``warp_backend/splat_adjoint.py``."""

from __future__ import annotations

import numpy as np

from evqr_kernels.config import SplatConfig
from evqr_kernels.numpy_backend.splat import taps_of


def splat_events_adjoint(
    x, y, t, weight, window_ptr, motion, lag, frame, adj_image, chunks_out, adj_weight_out, adj_motion_out,
    cfg: SplatConfig,
) -> None:  # fmt: skip
    """Adjoint of `splat_events` in weight and motion; overwrites."""
    taps = taps_of(x, y, t, weight, window_ptr, motion, lag, frame, adj_image.shape, cfg)
    adj = np.zeros(taps.inside.shape, adj_image.dtype)
    window, row, column = (
        np.broadcast_to(k, adj.shape)[taps.inside] for k in (taps.window, taps.row, taps.column)
    )
    adj[taps.inside] = adj_image[window, row, column]
    lag_x, lag_y = taps.lag_x, taps.lag_y

    def total(along, across):
        return np.einsum("eyx,ey,ex->e", adj, across, along)

    adj_weight_out[:] = 0
    adj_weight_out[taps.event] = total(taps.g_x - lag_x * taps.s_x, taps.g_y) - total(
        lag_y * taps.g_x, taps.s_y
    )
    slope_x = total(taps.s_x - lag_x * taps.c_x, taps.g_y) - total(lag_y * taps.s_x, taps.s_y)
    slope_y = total(taps.g_x - lag_x * taps.s_x, taps.s_y) - total(lag_y * taps.g_x, taps.c_y)
    window = taps.window[:, 0, 0]
    factor = weight[taps.event] * t[taps.event] / frame[window, 2]
    adj_x, adj_y, dx, dy = factor * slope_x, factor * slope_y, taps.dx, taps.dy
    adj_motion = np.stack([adj_x, adj_y, adj_x * dx, adj_x * dy, adj_y * dx, adj_y * dy], axis=1)
    adj_motion_out[:] = 0
    np.add.at(adj_motion_out, window, adj_motion[:, : adj_motion_out.shape[1]])
