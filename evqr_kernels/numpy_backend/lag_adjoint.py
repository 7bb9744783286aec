"""Adjoints of deposits and the lag operator; the formulas are in ``warp_backend/lag_adjoint.py``."""

from __future__ import annotations

import numpy as np

from evqr_kernels.numpy_backend.lag import filtered, shares_of


def deposit_events_adjoint(x, y, t, weight, window_ptr, motion, frame, adj_deposit, adj_weight_out) -> None:
    """Adjoint of `deposit_events` in the weights; overwrites."""
    adj_weight_out[:] = 0
    for b in range(len(motion)):
        events, cells = shares_of(x, y, t, weight, window_ptr, motion, frame, b, adj_deposit.shape)
        for place, share in cells:
            adj_weight_out[events] += share * adj_deposit[b][place]


def lag_operator_adjoint(deposit_idx, direction, lag, taps, adj_image, rows_out, adj_deposit_out) -> None:
    """Adjoint of `lag_operator` in the deposit; overwrites."""
    adj_deposit_out[:] = 0
    blur, slope = taps[:, ::-1]
    reach = len(blur) // 2
    inner = np.zeros_like(adj_image)
    inner[:, reach:-reach, reach:-reach] = adj_image[:, reach:-reach, reach:-reach]
    for n, b in enumerate(deposit_idx):
        along, across = (filtered(inner[n], shifts, axis=0) for shifts in (blur, slope))
        rows_out[n] = along, across
        for p in range(2):
            adj_deposit_out[b, p] += filtered(along, blur, axis=1) - lag[n, p] * (
                direction[n, 0] * filtered(along, slope, axis=1)
                + direction[n, 1] * filtered(across, blur, axis=1)
            )
