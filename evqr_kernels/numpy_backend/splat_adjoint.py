"""Adjoint of splats; the formulas are in ``warp_backend/splat_adjoint.py``."""

from __future__ import annotations

import numpy as np

from evqr_kernels.config import SplatConfig
from evqr_kernels.numpy_backend.splat import taps_of


def splat_events_adjoint(
    x, y, t, weight, window_ptr, motion, lag, frame, adj_image, chunks_out, adj_weight_out, adj_motion_out,
    adj_x_out, adj_y_out, cfg: SplatConfig,
) -> None:  # fmt: skip
    """Adjoint of `splat_events` in weight, motion and position; overwrites."""
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
    along_x, along_y = (weight[taps.event] / frame[window, 2] * slope for slope in (slope_x, slope_y))
    seen = t[taps.event]
    # of (x, y) - t v(x, y), with v affine
    field = motion[window, 2:] if motion.shape[1] == 6 else np.zeros((len(window), 4), motion.dtype)
    xx, xy, yx, yy = seen * field.T
    adj_x_out[:] = adj_y_out[:] = 0
    adj_x_out[taps.event] = yx * along_y - (1 - xx) * along_x
    adj_y_out[taps.event] = xy * along_x - (1 - yy) * along_y
    adj_x, adj_y, dx, dy = seen * along_x, seen * along_y, taps.dx, taps.dy
    adj_motion = np.stack([adj_x, adj_y, adj_x * dx, adj_x * dy, adj_y * dx, adj_y * dy], axis=1)
    adj_motion_out[:] = 0
    np.add.at(adj_motion_out, window, adj_motion[:, : adj_motion_out.shape[1]])
