"""Adjoints of ``deposit_events`` in weight, motion and position, and of ``lag_operator`` in the deposit.

See ``lag.py``.  With adj = d loss / d deposit, p the sign of the event and T the share that a cell gets of
it, which is bilinear in the event's place between the four cells:

    adj_w_i = sum_x adj_p(x) T(x - c_i),     adj_x_i = -w_i / scale sum_x adj_p(x) dT / dx (x - c_i)
    adj_m = -sum_i t_i (adj_x_i, adj_y_i)

With adj_n = d loss / d image_n, 0 nearer to the border of its extent than the taps reach, and all shifts
reversed: columns first, ``along_n(y) = sum_j b_j adj_n(y - j)`` and
``across_n(y) = sum_j b'_j adj_n(y - j)``; then rows, added up over the images that were made of the deposit,

    adj_p(x) = sum_n sum_i (b_i - lag_p d_x b'_i) along_n(x - i) - lag_p d_y b_i across_n(x - i)

Both are gathers, so there is no atomic and results repeat bit for bit.  Cells are taken by the block, as in
``lag.py``; those so near the ends of a row that a block would look beyond it, one by one.
"""

from functools import cache

import warp as wp

from evqr_kernels.operations.events import CHUNK
from evqr_kernels.warp_backend.language import clear, launch, module_of, neighbours, variant, vector
from evqr_kernels.warp_backend.sums import add_partials
from evqr_kernels.warp_backend.transport import is_named, make_transport, window_of


@cache
def make_deposit_events_adjoint(dtype: type) -> wp.Kernel:
    """Build the kernel; launch: one thread per event.  ``pairs``: `neighbours` of the deposit's adjoint."""
    vec_pair = vector(2, dtype)
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
        pairs: wp.array4d(dtype=vec_pair),
        adj_weight_out: wp.array(dtype=dtype),
        adj_x_out: wp.array(dtype=dtype),
        adj_y_out: wp.array(dtype=dtype),
    ):
        e = wp.tid()
        adj_weight_out[e] = dtype(0.0)
        adj_x_out[e] = dtype(0.0)
        adj_y_out[e] = dtype(0.0)
        if not is_named(window_ptr, e):
            return
        b = window_of(window_ptr, e)
        inverse_scale = dtype(1.0) / frame[b, 2]
        cx = transport(x[e], t[e], motion[b, 0], frame[b, 0], inverse_scale)
        cy = transport(y[e], t[e], motion[b, 1], frame[b, 1], inverse_scale)
        right = dtype(pairs.shape[3])
        bottom = dtype(pairs.shape[2] - 1)
        # written so that it is false for NaN
        if cx >= dtype(0.0) and cy >= dtype(0.0) and cx < right and cy < bottom:
            column = int(cx)
            row = int(cy)
            fx = cx - dtype(column)
            fy = cy - dtype(row)
            w = weight[e]
            image = wp.where(w < dtype(0.0), 1, 0)
            above = pairs[b, image, row, column]
            grown = pairs[b, image, row + 1, column] - above
            both = above + fy * grown
            along = both[1] - both[0]
            factor = w * inverse_scale
            adj_weight_out[e] = both[0] + fx * along
            adj_x_out[e] = factor * along
            adj_y_out[e] = factor * (grown[0] + fx * (grown[1] - grown[0]))

    return deposit_events_adjoint


