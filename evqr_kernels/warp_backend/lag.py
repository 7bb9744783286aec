"""The fast way from events to a sharp image: deposit once, then blur and undo the pixels' lag on the grid.

``deposit_events`` transports each event as ``splat_events`` does and shares its weight among the four cells
around it, ON and OFF events (the sign of the weight) on an image each:

    deposit_p(x) = sum_i w_i T(x - c_i),      T(r) = max(0, 1 - |r_x|) max(0, 1 - |r_y|)

``lag_operator`` blurs with sampled taps b and their slopes b', and undoes a first-order pixel that lags by
lag_p cells along the unit vector d, as in ``splat`` but for all cells at once and for any number of lags
from one deposit:

    image = sum_p (1 - lag_p d . grad) B deposit_p
          = sum_p (b b^T - lag_p (d_x b' b^T + d_y b b'^T)) * deposit_p

Rows first: ``along = sum_p b * deposit_p - lag_p d_x b' * deposit_p`` and
``across = sum_p -lag_p d_y b * deposit_p``; then columns, ``image = b * along + b' * across``.  Cells nearer
to the border than the taps reach are 0.  An image may be larger than its own part of it, its extent: the
border is that of this part, and what is beyond is 0.

The adjoints are in ``lag_adjoint.py``.
"""

from functools import cache

import warp as wp

from evqr_kernels.operations.events import CHUNK
from evqr_kernels.warp_backend.language import (
    clear,
    launch,
    launch_bounds,
    module_of,
    neighbours,
    variant,
    vector,
)
from evqr_kernels.warp_backend.transport import make_transport, window_of


@cache
def make_deposit_events(dtype: type) -> wp.Kernel:
    """Build the kernel; launch: one thread per chunk of events, whatever windows they are of."""
    vec_pair = vector(2, dtype)
    transport = make_transport(dtype)

    @wp.kernel(module=module_of("lag", dtype))
    def deposit_events(
        x: wp.array(dtype=dtype),
        y: wp.array(dtype=dtype),
        t: wp.array(dtype=dtype),
        weight: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        motion: wp.array2d(dtype=dtype),
        frame: wp.array2d(dtype=dtype),
        pairs_out: wp.array4d(dtype=vec_pair),
    ):
        right = dtype(pairs_out.shape[3])
        bottom = dtype(pairs_out.shape[2] - 1)
        first = wp.tid() * CHUNK
        last = wp.min(first + CHUNK, window_ptr[window_ptr.shape[0] - 1])
        b = window_of(window_ptr, first)
        if b < 0 or last > x.shape[0]:  # some of them no window names
            first = wp.max(first, window_ptr[0])
            last = wp.min(last, x.shape[0])
            b = window_of(window_ptr, first)
        while first < last:  # ends with the last window
            end = wp.min(last, window_ptr[b + 1])
            motion_x = motion[b, 0]
            motion_y = motion[b, 1]
            origin_x = frame[b, 0]
            origin_y = frame[b, 1]
            inverse_scale = dtype(1.0) / frame[b, 2]
            for e in range(first, end):
                cx = transport(x[e], t[e], motion_x, origin_x, inverse_scale)
                cy = transport(y[e], t[e], motion_y, origin_y, inverse_scale)
                # written so that it is false for NaN
                if cx >= dtype(0.0) and cy >= dtype(0.0) and cx < right and cy < bottom:
                    column = int(cx)
                    row = int(cy)
                    w = weight[e]
                    image = wp.int32(0)
                    if w < dtype(0.0):
                        image = wp.int32(1)
                    share = (cx - dtype(column)) * w
                    pair = vec_pair(w - share, share)
                    below = (cy - dtype(row)) * pair
                    wp.atomic_add(pairs_out, b, image, row, column, pair - below)
                    wp.atomic_add(pairs_out, b, image, row + 1, column, below)
            first = wp.max(first, end)
            b += 1

    return deposit_events


