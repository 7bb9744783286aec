"""Deposits and the lag operator; the formulas are in ``warp_backend/lag.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.splat import events_a_thread, make_add, owners
from evqr_kernels.taichi_backend.transport import make_transport


@cache
def make_deposit_events(dtype, shared: bool, alone: bool):
    """Build the kernel; one thread per (window, chunk of the longest window)."""
    add = make_add(shared)
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
        chunk: ti.i32,
        deposit_out: array(dtype, 4),
    ):
        ti.loop_config(serialize=alone)
        for b, k in ti.ndrange(motion.shape[0], (x.shape[0] + chunk - 1) // chunk):
            motion_x = motion[b, 0]
            motion_y = motion[b, 1]
            origin_x = frame[b, 0]
            origin_y = frame[b, 1]
            inverse_scale = dtype(1.0) / frame[b, 2]
            right = dtype(deposit_out.shape[3] - 1)
            bottom = dtype(deposit_out.shape[2] - 1)
            first = window_ptr[b] + k * chunk
            for e in range(first, ti.min(first + chunk, window_ptr[b + 1])):
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
                    add(deposit_out, ti.Vector([b, image, row, column]), at_left - fy * at_left)
                    add(deposit_out, ti.Vector([b, image, row, column + 1]), at_right - fy * at_right)
                    add(deposit_out, ti.Vector([b, image, row + 1, column]), fy * at_left)
                    add(deposit_out, ti.Vector([b, image, row + 1, column + 1]), fy * at_right)

    return deposit_events


def deposit_events(x, y, t, weight, window_ptr, motion, frame, deposit_out) -> None:
    """Launch; accumulates.  Float atomics on GPUs: sums repeat to a tolerance there, not bit for bit."""
    kernel = make_deposit_events(float_of(x), *owners(x, window_ptr))
    launch(kernel, x, y, t, weight, window_ptr, motion, frame, events_a_thread(x), deposit_out)


@cache
def make_lag_rows(dtype, size: int):
    """Build the pass along rows for so many taps; one thread per (image, row).

    A thread slides a window of as many cells as there are taps along the row, in registers: of both deposits
    together, and of both weighted with their lags.
    """
    reach = size // 2

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
            direction_x = direction[n, 0]
            direction_y = direction[n, 1]
            lag_on = lag[n, 0]
            lag_off = lag[n, 1]
            blur = ti.Vector([taps[0, i] for i in range(size)])
            slope = ti.Vector([taps[1, i] for i in range(size)])
            both = ti.Vector.zero(dtype, size)
            lagging = ti.Vector.zero(dtype, size)
            for x in range(rows_out.shape[3]):
                for i in ti.static(range(size - 1)):
                    both[i] = both[i + 1]
                    lagging[i] = lagging[i + 1]
                on = deposit[b, 0, y, x]
                off = deposit[b, 1, y, x]
                both[size - 1] = on + off
                lagging[size - 1] = lag_on * on + lag_off * off
                if x >= size - 1:
                    rows_out[n, 0, y, x - reach] = blur.dot(both) - direction_x * slope.dot(lagging)
                    rows_out[n, 1, y, x - reach] = -direction_y * blur.dot(lagging)

    return lag_rows


@cache
def make_lag_columns(dtype, size: int):
    """Build the pass along columns for so many taps; one thread per (image, column), as the rows."""
    reach = size // 2

    @ti.kernel
    def lag_columns(rows: array(dtype, 4), taps: array(dtype, 2), image_out: array(dtype, 3)):
        for n, x in ti.ndrange(image_out.shape[0], image_out.shape[2]):
            height = image_out.shape[1]
            inside = x >= reach and x < image_out.shape[2] - reach
            blur = ti.Vector([taps[0, i] for i in range(size)])
            slope = ti.Vector([taps[1, i] for i in range(size)])
            along = ti.Vector.zero(dtype, size)
            across = ti.Vector.zero(dtype, size)
            for y in range(ti.min(reach, height)):
                image_out[n, y, x] = dtype(0.0)
                image_out[n, height - 1 - y, x] = dtype(0.0)
            for y in range(height):
                for i in ti.static(range(size - 1)):
                    along[i] = along[i + 1]
                    across[i] = across[i + 1]
                along[size - 1] = rows[n, 0, y, x]
                across[size - 1] = rows[n, 1, y, x]
                if y >= size - 1:
                    total = dtype(0.0)
                    if inside:
                        total = blur.dot(along) + slope.dot(across)
                    image_out[n, y - reach, x] = total

    return lag_columns


def lag_operator(deposit, deposit_idx, direction, lag, taps, rows_out, image_out) -> None:
    """Launch both passes; overwrites."""
    dtype, size = float_of(deposit), taps.shape[1]
    launch(make_lag_rows(dtype, size), deposit, deposit_idx, direction, lag, taps, rows_out)
    launch(make_lag_columns(dtype, size), rows_out, taps, image_out)
