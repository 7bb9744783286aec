"""Cost of a residual: half the sum of its squares over the pixels of a window, each with a weight.

    cost = 1/2 sum_{y, x} mask(y, x) residual(y, x)^2

with the residual of ``residual.py``, which is not written down.  Adjoint, for a_c = d loss / d cost:

    adj_E(y, x) = a_c mask(y, x) residual(y, x)

which is the adjoint of the residual too: those in L and m follow from it as in ``residual.py``, m's on the
way, L's in a second pass that reads what the first one has to write anyway.  In one pass, with the residual
of four neighbours found again, it takes several times as long.

A thread takes a row by blocks of neighbouring pixels, as there, and leaves the row's share of the sums.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, variant, vector
from evqr_kernels.warp_backend.residual import (
    make_adjoint_of_row,
    make_residual_of_block,
    make_residual_of_pixel,
    make_slopes,
)
from evqr_kernels.warp_backend.sums import add_partials


@cache
def make_without_first(dtype: type, block: int) -> wp.Function:
    """Build what makes the first ``count`` of neighbours 0: those that a sum has from the block before."""
    vec_block = vector(block, dtype)

    @wp.func
    def without_first(values: vec_block, count: int):
        rest = values
        for k in range(wp.static(block)):
            if k < count:
                rest[k] = dtype(0.0)
        return rest

    return without_first


@cache
def make_cost_rows(dtype: type, block: int) -> wp.Kernel:
    """Build the first pass of the cost; launch: one thread per row.

    ``.._blocks``: `neighbours` of the array before.
    """
    vec_block = vector(block, dtype)
    residual_of_pixel = make_residual_of_pixel(dtype)
    residual_of_block = make_residual_of_block(dtype, block)
    without_first = make_without_first(dtype, block)

    @wp.kernel(module=module_of(f"cost_{block}", dtype))
    def cost_rows(
        luminance: wp.array3d(dtype=dtype),
        luminance_blocks: wp.array3d(dtype=vec_block),
        events_image: wp.array3d(dtype=dtype),
        events_blocks: wp.array3d(dtype=vec_block),
        motion: wp.array2d(dtype=dtype),
        mask: wp.array3d(dtype=dtype),
        mask_blocks: wp.array3d(dtype=vec_block),
        rows_out: wp.array2d(dtype=dtype),
    ):
        b, y = wp.tid()
        width = luminance.shape[2]
        total = dtype(0.0)
        singles = width
        if wp.static(block > 1):
            if width - 2 >= block:
                singles = wp.int32(2)
                blocks = (width - 2) // block
                sums = vec_block()
                for k in range(blocks):
                    x = 1 + block * k
                    residuals = residual_of_block(luminance_blocks, events_blocks, motion, b, y, x)
                    sums += wp.cw_mul(wp.cw_mul(mask_blocks[b, y, x], residuals), residuals)
                x = width - 1 - block  # the last block overlaps the one before
                residuals = residual_of_block(luminance_blocks, events_blocks, motion, b, y, x)
                weights = without_first(mask_blocks[b, y, x], 1 + block * blocks - x)
                sums += wp.cw_mul(wp.cw_mul(weights, residuals), residuals)
                for k in range(wp.static(block)):
                    total += sums[k]
        for i in range(singles):
            x = wp.where(i == 0, 0, width - singles + i)
            residual = residual_of_pixel(luminance, events_image, motion, b, y, x)
            total += mask[b, y, x] * residual * residual
        rows_out[b, y] = dtype(0.5) * total

    return cost_rows


def brightness_cost(luminance, events_image, motion, mask, rows_out, cost_out) -> None:
    """Launch both passes; overwrites."""
    block = variant("brightness_cost", luminance.device).tile
    launch(
        make_cost_rows(luminance.dtype, block),
        luminance.shape[:2],
        inputs=[
            luminance, neighbours(luminance, block), events_image, neighbours(events_image, block), motion,
            mask, neighbours(mask, block),
        ],
        outputs=[rows_out],
        device=luminance.device,
    )  # fmt: skip
    add_partials(rows_out.reshape((*rows_out.shape, 1)), cost_out.reshape((*cost_out.shape, 1)))


@cache
def make_cost_adjoint_rows(dtype: type, block: int) -> wp.Kernel:
    """Build the first pass of the adjoint, all but that in the luminance; launch and blocks as forward."""
    vec_block = vector(block, dtype)
    slopes = make_slopes(dtype)
    without_first = make_without_first(dtype, block)

    @wp.func
    def adjoint_of_block(
        luminance_blocks: wp.array3d(dtype=vec_block),
        events_blocks: wp.array3d(dtype=vec_block),
        mask_blocks: wp.array3d(dtype=vec_block),
        motion: wp.array2d(dtype=dtype),
        factor: dtype,
        b: int,
        y: int,
        x: int,
    ):
        above = wp.max(y - 1, 0)
        below = wp.min(y + 1, luminance_blocks.shape[1] - 1)
        half_x = dtype(0.5) * motion[b, 0]
        half_y = dtype(0.5) * motion[b, 1]
        # in the order of `make_residual_of_block`
        along_x = luminance_blocks[b, y, x + 1] - luminance_blocks[b, y, x - 1]
        across = half_x * along_x + events_blocks[b, y, x]
        along_y = luminance_blocks[b, below, x] - luminance_blocks[b, above, x]
        residuals = half_y * along_y + across
        return factor * wp.cw_mul(mask_blocks[b, y, x], residuals), along_x, along_y

    @wp.kernel(module=module_of(f"cost_{block}", dtype))
    def cost_adjoint_rows(
        luminance: wp.array3d(dtype=dtype),
        luminance_blocks: wp.array3d(dtype=vec_block),
        events_image: wp.array3d(dtype=dtype),
        events_blocks: wp.array3d(dtype=vec_block),
        motion: wp.array2d(dtype=dtype),
        mask: wp.array3d(dtype=dtype),
        mask_blocks: wp.array3d(dtype=vec_block),
        adj_cost: wp.array(dtype=dtype),
        rows_out: wp.array3d(dtype=dtype),
        adj_events_image_out: wp.array3d(dtype=dtype),
        adj_events_blocks_out: wp.array3d(dtype=vec_block),
    ):
        b, y = wp.tid()
        width = luminance.shape[2]
        factor = adj_cost[b]
        adj_x = dtype(0.0)
        adj_y = dtype(0.0)
        singles = width
        if wp.static(block > 1):
            if width - 2 >= block:
                singles = wp.int32(2)
                blocks = (width - 2) // block
                sums_x = vec_block()
                sums_y = vec_block()
                for k in range(blocks):
                    x = 1 + block * k
                    adj, along_x, along_y = adjoint_of_block(
                        luminance_blocks, events_blocks, mask_blocks, motion, factor, b, y, x
                    )
                    adj_events_blocks_out[b, y, x] = adj
                    sums_x += wp.cw_mul(adj, along_x)
                    sums_y += wp.cw_mul(adj, along_y)
                x = width - 1 - block  # the last block overlaps the one before
                adj, along_x, along_y = adjoint_of_block(
                    luminance_blocks, events_blocks, mask_blocks, motion, factor, b, y, x
                )
                adj_events_blocks_out[b, y, x] = adj
                adj = without_first(adj, 1 + block * blocks - x)
                sums_x += wp.cw_mul(adj, along_x)
                sums_y += wp.cw_mul(adj, along_y)
                for k in range(wp.static(block)):
                    adj_x += dtype(0.5) * sums_x[k]
                    adj_y += dtype(0.5) * sums_y[k]
        for i in range(singles):
            x = wp.where(i == 0, 0, width - singles + i)
            dx, dy = slopes(luminance, b, y, x)
            residual = motion[b, 0] * dx + motion[b, 1] * dy + events_image[b, y, x]
            adj_residual = factor * mask[b, y, x] * residual
            adj_events_image_out[b, y, x] = adj_residual
            adj_x += adj_residual * dx
            adj_y += adj_residual * dy
        rows_out[b, y, 0] = adj_x
        rows_out[b, y, 1] = adj_y

    return cost_adjoint_rows


@cache
def make_adjoint_in_luminance(dtype: type, block: int) -> wp.Kernel:
    """Build the second pass of the adjoint; launch and blocks as forward."""
    vec_block = vector(block, dtype)
    adjoint_of_row = make_adjoint_of_row(dtype, block)

    @wp.kernel(module=module_of(f"cost_{block}", dtype))
    def adjoint_in_luminance(
        motion: wp.array2d(dtype=dtype),
        adj_residual: wp.array3d(dtype=dtype),
        adj_blocks: wp.array3d(dtype=vec_block),
        adj_luminance_out: wp.array3d(dtype=dtype),
        adj_luminance_blocks_out: wp.array3d(dtype=vec_block),
    ):
        b, y = wp.tid()
        adjoint_of_row(adj_residual, adj_blocks, motion, b, y, adj_luminance_out, adj_luminance_blocks_out)

    return adjoint_in_luminance


def brightness_cost_adjoint(
    luminance, events_image, motion, mask, adj_cost, rows_out, adj_luminance_out, adj_events_image_out,
    adj_motion_out,
) -> None:  # fmt: skip
    """Launch all passes; overwrites."""
    block = variant("brightness_cost_adjoint", luminance.device).tile
    launch(
        make_cost_adjoint_rows(luminance.dtype, block),
        luminance.shape[:2],
        inputs=[
            luminance, neighbours(luminance, block), events_image, neighbours(events_image, block), motion,
            mask, neighbours(mask, block), adj_cost,
        ],
        outputs=[rows_out, adj_events_image_out, neighbours(adj_events_image_out, block)],
        device=luminance.device,
    )  # fmt: skip
    launch(
        make_adjoint_in_luminance(luminance.dtype, block),
        luminance.shape[:2],
        inputs=[motion, adj_events_image_out, neighbours(adj_events_image_out, block)],
        outputs=[adj_luminance_out, neighbours(adj_luminance_out, block)],
        device=luminance.device,
    )
    add_partials(rows_out, adj_motion_out)