def deposit_events(x, y, t, weight, window_ptr, motion, frame, deposit_out) -> None:
    """Launch; accumulates.  Float atomics: on a GPU sums repeat to a tolerance, not bit for bit."""
    launch(
        make_deposit_events(x.dtype),
        -(-x.shape[0] // CHUNK),
        inputs=[x, y, t, weight, window_ptr, motion, frame],
        outputs=[neighbours(deposit_out, 2)],
        device=x.device,
    )


@cache
def make_lag_rows(dtype: type, block: int) -> wp.Kernel:
    """Build the pass along rows; launch: ``parts`` threads per row of an image."""
    vec_block = vector(block, dtype)

    @wp.kernel(module=module_of(f"lag_{block}", dtype), launch_bounds=launch_bounds(dtype))
    def lag_rows(
        blocks: wp.array4d(dtype=vec_block),
        deposit_idx: wp.array(dtype=wp.int32),
        direction: wp.array2d(dtype=dtype),
        lag: wp.array2d(dtype=dtype),
        taps: wp.array2d(dtype=dtype),
        extent: wp.array2d(dtype=wp.int32),
        parts: int,
        rows_out: wp.array4d(dtype=vec_block),
    ):
        n, y, part = wp.tid()
        b = wp.clamp(deposit_idx[n], 0, blocks.shape[0] - 1)
        size = taps.shape[1]
        reach = size // 2
        right = wp.min(extent[n, 1], blocks.shape[3] + block - 1) - reach
        if y >= extent[n, 0]:
            return
        lag_on = lag[n, 0]
        lag_off = lag[n, 1]
        for begin in range(reach + block * part, right, block * parts):
            # the last block ends with the row; what it shares with the one before is written twice, alike
            x = wp.max(wp.min(begin, right - block), reach)
            on = vec_block()
            off = vec_block()
            on_slope = vec_block()
            off_slope = vec_block()
            for i in range(size):
                v = blocks[b, 0, y, x + i - reach]
                on += taps[0, i] * v
                on_slope += taps[1, i] * v
                v = blocks[b, 1, y, x + i - reach]
                off += taps[0, i] * v
                off_slope += taps[1, i] * v
            rows_out[n, 0, y, x] = on + off - direction[n, 0] * (lag_on * on_slope + lag_off * off_slope)
            rows_out[n, 1, y, x] = -direction[n, 1] * (lag_on * on + lag_off * off)

    return lag_rows


@cache
def make_lag_columns(dtype: type, block: int) -> wp.Kernel:
    """Build the pass along columns; launch as the rows."""
    vec_block = vector(block, dtype)

    @wp.kernel(module=module_of(f"lag_{block}", dtype))
    def lag_columns(
        rows: wp.array4d(dtype=vec_block),
        taps: wp.array2d(dtype=dtype),
        extent: wp.array2d(dtype=wp.int32),
        parts: int,
        image_out: wp.array3d(dtype=dtype),
        blocks_out: wp.array3d(dtype=vec_block),
    ):
        n, y, part = wp.tid()
        size = taps.shape[1]
        reach = size // 2
        width = image_out.shape[2]
        right = wp.min(extent[n, 1], width) - reach
        if part == 0:
            for i in range(reach):
                image_out[n, y, i] = dtype(0.0)
                image_out[n, y, width - 1 - i] = dtype(0.0)
        for first in range(reach + block * part, width - reach, block * parts):
            if first < right:
                x = wp.max(wp.min(first, right - block), reach)
                total = vec_block()
                if y >= reach and y < wp.min(extent[n, 0], image_out.shape[1]) - reach:
                    for j in range(size):
                        row = y + j - reach
                        total += taps[0, j] * rows[n, 0, row, x] + taps[1, j] * rows[n, 1, row, x]
                    if right - x < block:  # all of it is narrower than a block
                        for p in range(block):
                            if x + p >= right:
                                total[p] = dtype(0.0)
                blocks_out[n, y, x] = total
            for i in range(wp.max(first, right), wp.min(first + block, width - reach)):
                image_out[n, y, i] = dtype(0.0)

    return lag_columns


def lag_operator(deposit, deposit_idx, direction, lag, taps, extent, rows_out, image_out) -> None:
    """Launch both passes; overwrites."""
    dtype, device = deposit.dtype, deposit.device
    count, height, width = image_out.shape
    inner = width - 2 * (taps.shape[1] // 2)
    if inner <= 0:
        clear(image_out)
        return
    block = variant("lag_operator", device, inner).tile
    parts = 1 if device.is_cpu else -(-inner // block)
    rows = neighbours(rows_out, block)
    launch(
        make_lag_rows(dtype, block),
        (count, height, parts),
        inputs=[neighbours(deposit, block), deposit_idx, direction, lag, taps, extent, parts],
        outputs=[rows],
        device=device,
    )
    launch(
        make_lag_columns(dtype, block),
        (count, height, parts),
        inputs=[rows, taps, extent, parts],
        outputs=[image_out, neighbours(image_out, block)],
        device=device,
    )
