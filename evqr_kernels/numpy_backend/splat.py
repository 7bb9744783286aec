"""Events to images; the formulas are in ``warp_backend/splat.py``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evqr_kernels.config import SplatConfig


def bin_events(x, y, weight, window_ptr, reduction, image_out) -> None:
    """Count events into pixels of ``reduction`` px; accumulates."""
    scale = x.dtype.type(1.0 / reduction)
    half = x.dtype.type(0.5)
    _, height, width = image_out.shape
    column = np.floor((x + half) * scale)
    row = np.floor((y + half) * scale)
    window = window_of_event(window_ptr, len(x))
    use = (window >= 0) & (row >= 0) & (column >= 0) & (row < height) & (column < width)
    np.add.at(image_out, (window[use], row[use].astype(int), column[use].astype(int)), weight[use])


def splat_events(x, y, t, weight, window_ptr, motion, lag, frame, image_out, cfg: SplatConfig) -> None:
    """Scatter transported events as splats; accumulates."""
    taps = taps_of(x, y, t, weight, window_ptr, motion, lag, frame, image_out.shape, cfg)
    ahead = taps.g_x - taps.lag_x * taps.s_x
    value = (
        ahead[:, None, :] * taps.g_y[:, :, None]
        - taps.lag_y[:, None] * taps.g_x[:, None, :] * taps.s_y[:, :, None]
    )
    value = weight[taps.event, None, None] * value
    inside = np.broadcast_to(taps.inside, value.shape)
    window, row, column = (
        np.broadcast_to(k, value.shape)[inside] for k in (taps.window, taps.row, taps.column)
    )
    np.add.at(image_out, (window, row, column), value[inside])


def splat_profile(r: NDArray, cfg: SplatConfig) -> tuple[NDArray, NDArray, NDArray]:
    """g, g' and g'' of `SplatConfig` at r; zero outside the radius."""
    if cfg.kind == "bilinear":
        inside = np.abs(r) < 1
        values = (np.where(inside, 1 - np.abs(r), 0), np.where(inside, -np.sign(r), 0), np.zeros_like(r))
        return values[0].astype(r.dtype), values[1].astype(r.dtype), values[2]
    inverse_variance, inverse_radius_sq = 1.0 / cfg.epsilon_px**2, 1.0 / cfg.radius_px**2
    q = 1.0 - r * r * inverse_radius_sq
    gauss = np.where(q > 0, cfg.norm * np.exp(-0.5 * r * r * inverse_variance), 0.0)
    rate = q * inverse_variance + 4.0 * inverse_radius_sq
    second = (r * r * inverse_variance - 1.0) * q * rate
    second += 2.0 * r * r * inverse_radius_sq * (2.0 * q * inverse_variance + 4.0 * inverse_radius_sq)
    values = (gauss * q * q, -r * gauss * q * rate, gauss * second)
    return values[0].astype(r.dtype), values[1].astype(r.dtype), values[2].astype(r.dtype)


class Taps(NamedTuple):
    """The T x T pixels around each event that can touch the image: V events, T taps an axis."""

    event: NDArray  # (V,) index of the event
    window: NDArray  # (V, 1, 1)
    row: NDArray  # (V, T, 1)
    column: NDArray  # (V, 1, T)
    inside: NDArray  # (V, T, T)
    g_x: NDArray  # (V, T) profile along x, its slope and its curvature
    s_x: NDArray
    c_x: NDArray
    g_y: NDArray
    s_y: NDArray
    c_y: NDArray
    lag_x: NDArray  # (V, 1) lag times direction of the motion
    lag_y: NDArray
    dx: NDArray  # (V,) from the middle of the image [px]
    dy: NDArray


def taps_of(x, y, t, weight, window_ptr, motion, lag, frame, shape, cfg: SplatConfig) -> Taps:
    """Find the pixels around each event, where it is at the reference time."""
    _, height, width = shape
    half = x.dtype.type(0.5)
    window = window_of_event(window_ptr, len(x))
    origin, scale = frame[window, :2], frame[window, 2]
    dx = x - (origin[:, 0] - half + half * scale * x.dtype.type(width))
    dy = y - (origin[:, 1] - half + half * scale * x.dtype.type(height))
    m = _velocity(motion[window], dx, dy)
    cx = (x - t * m[:, 0] - origin[:, 0] + half) / scale - half
    cy = (y - t * m[:, 1] - origin[:, 1] + half) / scale - half
    margin = 2 * cfg.reach + 1
    # also false for NaN
    near = (cx > -margin) & (cy > -margin) & (cx < width + margin) & (cy < height + margin)
    event = np.flatnonzero(near & (window >= 0))
    window, m, cx, cy = window[event], m[event], cx[event], cy[event]

    around = np.arange(-cfg.reach, cfg.reach + 1)
    column = np.floor(cx + half).astype(int)[:, None] + around
    row = np.floor(cy + half).astype(int)[:, None] + around
    speed = np.hypot(m[:, 0], m[:, 1])
    lag_px = np.where(weight[event] < 0, lag[window, 1], lag[window, 0])
    lag_px = np.divide(lag_px, speed, out=lag_px.copy(), where=speed > 0)
    row, column = row[:, :, None], column[:, None, :]
    return Taps(
        event,
        window[:, None, None],
        row,
        column,
        (row >= 0) & (row < height) & (column >= 0) & (column < width),
        *splat_profile((column[:, 0] - cx[:, None]).astype(x.dtype), cfg),
        *splat_profile((row[:, :, 0] - cy[:, None]).astype(x.dtype), cfg),
        (lag_px * m[:, 0])[:, None],
        (lag_px * m[:, 1])[:, None],
        dx[event],
        dy[event],
    )


def _velocity(motion: NDArray, dx: NDArray, dy: NDArray) -> NDArray:
    """Velocity (E, 2) at (dx, dy) from the middle of the image, of motions (E, 2) or (E, 6)."""
    if motion.shape[1] == 2:
        return motion
    field = motion[:, 2:].reshape(-1, 2, 2)
    return motion[:, :2] + field[:, :, 0] * dx[:, None] + field[:, :, 1] * dy[:, None]


def window_of_event(window_ptr: NDArray, count: int) -> NDArray:
    """Window of each event; -1 of one that none names."""
    window = np.searchsorted(window_ptr, np.arange(count), side="right") - 1
    return np.where(window < len(window_ptr) - 1, window, -1)
