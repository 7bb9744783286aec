"""Residual of the brightness change along a motion: what the method's cost sums the squares of.

    residual(y, x) = m_x L_x(y, x) + m_y L_y(y, x) + E(y, x)

with m the motion [px per window], L the luminance, E the image of events and L_x, L_y central differences;
beyond the border lies the border's own pixel again.  Adjoint, for a = d loss / d residual, continued beyond
the border by minus the border's own value:

    adj_L(y, x)  = m_x (a(y, x - 1) - a(y, x + 1)) / 2 + m_y (a(y - 1, x) - a(y + 1, x)) / 2
    adj_m        = sum_{y, x} a (L_x, L_y)
    adj_E        = a

A thread takes a row by blocks of neighbouring pixels, which is what a CPU's vector units want, the last of
which may overlap the one before; the first and the last pixel, which have no neighbour on one side, and all
of a narrow image or on a GPU, it takes one by one; so do the adjoint's sums what is left of whole blocks.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, variant, vector
from evqr_kernels.warp_backend.sums import add_partials


@cache
def make_slopes(dtype: type) -> wp.Function:
    """Build the central differences at one pixel."""

    @wp.func
    def slopes(image: wp.array3d(dtype=dtype), b: int, y: int, x: int):
        right = image[b, y, wp.min(x + 1, image.shape[2] - 1)]
        left = image[b, y, wp.max(x - 1, 0)]
        below = image[b, wp.min(y + 1, image.shape[1] - 1), x]
        above = image[b, wp.max(y - 1, 0), x]
        return dtype(0.5) * (right - left), dtype(0.5) * (below - above)

    return slopes


@cache
def make_residual_of_pixel(dtype: type) -> wp.Function:
    """Build the residual at one pixel."""
    slopes = make_slopes(dtype)

    @wp.func
    def residual_of_pixel(
        luminance: wp.array3d(dtype=dtype),
        events_image: wp.array3d(dtype=dtype),
        motion: wp.array2d(dtype=dtype),
        b: int,
        y: int,
        x: int,
    ):
        dx, dy = slopes(luminance, b, y, x)
        return motion[b, 0] * dx + motion[b, 1] * dy + events_image[b, y, x]

    return residual_of_pixel


@cache
def make_residual_of_block(dtype: type, block: int) -> wp.Function:
    """Build the residual at neighbouring pixels of a row, all of which have one on either side in it."""
    vec_block = vector(block, dtype)

    @wp.func
    def residual_of_block(
        luminance_blocks: wp.array3d(dtype=vec_block),
        events_blocks: wp.array3d(dtype=vec_block),
        motion: wp.array2d(dtype=dtype),
        b: int,
        y: int,
        x: int,
    ):
        above = wp.max(y - 1, 0)
        below = wp.min(y + 1, luminance_blocks.shape[1] - 1)
        half_x = dtype(0.5) * motion[b, 0]
        half_y = dtype(0.5) * motion[b, 1]
        # in another order the compiler takes the pixels of a block one by one
        along_x = luminance_blocks[b, y, x + 1] - luminance_blocks[b, y, x - 1]
        across = half_x * along_x + events_blocks[b, y, x]
        along_y = luminance_blocks[b, below, x] - luminance_blocks[b, above, x]
        return half_y * along_y + across

    return residual_of_block


@cache
def make_brightness_residual(dtype: type, block: int) -> wp.Kernel:
    """Build the forward kernel; launch: one thread per row.

    ``.._blocks``: `neighbours` of the array before.
    """
    vec_block = vector(block, dtype)
    residual_of_pixel = make_residual_of_pixel(dtype)
    residual_of_block = make_residual_of_block(dtype, block)

    @wp.kernel(module=module_of(f"residual_{block}", dtype))
    def brightness_residual(
        luminance: wp.array3d(dtype=dtype),
        luminance_blocks: wp.array3d(dtype=vec_block),
        events_image: wp.array3d(dtype=dtype),
        events_blocks: wp.array3d(dtype=vec_block),
        motion: wp.array2d(dtype=dtype),
        residual_out: wp.array3d(dtype=dtype),
        residual_blocks_out: wp.array3d(dtype=vec_block),
    ):
        b, y = wp.tid()
        width = luminance.shape[2]
        singles = width
        if wp.static(block > 1):
            if width - 2 >= block:
                singles = wp.int32(2)
                for k in range((width - 3 + block) // block):
                    x = wp.min(1 + block * k, width - 1 - block)  # the last block overlaps the one before
                    residual_blocks_out[b, y, x] = residual_of_block(
                        luminance_blocks, events_blocks, motion, b, y, x
                    )
        for i in range(singles):
            x = wp.where(i == 0, 0, width - singles + i)
            residual_out[b, y, x] = residual_of_pixel(luminance, events_image, motion, b, y, x)

    return brightness_residual


def brightness_residual(luminance, events_image, motion, residual_out) -> None:
    """Launch; overwrites."""
    block = variant("brightness_residual", luminance.device).tile
    launch(
        make_brightness_residual(luminance.dtype, block),
        luminance.shape[:2],
        inputs=[
            luminance, neighbours(luminance, block), events_image, neighbours(events_image, block), motion,
        ],
        outputs=[residual_out, neighbours(residual_out, block)],
        device=luminance.device,
    )  # fmt: skip


@cache
def make_adjoint_of_row(dtype: type, block: int) -> wp.Function:
    """Build what writes a row of the adjoint in the luminance, for a given one of the residual."""
    vec_block = vector(block, dtype)

    @wp.func
    def beyond(adj: wp.array3d(dtype=dtype), b: int, y: int, x: int) -> dtype:
        row = wp.clamp(y, 0, adj.shape[1] - 1)
        column = wp.clamp(x, 0, adj.shape[2] - 1)
        value = adj[b, row, column]
        if row != y or column != x:
            value = -value
        return value

    @wp.func
    def adjoint_of_row(
        adj: wp.array3d(dtype=dtype),
        adj_blocks: wp.array3d(dtype=vec_block),
        motion: wp.array2d(dtype=dtype),
        b: int,
        y: int,
        out: wp.array3d(dtype=dtype),
        blocks_out: wp.array3d(dtype=vec_block),
    ):
        width = adj.shape[2]
        half_x = dtype(0.5) * motion[b, 0]
        half_y = dtype(0.5) * motion[b, 1]
        singles = width
        if wp.static(block > 1):
            if width - 2 >= block:
                singles = wp.int32(2)
                above = wp.max(y - 1, 0)
                below = wp.min(y + 1, adj.shape[1] - 1)
                from_above = half_y
                from_below = -half_y
                if above == y:
                    from_above = -from_above
                if below == y:
                    from_below = -from_below
                for k in range((width - 3 + block) // block):
                    x = wp.min(1 + block * k, width - 1 - block)  # the last block overlaps the one before
                    along_x = adj_blocks[b, y, x - 1] - adj_blocks[b, y, x + 1]
                    along_y = from_above * adj_blocks[b, above, x] + from_below * adj_blocks[b, below, x]
                    blocks_out[b, y, x] = half_x * along_x + along_y
        for i in range(singles):
            x = wp.where(i == 0, 0, width - singles + i)
            left_right = beyond(adj, b, y, x - 1) - beyond(adj, b, y, x + 1)
            up_down = beyond(adj, b, y - 1, x) - beyond(adj, b, y + 1, x)
            out[b, y, x] = half_x * left_right + half_y * up_down

    return adjoint_of_row


@cache
def make_brightness_residual_adjoint(dtype: type, block: int) -> wp.Kernel:
    """Build the adjoint kernel; launch and blocks as forward."""
    vec_block = vector(block, dtype)
    slopes = make_slopes(dtype)
    adjoint_of_row = make_adjoint_of_row(dtype, block)

    @wp.kernel(module=module_of(f"residual_{block}", dtype))
    def brightness_residual_adjoint(
        luminance: wp.array3d(dtype=dtype),
        luminance_blocks: wp.array3d(dtype=vec_block),
        motion: wp.array2d(dtype=dtype),
        adj_residual: wp.array3d(dtype=dtype),
        adj_blocks: wp.array3d(dtype=vec_block),
        rows_out: wp.array3d(dtype=dtype),
        adj_luminance_out: wp.array3d(dtype=dtype),
        adj_luminance_blocks_out: wp.array3d(dtype=vec_block),
    ):
        b, y = wp.tid()
        width = luminance.shape[2]
        adj_x = dtype(0.0)
        adj_y = dtype(0.0)
        blocks = wp.int32(0)
        if wp.static(block > 1):
            above = wp.max(y - 1, 0)
            below = wp.min(y + 1, luminance.shape[1] - 1)
            sums_x = vec_block()
            sums_y = vec_block()
            blocks = wp.max(width - 2, 0) // block
            for k in range(blocks):
                x = 1 + block * k
                adj = adj_blocks[b, y, x]
                sums_x += wp.cw_mul(adj, luminance_blocks[b, y, x + 1] - luminance_blocks[b, y, x - 1])
                sums_y += wp.cw_mul(adj, luminance_blocks[b, below, x] - luminance_blocks[b, above, x])
            for k in range(wp.static(block)):
                adj_x += dtype(0.5) * sums_x[k]
                adj_y += dtype(0.5) * sums_y[k]
        for i in range(width - block * blocks):
            x = wp.where(i == 0, 0, block * blocks + i)
            dx, dy = slopes(luminance, b, y, x)
            adj_x += adj_residual[b, y, x] * dx
            adj_y += adj_residual[b, y, x] * dy
        rows_out[b, y, 0] = adj_x
        rows_out[b, y, 1] = adj_y
        adjoint_of_row(adj_residual, adj_blocks, motion, b, y, adj_luminance_out, adj_luminance_blocks_out)

    return brightness_residual_adjoint


def brightness_residual_adjoint(
    luminance, motion, adj_residual, rows_out, adj_luminance_out, adj_motion_out
) -> None:
    """Launch both passes; overwrites."""
    block = variant("brightness_residual_adjoint", luminance.device).tile
    launch(
        make_brightness_residual_adjoint(luminance.dtype, block),
        luminance.shape[:2],
        inputs=[
            luminance, neighbours(luminance, block), motion, adj_residual, neighbours(adj_residual, block),
        ],
        outputs=[rows_out, adj_luminance_out, neighbours(adj_luminance_out, block)],
        device=luminance.device,
    )  # fmt: skip
    add_partials(rows_out, adj_motion_out)
