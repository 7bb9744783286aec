"""Adjoints of ``deposit_events`` in the weights and of ``lag_operator`` in the deposit; see ``lag.py``.

With adj = d loss / d deposit, p the sign of the event and T the share that a cell gets of it:

    adj_w_i = sum_x adj_p(x) T(x - c_i)

With adj_n = d loss / d image_n, 0 nearer to the border than the taps reach, and all shifts reversed: columns
first, ``along_n(y) = sum_j b_j adj_n(y - j)`` and ``across_n(y) = sum_j b'_j adj_n(y - j)``; then rows, added
up over the images that were made of the deposit,

    adj_p(x) = sum_n sum_i (b_i - lag_p d_x b'_i) along_n(x - i) - lag_p d_y b_i across_n(x - i)

Both are gathers, so there is no atomic and results repeat bit for bit.  They are not on the path of reading a
code and favour clarity: one thread an event or a cell.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of
from evqr_kernels.warp_backend.transport import make_transport


@cache
def make_deposit_events_adjoint(dtype: type) -> wp.Kernel:
    """Build the kernel; launch: one thread per event."""
    transport = make_transport(dtype)

    @wp.kernel(module=module_of("lag_adjoint", dtype))
    def deposit_events_adjoint(
        x: wp.array(dtype=dtype),
        y: wp.array(dtype=dtype),
        t: wp.array(dtype=dtype),
        weight: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        motion: wp.array2d(dtype=dtype),
        frame: wp.array2d(dtype=dtype),
        adj_deposit: wp.array4d(dtype=dtype),
        adj_weight_out: wp.array(dtype=dtype),
    ):
        e = wp.tid()
        b = wp.lower_bound(window_ptr, e + 1) - 1
        inverse_scale = dtype(1.0) / frame[b, 2]
        cx = transport(x[e], t[e], motion[b, 0], frame[b, 0], inverse_scale)
        cy = transport(y[e], t[e], motion[b, 1], frame[b, 1], inverse_scale)
        right = dtype(adj_deposit.shape[3] - 1)
        bottom = dtype(adj_deposit.shape[2] - 1)
        adj = dtype(0.0)
        # written so that it is false for NaN
        if cx >= dtype(0.0) and cy >= dtype(0.0) and cx < right and cy < bottom:
            column = int(cx)
            row = int(cy)
            fx = cx - dtype(column)
            fy = cy - dtype(row)
            image = wp.int32(0)
            if weight[e] < dtype(0.0):
                image = wp.int32(1)
            for j in range(2):
                share_y = wp.where(j == 0, dtype(1.0) - fy, fy)
                for i in range(2):
                    share_x = wp.where(i == 0, dtype(1.0) - fx, fx)
                    adj += share_x * share_y * adj_deposit[b, image, row + j, column + i]
        adj_weight_out[e] = adj

    return deposit_events_adjoint


def deposit_events_adjoint(x, y, t, weight, window_ptr, motion, frame, adj_deposit, adj_weight_out) -> None:
    """Launch; overwrites."""
    launch(
        make_deposit_events_adjoint(x.dtype),
        x.shape[0],
        inputs=[x, y, t, weight, window_ptr, motion, frame, adj_deposit],
        outputs=[adj_weight_out],
        device=x.device,
    )


@cache
def make_lag_columns_adjoint(dtype: type) -> wp.Kernel:
    """Build the pass along columns; launch: one thread per (image, row, column)."""

    @wp.kernel(module=module_of("lag_adjoint", dtype))
    def lag_columns_adjoint(
        adj_image: wp.array3d(dtype=dtype),
        taps: wp.array2d(dtype=dtype),
        adj_rows_out: wp.array4d(dtype=dtype),
    ):
        n, y, x = wp.tid()
        size = taps.shape[1]
        reach = size // 2
        height = adj_image.shape[1]
        along = dtype(0.0)
        across = dtype(0.0)
        # the operator makes no use of cells near the border: there the image is 0 whatever the deposit
        if x >= reach and x < adj_image.shape[2] - reach:
            for j in range(size):
                row = y + reach - j
                if row >= reach and row < height - reach:
                    along += taps[0, j] * adj_image[n, row, x]
                    across += taps[1, j] * adj_image[n, row, x]
        adj_rows_out[n, 0, y, x] = along
        adj_rows_out[n, 1, y, x] = across

    return lag_columns_adjoint


@cache
def make_lag_rows_adjoint(dtype: type) -> wp.Kernel:
    """Build the pass along rows; launch: one thread per (deposit, row, column)."""

    @wp.kernel(module=module_of("lag_adjoint", dtype))
    def lag_rows_adjoint(
        adj_rows: wp.array4d(dtype=dtype),
        deposit_idx: wp.array(dtype=wp.int32),
        direction: wp.array2d(dtype=dtype),
        lag: wp.array2d(dtype=dtype),
        taps: wp.array2d(dtype=dtype),
        adj_deposit_out: wp.array4d(dtype=dtype),
    ):
        b, y, x = wp.tid()
        size = taps.shape[1]
        reach = size // 2
        width = adj_rows.shape[3]
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


def lag_operator_adjoint(deposit_idx, direction, lag, taps, adj_image, rows_out, adj_deposit_out) -> None:
    """Launch both passes; overwrites."""
    dtype, device = adj_image.dtype, adj_image.device
    count, _, height, width = adj_deposit_out.shape
    launch(
        make_lag_columns_adjoint(dtype),
        adj_image.shape,
        inputs=[adj_image, taps],
        outputs=[rows_out],
        device=device,
    )
    launch(
        make_lag_rows_adjoint(dtype),
        (count, height, width),
        inputs=[rows_out, deposit_idx, direction, lag, taps],
        outputs=[adj_deposit_out],
        device=device,
    )
