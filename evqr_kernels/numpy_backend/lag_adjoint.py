"""Adjoints of deposits and the lag operator; the formulas are in ``warp_backend/lag_adjoint.py``."""

from __future__ import annotations

import numpy as np

from evqr_kernels.numpy_backend.lag import filtered, shares_of


def deposit_events_adjoint(
    x, y, t, weight, window_ptr, motion, frame, adj_deposit, chunks_out, adj_weight_out, adj_motion_out,
    adj_x_out, adj_y_out
) -> None:  # fmt: skip
    """Adjoint of `deposit_events` in weights, motion and positions; overwrites."""
    for out in (adj_weight_out, adj_motion_out, adj_x_out, adj_y_out):
        out[:] = 0
    for b in range(len(motion)):
        part = slice(window_ptr[b], window_ptr[b + 1])
        events, cells = shares_of(
            x[part], y[part], t[part], weight[part], motion[b], frame[b], adj_deposit[b].shape
        )
        factor = weight[part][events] / frame[b, 2]
        for place, share, slope_x, slope_y in cells:
            adj = adj_deposit[b][place]
            adj_weight_out[part][events] += share * adj
            adj_x_out[part][events] += factor * slope_x * adj
            adj_y_out[part][events] += factor * slope_y * adj
        for axis, adj in enumerate((adj_x_out, adj_y_out)):
            adj_motion_out[b, axis] = -(t[part][events] * adj[part][events]).sum()


def lag_operator_adjoint(
    deposit_idx, direction, lag, taps, extent, adj_image, rows_out, adj_deposit_out
) -> None:
    """Adjoint of `lag_operator` in the deposit; overwrites."""
    adj_deposit_out[:] = 0
    blur, slope = taps[:, ::-1]
    reach = len(blur) // 2
    for n, (b, (height, width)) in enumerate(zip(deposit_idx, extent, strict=True)):
        own = np.s_[reach : max(height - reach, 0), reach : max(width - reach, 0)]
        inner = np.zeros((height, width), adj_image.dtype)
        inner[own] = adj_image[n][own]
        along, across = (filtered(inner, shifts, axis=0) for shifts in (blur, slope))
        for p in range(2):
            adj_deposit_out[b, p, :height, :width] += filtered(along, blur, axis=1) - lag[n, p] * (
                direction[n, 0] * filtered(along, slope, axis=1)
                + direction[n, 1] * filtered(across, blur, axis=1)
            )