@cache
def make_motion_of_positions(dtype: type) -> wp.Kernel:
    """Build the sums over chunks for the adjoint in the motion; launch: a thread a window and chunk."""

    @wp.kernel(module=module_of("lag_adjoint", dtype))
    def motion_of_positions(
        t: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        adj_x: wp.array(dtype=dtype),
        adj_y: wp.array(dtype=dtype),
        chunks_out: wp.array3d(dtype=dtype),
    ):
        b, chunk = wp.tid()
        begin = wp.clamp(window_ptr[b], 0, t.shape[0])
        end = wp.clamp(window_ptr[b + 1], begin, t.shape[0])
        length = wp.max((end - begin + chunks_out.shape[1] - 1) // chunks_out.shape[1], CHUNK)
        along_x = dtype(0.0)
        along_y = dtype(0.0)
        for e in range(begin + chunk * length, wp.min(begin + (chunk + 1) * length, end)):
            x = adj_x[e]
            y = adj_y[e]
            # a time that is not finite has dropped its event; written so that it holds for NaN
            if not (x == dtype(0.0) and y == dtype(0.0)):
                along_x -= t[e] * x
                along_y -= t[e] * y
        chunks_out[b, chunk, 0] = along_x
        chunks_out[b, chunk, 1] = along_y

    return motion_of_positions


def deposit_events_adjoint(
    x, y, t, weight, window_ptr, motion, frame, adj_deposit, chunks_out, adj_weight_out, adj_motion_out,
    adj_x_out, adj_y_out,
) -> None:  # fmt: skip
    """Launch the three passes; overwrites."""
    launch(
        make_deposit_events_adjoint(x.dtype),
        x.shape[0],
        inputs=[x, y, t, weight, window_ptr, motion, frame, neighbours(adj_deposit, 2)],
        outputs=[adj_weight_out, adj_x_out, adj_y_out],
        device=x.device,
    )
    launch(
        make_motion_of_positions(x.dtype),
        chunks_out.shape[:2],
        inputs=[t, window_ptr, adj_x_out, adj_y_out],
        outputs=[chunks_out],
        device=x.device,
    )
    add_partials(chunks_out, adj_motion_out)


@cache
def make_lag_columns_adjoint(dtype: type, block: int) -> wp.Kernel:
    """Build the pass along columns; launch: one thread per (image, row, block of cells).

    ``.._blocks``: `neighbours` of the array before.
    """
    vec_block = vector(block, dtype)

    @wp.kernel(module=module_of(f"lag_adjoint_{block}", dtype))
    def lag_columns_adjoint(
        adj_blocks: wp.array3d(dtype=vec_block),
        taps: wp.array2d(dtype=dtype),
        extent: wp.array2d(dtype=wp.int32),
        rows_out: wp.array4d(dtype=dtype),
        row_blocks_out: wp.array4d(dtype=vec_block),
    ):
        n, y, k = wp.tid()
        size = taps.shape[1]
        reach = size // 2
        height = wp.min(extent[n, 0], rows_out.shape[2])
        width = rows_out.shape[3]
        right = wp.min(extent[n, 1], width) - reach
        if k == 0:
            # the operator makes no use of cells near the border: there the image is 0 whatever the deposit
            for plane in range(2):
                for i in range(reach):
                    rows_out[n, plane, y, i] = dtype(0.0)
                    rows_out[n, plane, y, width - 1 - i] = dtype(0.0)
        # the last block ends with the row; what it shares with the one before is written twice, alike
        x = wp.min(reach + block * k, adj_blocks.shape[2] - 1 - reach)
        along = vec_block()
        across = vec_block()
        # of rows that are not near the border
        for j in range(wp.max(y + 2 * reach + 1 - height, 0), wp.min(size, y + 1)):
            adj = adj_blocks[n, y + reach - j, x]
            along += taps[0, j] * adj
            across += taps[1, j] * adj
        if x + block > right:
            for p in range(block):
                if x + p >= right:
                    along[p] = dtype(0.0)
                    across[p] = dtype(0.0)
        row_blocks_out[n, 0, y, x] = along
        row_blocks_out[n, 1, y, x] = across

    return lag_columns_adjoint


@wp.func
def next_image(deposit_idx: wp.array(dtype=wp.int32), b: int, first: int) -> int:
    """Give the next image that was made of deposit ``b``, the number of images where there is none."""
    n = first
    while n < deposit_idx.shape[0] and deposit_idx[n] != b:
        n += 1
    return n


@cache
def make_lag_gather(dtype: type, block: int) -> wp.Function:
    """Build the sum along a row, over images, that ``block`` cells of a deposit get: ON and OFF."""
    vec_block = vector(block, dtype)

    @wp.func
    def lag_gather(
        row_blocks: wp.array4d(dtype=vec_block),
        deposit_idx: wp.array(dtype=wp.int32),
        direction: wp.array2d(dtype=dtype),
        lag: wp.array2d(dtype=dtype),
        taps: wp.array2d(dtype=dtype),
        b: int,
        y: int,
        x: int,
    ):
        size = taps.shape[1]
        reach = size // 2
        on = vec_block()
        off = vec_block()
        # not a loop over all images with a condition in it: compilers make no vectors of sums that cross one
        n = next_image(deposit_idx, b, 0)
        while n < deposit_idx.shape[0]:
            plain = vec_block()
            slope = vec_block()
            for i in range(size):
                column = x + reach - i
                # blocks do not look beyond their row
                if wp.static(block > 1) or (column >= 0 and column < row_blocks.shape[3]):
                    along = row_blocks[n, 0, y, column]
                    plain += taps[0, i] * along
                    slope += (direction[n, 0] * taps[1, i]) * along
                    slope += (direction[n, 1] * taps[0, i]) * row_blocks[n, 1, y, column]
            on += plain - lag[n, 0] * slope
            off += plain - lag[n, 1] * slope
            n = next_image(deposit_idx, b, n + 1)
        return on, off

    return lag_gather


@cache
def make_lag_rows_adjoint(dtype: type, block: int) -> wp.Kernel:
    """Build the pass along rows; launch: one thread per (deposit, row, block of cells).

    ``.._cells`` and ``.._blocks``: `neighbours` of the same arrays, one and ``block``.
    """
    vec_block = vector(block, dtype)
    vec_cell = vector(1, dtype)
    gather_block = make_lag_gather(dtype, block)
    gather_cell = make_lag_gather(dtype, 1)

    @wp.kernel(module=module_of(f"lag_adjoint_{block}", dtype))
    def lag_rows_adjoint(
        row_cells: wp.array4d(dtype=vec_cell),
        row_blocks: wp.array4d(dtype=vec_block),
        deposit_idx: wp.array(dtype=wp.int32),
        direction: wp.array2d(dtype=dtype),
        lag: wp.array2d(dtype=dtype),
        taps: wp.array2d(dtype=dtype),
        adj_cells_out: wp.array4d(dtype=vec_cell),
        adj_blocks_out: wp.array4d(dtype=vec_block),
    ):
        b, y, k = wp.tid()
        x = k
        if wp.static(block > 1):
            reach = taps.shape[1] // 2
            if k == 0:
                for i in range(2 * reach):
                    edge = wp.where(i < reach, i, adj_cells_out.shape[3] - 1 - (i - reach))
                    on_cell, off_cell = gather_cell(row_cells, deposit_idx, direction, lag, taps, b, y, edge)
                    adj_cells_out[b, 0, y, edge] = on_cell
                    adj_cells_out[b, 1, y, edge] = off_cell
            x = wp.min(reach + block * k, adj_blocks_out.shape[3] - 1 - reach)
        on, off = gather_block(row_blocks, deposit_idx, direction, lag, taps, b, y, x)
        adj_blocks_out[b, 0, y, x] = on
        adj_blocks_out[b, 1, y, x] = off

    return lag_rows_adjoint


def lag_operator_adjoint(
    deposit_idx, direction, lag, taps, extent, adj_image, rows_out, adj_deposit_out
) -> None:
    """Launch both passes; overwrites."""
    dtype, device = adj_image.dtype, adj_image.device
    count, _, height, width = adj_deposit_out.shape
    inner = width - 2 * (taps.shape[1] // 2)
    if inner <= 0:
        clear(adj_deposit_out)
        return
    block = variant("lag_operator_adjoint", device, inner).tile
    blocks = -(-inner // block)
    rows = neighbours(rows_out, block)
    launch(
        make_lag_columns_adjoint(dtype, block),
        (adj_image.shape[0], height, blocks),
        inputs=[neighbours(adj_image, block), taps, extent],
        outputs=[rows_out, rows],
        device=device,
    )
    launch(
        make_lag_rows_adjoint(dtype, block),
        (count, height, blocks if block > 1 else width),
        inputs=[neighbours(rows_out, 1), rows, deposit_idx, direction, lag, taps],
        outputs=[neighbours(adj_deposit_out, 1), neighbours(adj_deposit_out, block)],
        device=device,
    )
