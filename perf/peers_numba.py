"""The kernels' loops in numba, one thread; its compiler may reorder sums, as that of the kernels may.

numba is imported when a peer is prepared: it need not be installed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from problems import Problem

FLAGS = {"contract", "reassoc", "nsz"}


@cache
def _compile(function: Callable[..., Any]) -> Callable[..., Any]:
    import numba

    return numba.njit(fastmath=FLAGS, nogil=True)(function)


def _bin_events(x, y, weight, window_ptr, image):
    half = x.dtype.type(0.5)
    for b in range(len(window_ptr) - 1):
        for e in range(window_ptr[b], window_ptr[b + 1]):
            column, row = x[e] + half, y[e] + half
            if column >= 0 and row >= 0 and column < image.shape[2] and row < image.shape[1]:
                image[b, int(row), int(column)] += weight[e]


def bin_events(problem: Problem) -> Callable[[], list[Any]]:
    x, y, weight, window_ptr, _ = problem.inputs
    image, kernel = problem.outputs[0].copy(), _compile(_bin_events)

    def run() -> list[Any]:
        kernel(x, y, weight, window_ptr, image)
        return [image]

    return run


def _splat_events(
    x, y, t, weight, window_ptr, motion, lag, frame, image, gauss_at, variance, radius_sq, taps
):
    one, half = x.dtype.type(1.0), x.dtype.type(0.5)
    reach, height, width = len(gauss_at) // 2, image.shape[1], image.shape[2]
    for b in range(len(window_ptr) - 1):
        vx, vy, inverse_scale = motion[b, 0], motion[b, 1], one / frame[b, 2]
        speed = math.sqrt(vx * vx + vy * vy)
        inverse_speed = one / speed if speed > 0 else one
        for e in range(window_ptr[b], window_ptr[b + 1]):
            c = (
                (x[e] - t[e] * vx - frame[b, 0] + half) * inverse_scale - half,
                (y[e] - t[e] * vy - frame[b, 1] + half) * inverse_scale - half,
            )
            if not (
                c[0] > -reach - 1 and c[1] > -reach - 1 and c[0] < width + reach and c[1] < height + reach
            ):
                continue
            column, row = math.floor(c[0] + half), math.floor(c[1] + half)
            for axis in range(2):
                f = c[axis] - (column if axis == 0 else row)
                up = math.exp(f / variance)
                down = one / up
                right = math.exp(-half * f * f / variance)
                left = right
                for k in range(reach + 1):
                    taps[axis, 0, reach + k] = right * gauss_at[reach + k]
                    taps[axis, 0, reach - k] = left * gauss_at[reach - k]
                    right *= up
                    left *= down
                for k in range(2 * reach + 1):
                    r = x.dtype.type(k - reach) - f
                    q = max(one - r * r / radius_sq, one - one)
                    gauss = taps[axis, 0, k]
                    taps[axis, 0, k] = gauss * q * q
                    taps[axis, 1, k] = -r * gauss * q * (q / variance + (one + one + one + one) / radius_sq)
            w = weight[e]
            lag_px = (lag[b, 0] if w > 0 else lag[b, 1]) * inverse_speed
            for k in range(2 * reach + 1):
                taps[2, 0, k] = w * (taps[0, 0, k] - lag_px * vx * taps[0, 1, k])
                taps[2, 1, k] = -w * lag_px * vy * taps[0, 0, k]
            for j in range(max(0, reach - row), min(2 * reach + 1, height + reach - row)):
                for k in range(max(0, reach - column), min(2 * reach + 1, width + reach - column)):
                    image[b, row + j - reach, column + k - reach] += (
                        taps[1, 0, j] * taps[2, 0, k] + taps[1, 1, j] * taps[2, 1, k]
                    )


def splat_events(problem: Problem) -> Callable[[], list[Any]]:
    image, (cfg,) = problem.outputs[0].copy(), problem.tail
    dtype, kernel = image.dtype.type, _compile(_splat_events)
    gauss_at = np.array([cfg.norm * cfg.gauss(k) for k in range(-cfg.reach, cfg.reach + 1)], dtype)
    taps = np.zeros((3, 2, 2 * cfg.reach + 1), dtype)
    arguments = image, gauss_at, dtype(cfg.epsilon_px**2), dtype(cfg.radius_px**2), taps

    def run() -> list[Any]:
        kernel(*problem.inputs, *arguments)
        return [image]

    return run


def _render_code(grid, to_grid, outside, image):
    one, zero = grid.dtype.type(1.0), grid.dtype.type(0.0)
    rows, columns = grid.shape[1], grid.shape[2]
    for b in range(image.shape[0]):
        w, beyond = to_grid[b], outside[b]
        for y in range(image.shape[1]):
            at_u, at_v = w[1] * grid.dtype.type(y) + w[2], w[4] * grid.dtype.type(y) + w[5]
            for x in range(image.shape[2]):
                u, v = w[0] * grid.dtype.type(x) + at_u, w[3] * grid.dtype.type(x) + at_v
                value = beyond
                if u > -1 and v > -1 and u < columns and v < rows:
                    i, j = math.floor(u), math.floor(v)
                    f, g = u - grid.dtype.type(i), v - grid.dtype.type(j)
                    if i >= 0 and j >= 0 and i + 1 < columns and j + 1 < rows:
                        above = (one - f) * grid[b, j, i] + f * grid[b, j, i + 1]
                        below = (one - f) * grid[b, j + 1, i] + f * grid[b, j + 1, i + 1]
                        value = (one - g) * above + g * below
                    else:
                        value = zero
                        for k in range(2):
                            for m in range(2):
                                node = beyond
                                if 0 <= j + k < rows and 0 <= i + m < columns:
                                    node = grid[b, j + k, i + m]
                                value += (g if k else one - g) * (f if m else one - f) * node
                image[b, y, x] = value


def render_code(problem: Problem) -> Callable[[], list[Any]]:
    grid, to_grid, outside, _ = problem.inputs
    image, kernel = np.empty_like(problem.outputs[0]), _compile(_render_code)

    def run() -> list[Any]:
        kernel(grid, to_grid, outside, image)
        return [image]

    return run
