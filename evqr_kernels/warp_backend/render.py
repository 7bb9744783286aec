"""Image of a grid of modules under an affine map.

A pixel (x, y) looks at the grid at ``u = W_0 x + W_1 y + W_2``, ``v = W_3 x + W_4 y + W_5``, integers being
the nodes (module centres), bilinearly between them; beyond the grid every node is ``outside``:

    image(y, x) = sum_{j, i} q(j, i) hat(v - j) hat(u - i),        hat(s) = max(0, 1 - |s|)

With ``outside`` 0 this is equation 5 of the paper.  Adjoint, for adj = d loss / d image:

    adj_q(j, i)    = sum_{y, x} adj hat(v - j) hat(u - i)
    adj_W_0..2     = sum_{y, x} adj dimage_du (x, y, 1)
    adj_W_3..5     = sum_{y, x} adj dimage_dv (x, y, 1)

Each node gathers from the pixels that can see it, each row of pixels sums its part of adj_W: no atomics,
deterministic.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of
from evqr_kernels.warp_backend.sums import add_partials


@cache
def make_node(dtype: type) -> wp.Function:
    """Build the look-up of a node, which may lie beyond the grid."""

    @wp.func
    def node(grid: wp.array3d(dtype=dtype), outside: wp.array(dtype=dtype), b: int, j: int, i: int) -> dtype:
        value = outside[b]
        if j >= 0 and i >= 0 and j < grid.shape[1] and i < grid.shape[2]:
            value = grid[b, j, i]
        return value

    return node


@cache
def make_near(dtype: type) -> wp.Function:
    """Build the test whether a position sees any node of the grid; also false for NaN."""

    @wp.func
    def near(u: dtype, v: dtype, rows: int, columns: int) -> bool:
        return u > dtype(-1.0) and v > dtype(-1.0) and u < dtype(columns) and v < dtype(rows)

    return near


@cache
def make_render_affine(dtype: type) -> wp.Kernel:
    """Build the forward kernel; launch: one thread per row of pixels."""
    node = make_node(dtype)
    near = make_near(dtype)

    @wp.kernel(module=module_of("render", dtype))
    def render_affine(
        grid: wp.array3d(dtype=dtype),
        affine: wp.array2d(dtype=dtype),
        outside: wp.array(dtype=dtype),
        image_out: wp.array3d(dtype=dtype),
    ):
        b, y = wp.tid()
        u0 = affine[b, 1] * dtype(y) + affine[b, 2]
        v0 = affine[b, 4] * dtype(y) + affine[b, 5]
        for x in range(image_out.shape[2]):
            u = affine[b, 0] * dtype(x) + u0
            v = affine[b, 3] * dtype(x) + v0
            value = outside[b]
            if near(u, v, grid.shape[1], grid.shape[2]):
                i = int(wp.floor(u))
                j = int(wp.floor(v))
                fu = u - dtype(i)
                top = node(grid, outside, b, j, i)
                top += fu * (node(grid, outside, b, j, i + 1) - top)
                bottom = node(grid, outside, b, j + 1, i)
                bottom += fu * (node(grid, outside, b, j + 1, i + 1) - bottom)
                value = top + (v - dtype(j)) * (bottom - top)
            image_out[b, y, x] = value

    return render_affine


def render_affine(grid, affine, outside, image_out) -> None:
    """Launch; overwrites."""
    launch(
        make_render_affine(grid.dtype),
        image_out.shape[:2],
        inputs=[grid, affine, outside],
        outputs=[image_out],
        device=grid.device,
    )


@cache
def make_adjoint_of_affine(dtype: type) -> wp.Kernel:
    """Build the adjoint in the affine map; launch: one thread per row of pixels."""
    node = make_node(dtype)
    near = make_near(dtype)

    @wp.kernel(module=module_of("render_adjoint", dtype))
    def adjoint_of_affine(
        grid: wp.array3d(dtype=dtype),
        affine: wp.array2d(dtype=dtype),
        outside: wp.array(dtype=dtype),
        adj_image: wp.array3d(dtype=dtype),
        rows_out: wp.array3d(dtype=dtype),
    ):
        b, y = wp.tid()
        u0 = affine[b, 1] * dtype(y) + affine[b, 2]
        v0 = affine[b, 4] * dtype(y) + affine[b, 5]
        sum_u = dtype(0.0)
        sum_v = dtype(0.0)
        sum_ux = dtype(0.0)
        sum_vx = dtype(0.0)
        for x in range(adj_image.shape[2]):
            u = affine[b, 0] * dtype(x) + u0
            v = affine[b, 3] * dtype(x) + v0
            if near(u, v, grid.shape[1], grid.shape[2]):
                i = int(wp.floor(u))
                j = int(wp.floor(v))
                q00 = node(grid, outside, b, j, i)
                q01 = node(grid, outside, b, j, i + 1)
                q10 = node(grid, outside, b, j + 1, i)
                q11 = node(grid, outside, b, j + 1, i + 1)
                twist = q11 - q10 - q01 + q00
                adj_u = adj_image[b, y, x] * (q01 - q00 + (v - dtype(j)) * twist)
                adj_v = adj_image[b, y, x] * (q10 - q00 + (u - dtype(i)) * twist)
                sum_u += adj_u
                sum_v += adj_v
                sum_ux += adj_u * dtype(x)
                sum_vx += adj_v * dtype(x)
        rows_out[b, y, 0] = sum_ux
        rows_out[b, y, 1] = sum_u * dtype(y)
        rows_out[b, y, 2] = sum_u
        rows_out[b, y, 3] = sum_vx
        rows_out[b, y, 4] = sum_v * dtype(y)
        rows_out[b, y, 5] = sum_v

    return adjoint_of_affine


@cache
def make_adjoint_of_grid(dtype: type) -> wp.Kernel:
    """Build the adjoint in the grid; launch: one thread per node, which visits the pixels that can see it."""

    @wp.kernel(module=module_of("render_adjoint", dtype))
    def adjoint_of_grid(
        affine: wp.array2d(dtype=dtype),
        adj_image: wp.array3d(dtype=dtype),
        adj_grid_out: wp.array3d(dtype=dtype),
    ):
        b, j, i = wp.tid()
        w0 = affine[b, 0]
        w1 = affine[b, 1]
        w3 = affine[b, 3]
        w4 = affine[b, 4]
        height = adj_image.shape[1]
        width = adj_image.shape[2]
        # the square of half side 1 around the node, in the image; all of the image where the map cannot be
        # inverted
        top = wp.int32(0)
        bottom = height
        left = wp.int32(0)
        right = width
        determinant = w0 * w4 - w1 * w3
        u = dtype(i) - affine[b, 2]
        v = dtype(j) - affine[b, 5]
        if determinant != dtype(0.0):
            centre_x = (w4 * u - w1 * v) / determinant
            centre_y = (w0 * v - w3 * u) / determinant
            reach_x = (wp.abs(w4) + wp.abs(w1)) / wp.abs(determinant) + dtype(1.0)
            reach_y = (wp.abs(w0) + wp.abs(w3)) / wp.abs(determinant) + dtype(1.0)
            left = int(wp.clamp(centre_x - reach_x, dtype(0.0), dtype(width)))
            right = int(wp.clamp(wp.ceil(centre_x + reach_x), dtype(-1.0), dtype(width - 1))) + 1
            top = int(wp.clamp(centre_y - reach_y, dtype(0.0), dtype(height)))
            bottom = int(wp.clamp(wp.ceil(centre_y + reach_y), dtype(-1.0), dtype(height - 1))) + 1
        total = dtype(0.0)
        for y in range(top, bottom):
            along = dtype(0.0)
            for x in range(left, right):
                share_u = dtype(1.0) - wp.abs(w0 * dtype(x) + w1 * dtype(y) - u)
                share_v = dtype(1.0) - wp.abs(w3 * dtype(x) + w4 * dtype(y) - v)
                if share_u > dtype(0.0) and share_v > dtype(0.0):
                    along += adj_image[b, y, x] * share_u * share_v
            total += along
        adj_grid_out[b, j, i] = total

    return adjoint_of_grid


def render_affine_adjoint(grid, affine, outside, adj_image, rows_out, adj_grid_out, adj_affine_out) -> None:
    """Launch; overwrites."""
    dtype, device = grid.dtype, grid.device
    launch(
        make_adjoint_of_affine(dtype),
        adj_image.shape[:2],
        inputs=[grid, affine, outside, adj_image],
        outputs=[rows_out],
        device=device,
    )
    add_partials(rows_out, adj_affine_out)
    launch(
        make_adjoint_of_grid(dtype),
        grid.shape,
        inputs=[affine, adj_image],
        outputs=[adj_grid_out],
        device=device,
    )
