"""Deposits and the lag operator; the formulas are in ``warp_backend/lag.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def deposit_events(x, y, t, weight, window_ptr, motion, frame, deposit_out) -> None:
    """Share events among the cells around them, ON and OFF apart; accumulates."""
    for b in range(len(motion)):
        part = slice(window_ptr[b], window_ptr[b + 1])
        deposit_window(x[part], y[part], t[part], weight[part], motion[b], frame[b], deposit_out[b])


def deposit_window(x, y, t, weight, motion, frame, deposit_out) -> None:
    """Share the events of one window among the cells (2, Y, X) around them; accumulates."""
    events, cells = shares_of(x, y, t, weight, motion, frame, deposit_out.shape)
    for place, share, _, _ in cells:
        np.add.at(deposit_out, place, weight[events] * share)


def lag_operator(deposit, deposit_idx, direction, lag, taps, extent, rows_out, image_out) -> None:
    """Blur deposits and undo the lag; overwrites."""
    image_out[:] = 0
    blur, slope = taps
    reach = len(blur) // 2
    for n, (b, (height, width)) in enumerate(zip(deposit_idx, extent, strict=True)):
        own = np.s_[reach : max(height - reach, 0), reach : max(width - reach, 0)]
        for p in range(2):
            cells = deposit[b, p, :height, :width]
            across = filtered(cells, blur, axis=1)
            along = across - lag[n, p] * direction[n, 0] * filtered(cells, slope, axis=1)
            image = filtered(along, blur, axis=0) - lag[n, p] * direction[n, 1] * filtered(
                across, slope, axis=0
            )
            image_out[n][own] += image[own]


def shares_of(x, y, t, weight, motion, frame, shape) -> tuple[NDArray, list]:
    """Events of a window that lie between cells, and what each of the four around them gets.

    Of a cell: (image, row, column), share, and how the share grows with the event's column and row.
    """
    _, height, width = shape
    half = motion.dtype.type(0.5)
    cx = (x - t * motion[0] - frame[0] + half) / frame[2] - half
    cy = (y - t * motion[1] - frame[1] + half) / frame[2] - half
    # also false for NaN
    events = np.flatnonzero((cx >= 0) & (cy >= 0) & (cx < width - 1) & (cy < height - 1))
    cx, cy = cx[events], cy[events]
    column, row = cx.astype(int), cy.astype(int)
    fx, fy = cx - column, cy - row
    image = (weight[events] < 0).astype(int)
    return events, [
        ((image, row + dy, column + dx), share_y * share_x, share_y * (2 * dx - 1), share_x * (2 * dy - 1))
        for dy, share_y in ((0, 1 - fy), (1, fy))
        for dx, share_x in ((0, 1 - fx), (1, fx))
    ]


def filtered(image: NDArray, taps: NDArray, *, axis: int) -> NDArray:
    """Correlate along one axis; what lies nearer to the border than the taps reach is not to be used."""
    reach = len(taps) // 2
    total = np.zeros_like(image)
    for k, tap in enumerate(taps):
        total += tap * np.roll(image, reach - k, axis=axis)
    return total
