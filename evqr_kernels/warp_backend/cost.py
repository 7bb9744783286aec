"""Cost of a residual: half the sum of its squares over the pixels of a window, each with a weight.

    cost = 1/2 sum_{y, x} mask(y, x) residual(y, x)^2

with the residual of ``residual.py``, which is not written down.  Adjoint, for a_c = d loss / d cost:

    adj_E(y, x) = a_c mask(y, x) residual(y, x)

which is the adjoint of the residual too: those in L and m follow from it as in ``residual.py``.

A thread takes a row by blocks of neighbouring pixels, as there, and leaves the row's share of the sum.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.lag import CPU_BLOCK
from evqr_kernels.warp_backend.language import launch, module_of, neighbours, vector
from evqr_kernels.warp_backend.residual import (
    brightness_residual_adjoint,
    make_residual_of_block,
    make_residual_of_pixel,
)
from evqr_kernels.warp_backend.sums import add_partials


@cache
def make_cost_rows(dtype: type, block: int) -> wp.Kernel:
    """Build the first pass of the cost; launch: one thread per row.

    ``.._blocks``: `neighbours` of the array before.
    """
    vec_block = vector(block, dtype)
    residual_of_pixel = make_residual_of_pixel(dtype)
    residual_of_block = make_residual_of_block(dtype, block)

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
        blocks = wp.int32(0)
        if wp.static(block > 1):
            sums = vec_block()
            blocks = wp.max(width - 2, 0) // block
            for k in range(blocks):
                x = 1 + block * k
                residuals = residual_of_block(luminance_blocks, events_blocks, motion, b, y, x)
                sums += wp.cw_mul(wp.cw_mul(mask_blocks[b, y, x], residuals), residuals)
            for k in range(wp.static(block)):
                total += sums[k]
        for i in range(width - block * blocks):
            x = wp.where(i == 0, 0, block * blocks + i)
            residual = residual_of_pixel(luminance, events_image, motion, b, y, x)
            total += mask[b, y, x] * residual * residual
        rows_out[b, y] = dtype(0.5) * total

    return cost_rows


def brightness_cost(luminance, events_image, motion, mask, rows_out, cost_out) -> None:
    """Launch both passes; overwrites."""
    block = CPU_BLOCK if luminance.device.is_cpu else 1
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
def make_adjoint_of_residual(dtype: type, block: int) -> wp.Kernel:
    """Build the first pass of the adjoint; launch and blocks as forward."""
    vec_block = vector(block, dtype)
    residual_of_pixel = make_residual_of_pixel(dtype)
    residual_of_block = make_residual_of_block(dtype, block)

    @wp.kernel(module=module_of(f"cost_{block}", dtype))
    def adjoint_of_residual(
        luminance: wp.array3d(dtype=dtype),
        luminance_blocks: wp.array3d(dtype=vec_block),
        events_image: wp.array3d(dtype=dtype),
        events_blocks: wp.array3d(dtype=vec_block),
        motion: wp.array2d(dtype=dtype),
        mask: wp.array3d(dtype=dtype),
        mask_blocks: wp.array3d(dtype=vec_block),
        adj_cost: wp.array(dtype=dtype),
        adj_events_out: wp.array3d(dtype=dtype),
        adj_events_blocks_out: wp.array3d(dtype=vec_block),
    ):
        b, y = wp.tid()
        width = luminance.shape[2]
        adj = adj_cost[b]
        blocks = wp.int32(0)
        if wp.static(block > 1):
            blocks = wp.max(width - 2, 0) // block
            for k in range(blocks):
                x = 1 + block * k
                residuals = residual_of_block(luminance_blocks, events_blocks, motion, b, y, x)
                adj_events_blocks_out[b, y, x] = adj * wp.cw_mul(mask_blocks[b, y, x], residuals)
        for i in range(width - block * blocks):
            x = wp.where(i == 0, 0, block * blocks + i)
            residual = residual_of_pixel(luminance, events_image, motion, b, y, x)
            adj_events_out[b, y, x] = adj * mask[b, y, x] * residual

    return adjoint_of_residual


def brightness_cost_adjoint(
    luminance, events_image, motion, mask, adj_cost, rows_out, adj_luminance_out, adj_events_out,
    adj_motion_out,
) -> None:  # fmt: skip
    """Launch all passes; overwrites."""
    block = CPU_BLOCK if luminance.device.is_cpu else 1
    launch(
        make_adjoint_of_residual(luminance.dtype, block),
        luminance.shape[:2],
        inputs=[
            luminance, neighbours(luminance, block), events_image, neighbours(events_image, block), motion,
            mask, neighbours(mask, block), adj_cost,
        ],
        outputs=[adj_events_out, neighbours(adj_events_out, block)],
        device=luminance.device,
    )  # fmt: skip
    brightness_residual_adjoint(luminance, motion, adj_events_out, rows_out, adj_luminance_out, adj_motion_out)
