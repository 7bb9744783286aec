"""Adjoints of ``deposit_events`` and ``lag_operator``; see ``warp_backend/lag_adjoint.py``."""

from functools import cache

from evqr_kernels.operations.events import CHUNK
from evqr_kernels.taichi_backend.language import array, float_of, is_on_cpu, ti
from evqr_kernels.taichi_backend.launches import clear, launch
from evqr_kernels.taichi_backend.splat import events_of
from evqr_kernels.taichi_backend.sums import add_partials
from evqr_kernels.taichi_backend.transport import make_transport


@ti.func
def window_of(window_ptr: ti.template(), event):
    """Find the window of an event by bisection; -1, or how many there are, of one that none names."""
    low = -1
    high = window_ptr.shape[0]
    while high - low > 1:
        middle = (low + high) // 2
        if window_ptr[middle] <= event:
            low = middle
        else:
            high = middle
    return low


@cache
def make_deposit_events_adjoint(dtype):
    """Build the kernel; one thread per event."""
    transport = make_transport(dtype)

    @ti.kernel
    def deposit_events_adjoint(
        x: array(dtype, 1),
        y: array(dtype, 1),
        t: array(dtype, 1),
        weight: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        motion: array(dtype, 2),
        frame: array(dtype, 2),
        adj_deposit: array(dtype, 4),
        adj_weight_out: array(dtype, 1),
        adj_x_out: array(dtype, 1),
        adj_y_out: array(dtype, 1),
    ):
        for e in range(adj_weight_out.shape[0]):
            adj_weight_out[e] = dtype(0.0)
            adj_x_out[e] = dtype(0.0)
            adj_y_out[e] = dtype(0.0)
            b = window_of(window_ptr, e)
            if b < 0 or b >= adj_deposit.shape[0]:
                continue
            inverse_scale = dtype(1.0) / frame[b, 2]
            cx = transport(x[e], t[e], motion[b, 0], frame[b, 0], inverse_scale)
            cy = transport(y[e], t[e], motion[b, 1], frame[b, 1], inverse_scale)
            right = dtype(adj_deposit.shape[3] - 1)
            bottom = dtype(adj_deposit.shape[2] - 1)
            # written so that it is false for NaN
            if cx >= dtype(0.0) and cy >= dtype(0.0) and cx < right and cy < bottom:
                column = int(cx)
                row = int(cy)
                fx = cx - dtype(column)
                fy = cy - dtype(row)
                w = weight[e]
                image = ti.select(w < dtype(0.0), 1, 0)
                left = adj_deposit[b, image, row, column]
                right_of = adj_deposit[b, image, row, column + 1]
                left_grown = adj_deposit[b, image, row + 1, column] - left
                right_grown = adj_deposit[b, image, row + 1, column + 1] - right_of
                left += fy * left_grown
                along = right_of + fy * right_grown - left
                factor = w * inverse_scale
                adj_weight_out[e] = left + fx * along
                adj_x_out[e] = factor * along
                adj_y_out[e] = factor * (left_grown + fx * (right_grown - left_grown))

    return deposit_events_adjoint


