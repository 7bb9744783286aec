"""Deposits and the lag operator; the formulas are in ``warp_backend/lag.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, launch, ti
from evqr_kernels.taichi_backend.splat import make_transport

BLOCK = 16
"""Neighbouring cells that one thread does together."""

CHUNK = 64
"""Events that one thread takes one after another: what belongs to the window is looked up once."""


@cache
def make_deposit_events(dtype):
    """Build the kernel; one thread per (window, chunk of the longest window)."""
    transport = make_transport(dtype)

    @ti.kernel
    def deposit_events(
        x: array(dtype, 1),
        y: array(dtype, 1),
        t: array(dtype, 1),
        weight: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        motion: array(dtype, 2),
        frame: array(dtype, 2),
        deposit_out: array(dtype, 4),
    ):
        for b, chunk in ti.ndrange(motion.shape[0], (x.shape[0] + CHUNK - 1) // CHUNK):
            motion_x = motion[b, 0]
            motion_y = motion[b, 1]
            origin_x = frame[b, 0]
            origin_y = frame[b, 1]
            inverse_scale = dtype(1.0) / frame[b, 2]
            right = dtype(deposit_out.shape[3] - 1)
            bottom = dtype(deposit_out.shape[2] - 1)
            first = window_ptr[b] + chunk * CHUNK
            for e in range(first, ti.min(first + CHUNK, window_ptr[b + 1])):
                cx = transport(x[e], t[e], motion_x, origin_x, inverse_scale)
                cy = transport(y[e], t[e], motion_y, origin_y, inverse_scale)
                # written so that it is false for NaN
                if cx >= dtype(0.0) and cy >= dtype(0.0) and cx < right and cy < bottom:
                    column = int(cx)
                    row = int(cy)
                    w = weight[e]
                    image = ti.select(w < dtype(0.0), 1, 0)
                    at_right = (cx - dtype(column)) * w
                    at_left = w - at_right
                    fy = cy - dtype(row)
                    deposit_out[b, image, row, column] += at_left - fy * at_left
                    deposit_out[b, image, row, column + 1] += at_right - fy * at_right
                    deposit_out[b, image, row + 1, column] += fy * at_left
                    deposit_out[b, image, row + 1, column + 1] += fy * at_right

    return deposit_events


def deposit_events(x, y, t, weight, window_ptr, motion, frame, deposit_out) -> None:
    """Launch; accumulates.  Float atomics: sums repeat to a tolerance, not bit for bit."""
    kernel = make_deposit_events(float_of(x))
    launch(kernel, x, y, t, weight, window_ptr, motion, frame, deposit_out)


@cache
def make_lag_rows(dtype):
    """Build the pass along rows; one thread per (image, row)."""

    @ti.kernel
    def lag_rows(
        deposit: array(dtype, 4),
        deposit_idx: array(ti.i32, 1),
        direction: array(dtype, 2),
        lag: array(dtype, 2),
        taps: array(dtype, 2),
        rows_out: array(dtype, 4),
    ):
        for n, y in ti.ndrange(rows_out.shape[0], rows_out.shape[2]):
            b = deposit_idx[n]
            size = taps.shape[1]
            reach = size // 2
            width = rows_out.shape[3]
            lag_on = lag[n, 0]
            lag_off = lag[n, 1]
            for x in range(reach, width - reach):
                on = dtype(0.0)
                off = dtype(0.0)
                on_slope = dtype(0.0)
                off_slope = dtype(0.0)
                for i in range(size):
                    v = deposit[b, 0, y, x + i - reach]
                    on += taps[0, i] * v
                    on_slope += taps[1, i] * v
                    v = deposit[b, 1, y, x + i - reach]
                    off += taps[0, i] * v
                    off_slope += taps[1, i] * v
                slope = lag_on * on_slope + lag_off * off_slope
                rows_out[n, 0, y, x] = on + off - direction[n, 0] * slope
                rows_out[n, 1, y, x] = -direction[n, 1] * (lag_on * on + lag_off * off)

    return lag_rows


@cache
def make_lag_columns(dtype):
    """Build the pass along columns; launch as the rows."""

    @ti.kernel
    def lag_columns(rows: array(dtype, 4), taps: array(dtype, 2), image_out: array(dtype, 3)):
        for n, y in ti.ndrange(image_out.shape[0], image_out.shape[1]):
            size = taps.shape[1]
            reach = size // 2
            height = image_out.shape[1]
            width = image_out.shape[2]
            for x in range(width):
                total = dtype(0.0)
                if y >= reach and y < height - reach and x >= reach and x < width - reach:
                    for j in range(size):
                        total += taps[0, j] * rows[n, 0, y + j - reach, x]
                        total += taps[1, j] * rows[n, 1, y + j - reach, x]
                image_out[n, y, x] = total

    return lag_columns


def lag_operator(deposit, deposit_idx, direction, lag, taps, rows_out, image_out) -> None:
    """Launch both passes; overwrites."""
    dtype = float_of(deposit)
    launch(make_lag_rows(dtype), deposit, deposit_idx, direction, lag, taps, rows_out)
    launch(make_lag_columns(dtype), rows_out, taps, image_out)
