"""Deposits and the lag operator; the formulas are in ``warp_backend/lag.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import (
    array,
    float_of,
    is_on_cpu,
    row_of,
    row_of_plane,
    run_at,
    ti,
    variant,
)
from evqr_kernels.taichi_backend.launches import clear, launch
from evqr_kernels.taichi_backend.splat import chunks_of, events_of, length_of_chunk, make_add, owners
from evqr_kernels.taichi_backend.transport import make_transport


@cache
def make_deposit_events(dtype, shared: bool, alone: bool):
    """Build the kernel; one thread per (window, chunk of events)."""
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
        chunks: ti.i32,
        deposit_out: array(dtype, 4),
    ):
        ti.loop_config(serialize=alone)
        for b, k in ti.ndrange(motion.shape[0], chunks):
            if ti.static(not shared):
                if k > 0:
                    continue
            motion_x = motion[b, 0]
            motion_y = motion[b, 1]
            origin_x = frame[b, 0]
            origin_y = frame[b, 1]
            inverse_scale = dtype(1.0) / frame[b, 2]
            right = dtype(deposit_out.shape[3] - 1)
            bottom = dtype(deposit_out.shape[2] - 1)
            begin, end = events_of(window_ptr, b, x.shape[0])
            length = length_of_chunk(end - begin, chunks, shared)
            first = begin + k * length
            for e in range(first, ti.min(first + length, end)):
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
    threads = owners(x, window_ptr)
    kernel = make_deposit_events(float_of(x), *threads)
    launch(
        kernel, x, y, t, weight, window_ptr, motion, frame, chunks_of(x, window_ptr, *threads), deposit_out
    )


@cache
def make_lag_rows(dtype, size: int, block: int):
    """Build the pass along rows for so many taps; one thread per (image, row)."""
    reach = size // 2

    @ti.kernel
    def lag_rows(
        deposit: array(dtype, 4),
        deposit_idx: array(ti.i32, 1),
        direction: array(dtype, 2),
        lag: array(dtype, 2),
        taps: array(dtype, 2),
        extent: array(ti.i32, 2),
        rows_out: array(dtype, 4),
    ):
        for n, y in ti.ndrange(rows_out.shape[0], rows_out.shape[2]):
            if y >= extent[n, 0]:
                continue
            b = ti.max(ti.min(deposit_idx[n], deposit.shape[0] - 1), 0)
            direction_x = direction[n, 0]
            direction_y = direction[n, 1]
            lag_on = lag[n, 0]
            lag_off = lag[n, 1]
            right = ti.min(extent[n, 1], deposit.shape[3]) - reach
            for k in range((ti.max(right - reach, 0) + block - 1) // block):
                # the last block ends with the row; what it shares with the one before is written twice, alike
                x = ti.max(ti.min(reach + block * k, right - block), reach)
                along = ti.Vector.zero(dtype, block)
                across = ti.Vector.zero(dtype, block)
                for i in range(size):
                    blur = taps[0, i]
                    along_on = blur - direction_x * lag_on * taps[1, i]
                    along_off = blur - direction_x * lag_off * taps[1, i]
                    across_on = -direction_y * lag_on * blur
                    across_off = -direction_y * lag_off * blur
                    on_at = run_at(row_of_plane(deposit, b, 0, y) + x + i - reach)
                    off_at = run_at(row_of_plane(deposit, b, 1, y) + x + i - reach)
                    for p in ti.static(range(block)):
                        along[p] += along_on * deposit[0, 0, 0, on_at + p]
                        across[p] += across_on * deposit[0, 0, 0, on_at + p]
                    for p in ti.static(range(block)):
                        along[p] += along_off * deposit[0, 0, 0, off_at + p]
                        across[p] += across_off * deposit[0, 0, 0, off_at + p]
                to = run_at(row_of_plane(rows_out, n, 0, y) + x)
                for p in ti.static(range(block)):
                    rows_out[0, 0, 0, to + p] = along[p]
                to = run_at(row_of_plane(rows_out, n, 1, y) + x)
                for p in ti.static(range(block)):
                    rows_out[0, 0, 0, to + p] = across[p]

    return lag_rows


@cache
def make_lag_columns(dtype, size: int, block: int):
    """Build the pass along columns for so many taps; one thread per (image, row)."""
    reach = size // 2

    @ti.kernel
    def lag_columns(
        rows: array(dtype, 4), taps: array(dtype, 2), extent: array(ti.i32, 2), image_out: array(dtype, 3)
    ):
        for n, y in ti.ndrange(image_out.shape[0], image_out.shape[1]):
            right = ti.min(extent[n, 1], image_out.shape[2]) - reach
            inside = y >= reach and y < ti.min(extent[n, 0], image_out.shape[1]) - reach
            for k in range((ti.max(right - reach, 0) + block - 1) // block):
                x = ti.max(ti.min(reach + block * k, right - block), reach)
                total = ti.Vector.zero(dtype, block)
                if inside:
                    for j in range(size):
                        blur = taps[0, j]
                        slope = taps[1, j]
                        along = run_at(row_of_plane(rows, n, 0, y + j - reach) + x)
                        across = run_at(row_of_plane(rows, n, 1, y + j - reach) + x)
                        for p in ti.static(range(block)):
                            total[p] += blur * rows[0, 0, 0, along + p] + slope * rows[0, 0, 0, across + p]
                to = run_at(row_of(image_out, n, y) + x)
                for p in ti.static(range(block)):
                    image_out[0, 0, to + p] = total[p]
            # the last block may have gone beyond, where all of it is narrower than a block
            for i in range(reach):
                image_out[n, y, i] = dtype(0.0)
            for i in range(ti.max(right, reach), image_out.shape[2]):
                image_out[n, y, i] = dtype(0.0)

    return lag_columns


def lag_operator(deposit, deposit_idx, direction, lag, taps, extent, rows_out, image_out) -> None:
    """Launch both passes; overwrites."""
    dtype, size = float_of(deposit), taps.shape[1]
    inner = image_out.shape[2] - 2 * (size // 2)
    if inner <= 0:
        clear(image_out)
        return
    block = variant("lag_operator", is_on_cpu(deposit), inner).tile
    launch(make_lag_rows(dtype, size, block), deposit, deposit_idx, direction, lag, taps, extent, rows_out)
    launch(make_lag_columns(dtype, size, block), rows_out, taps, extent, image_out)