@cache
def make_motion_of_positions(dtype):
    """Build the sums over chunks for the adjoint in the motion; a thread a window and chunk."""

    @ti.kernel
    def motion_of_positions(
        t: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        adj_x: array(dtype, 1),
        adj_y: array(dtype, 1),
        chunks_out: array(dtype, 3),
    ):
        for window, chunk in ti.ndrange(chunks_out.shape[0], chunks_out.shape[1]):
            begin, end = events_of(window_ptr, window, t.shape[0])
            length = ti.max((end - begin + chunks_out.shape[1] - 1) // chunks_out.shape[1], CHUNK)
            along_x = dtype(0.0)
            along_y = dtype(0.0)
            for e in range(begin + chunk * length, ti.min(begin + (chunk + 1) * length, end)):
                # a time that is not finite has dropped its event; written so that it holds for NaN
                if not (adj_x[e] == dtype(0.0) and adj_y[e] == dtype(0.0)):
                    along_x -= t[e] * adj_x[e]
                    along_y -= t[e] * adj_y[e]
            chunks_out[window, chunk, 0] = along_x
            chunks_out[window, chunk, 1] = along_y

    return motion_of_positions


def deposit_events_adjoint(
    x, y, t, weight, window_ptr, motion, frame, adj_deposit, chunks_out, adj_weight_out, adj_motion_out,
    adj_x_out, adj_y_out,
) -> None:  # fmt: skip
    """Launch the three passes; overwrites."""
    dtype = float_of(x)
    if 0 in adj_deposit.shape:  # no cell to read
        for output in (adj_weight_out, adj_motion_out, adj_x_out, adj_y_out):
            clear(output)
        return
    launch(
        make_deposit_events_adjoint(dtype),
        x, y, t, weight, window_ptr, motion, frame, adj_deposit, adj_weight_out, adj_x_out, adj_y_out,
    )  # fmt: skip
    launch(make_motion_of_positions(dtype), t, window_ptr, adj_x_out, adj_y_out, chunks_out)
    add_partials(chunks_out, adj_motion_out)


@cache
def make_lag_columns_adjoint(dtype):
    """Build the pass along columns; one thread per (image, row)."""

    @ti.kernel
    def lag_columns_adjoint(
        adj_image: array(dtype, 3),
        taps: array(dtype, 2),
        extent: array(ti.i32, 2),
        adj_rows_out: array(dtype, 4),
    ):
        for n, y in ti.ndrange(adj_image.shape[0], adj_image.shape[1]):
            size = taps.shape[1]
            reach = size // 2
            bottom = ti.min(extent[n, 0], adj_image.shape[1]) - reach
            right = ti.min(extent[n, 1], adj_image.shape[2]) - reach
            for x in range(adj_image.shape[2]):
                along = dtype(0.0)
                across = dtype(0.0)
                # the operator makes no use of cells near the border: there the image is 0 whatever the
                # deposit
                if x >= reach and x < right:
                    for j in range(size):
                        row = y + reach - j
                        if row >= reach and row < bottom:
                            along += taps[0, j] * adj_image[n, row, x]
                            across += taps[1, j] * adj_image[n, row, x]
                adj_rows_out[n, 0, y, x] = along
                adj_rows_out[n, 1, y, x] = across

    return lag_columns_adjoint


@cache
def make_lag_rows_adjoint(dtype):
    """Build the pass along rows; one thread per (deposit, row, ``run`` cells of it)."""

    @ti.kernel
    def lag_rows_adjoint(
        adj_rows: array(dtype, 4),
        deposit_idx: array(ti.i32, 1),
        direction: array(dtype, 2),
        lag: array(dtype, 2),
        taps: array(dtype, 2),
        run: ti.i32,
        adj_deposit_out: array(dtype, 4),
    ):
        runs = (adj_deposit_out.shape[3] + run - 1) // run
        for b, y, k in ti.ndrange(adj_deposit_out.shape[0], adj_deposit_out.shape[2], runs):
            size = taps.shape[1]
            reach = size // 2
            width = adj_rows.shape[3]
            for x in range(k * run, ti.min((k + 1) * run, width)):
                on = dtype(0.0)
                off = dtype(0.0)
                for n in range(deposit_idx.shape[0]):
                    if deposit_idx[n] == b:
                        plain = dtype(0.0)
                        slope = dtype(0.0)
                        for i in range(size):
                            column = x + reach - i
                            if column >= 0 and column < width:
                                along = adj_rows[n, 0, y, column]
                                plain += taps[0, i] * along
                                slope += direction[n, 0] * taps[1, i] * along
                                slope += direction[n, 1] * taps[0, i] * adj_rows[n, 1, y, column]
                        on += plain - lag[n, 0] * slope
                        off += plain - lag[n, 1] * slope
                adj_deposit_out[b, 0, y, x] = on
                adj_deposit_out[b, 1, y, x] = off

    return lag_rows_adjoint


def lag_operator_adjoint(
    deposit_idx, direction, lag, taps, extent, adj_image, rows_out, adj_deposit_out
) -> None:
    """Launch both passes; overwrites."""
    dtype = float_of(adj_image)
    launch(make_lag_columns_adjoint(dtype), adj_image, taps, extent, rows_out)
    # a CPU takes rows whole; on a GPU a thread has one cell, which looks at all images
    run = max(adj_deposit_out.shape[3], 1) if is_on_cpu(adj_image) else 1
    launch(make_lag_rows_adjoint(dtype), rows_out, deposit_idx, direction, lag, taps, run, adj_deposit_out)
