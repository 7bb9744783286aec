"""Image of a grid of modules under an affine map; the formulas are in ``warp_backend/render.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.sums import add_partials


@ti.func
def node(grid: ti.template(), outside: ti.template(), b, j, i):
    """Look a node up, which may lie beyond the grid."""
    value = outside[b]
    if j >= 0 and i >= 0 and j < grid.shape[1] and i < grid.shape[2]:
        value = grid[b, j, i]
    return value


@cache
def make_near(dtype):
    """Build the test whether a position sees any node of the grid; also false for NaN."""

    @ti.func
    def near(u, v, rows, columns):
        return u > dtype(-1.0) and v > dtype(-1.0) and u < dtype(columns) and v < dtype(rows)

    return near


@cache
def make_render_affine(dtype):
    """Build the forward kernel; one thread per row of pixels."""
    near = make_near(dtype)

    @ti.kernel
    def render_affine(
        grid: array(dtype, 3),
        affine: array(dtype, 2),
        outside: array(dtype, 1),
        image_out: array(dtype, 3),
    ):
        for b, y in ti.ndrange(image_out.shape[0], image_out.shape[1]):
            u0 = affine[b, 1] * dtype(y) + affine[b, 2]
            v0 = affine[b, 4] * dtype(y) + affine[b, 5]
            for x in range(image_out.shape[2]):
                u = affine[b, 0] * dtype(x) + u0
                v = affine[b, 3] * dtype(x) + v0
                value = outside[b]
                if near(u, v, grid.shape[1], grid.shape[2]):
                    i = int(ti.floor(u))
                    j = int(ti.floor(v))
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
    launch(make_render_affine(float_of(grid)), grid, affine, outside, image_out)


@cache
def make_adjoint_of_affine(dtype):
    """Build the adjoint in the affine map; one thread per row of pixels."""
    near = make_near(dtype)

    @ti.kernel
    def adjoint_of_affine(
        grid: array(dtype, 3),
        affine: array(dtype, 2),
        outside: array(dtype, 1),
        adj_image: array(dtype, 3),
        rows_out: array(dtype, 3),
    ):
        for b, y in ti.ndrange(adj_image.shape[0], adj_image.shape[1]):
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
                    i = int(ti.floor(u))
                    j = int(ti.floor(v))
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
def make_adjoint_of_grid(dtype):
    """Build the adjoint in the grid; one thread per node, which visits the pixels that can see it."""

    @ti.func
    def clamp(value, low, high):
        return ti.min(ti.max(value, low), high)

    @ti.kernel
    def adjoint_of_grid(affine: array(dtype, 2), adj_image: array(dtype, 3), adj_grid_out: array(dtype, 3)):
        for b, j, i in ti.ndrange(adj_grid_out.shape[0], adj_grid_out.shape[1], adj_grid_out.shape[2]):
            w0 = affine[b, 0]
            w1 = affine[b, 1]
            w3 = affine[b, 3]
            w4 = affine[b, 4]
            height = adj_image.shape[1]
            width = adj_image.shape[2]
            # the square of half side 1 around the node, in the image; all of the image where the map cannot
            # be inverted
            top = 0
            bottom = height
            left = 0
            right = width
            determinant = w0 * w4 - w1 * w3
            u = dtype(i) - affine[b, 2]
            v = dtype(j) - affine[b, 5]
            if determinant != dtype(0.0):
                centre_x = (w4 * u - w1 * v) / determinant
                centre_y = (w0 * v - w3 * u) / determinant
                reach_x = (ti.abs(w4) + ti.abs(w1)) / ti.abs(determinant) + dtype(1.0)
                reach_y = (ti.abs(w0) + ti.abs(w3)) / ti.abs(determinant) + dtype(1.0)
                left = int(clamp(centre_x - reach_x, dtype(0.0), dtype(width)))
                right = int(clamp(ti.ceil(centre_x + reach_x), dtype(-1.0), dtype(width - 1))) + 1
                top = int(clamp(centre_y - reach_y, dtype(0.0), dtype(height)))
                bottom = int(clamp(ti.ceil(centre_y + reach_y), dtype(-1.0), dtype(height - 1))) + 1
            total = dtype(0.0)
            for y in range(top, bottom):
                along = dtype(0.0)
                for x in range(left, right):
                    share_u = dtype(1.0) - ti.abs(w0 * dtype(x) + w1 * dtype(y) - u)
                    share_v = dtype(1.0) - ti.abs(w3 * dtype(x) + w4 * dtype(y) - v)
                    if share_u > dtype(0.0) and share_v > dtype(0.0):
                        along += adj_image[b, y, x] * share_u * share_v
                total += along
            adj_grid_out[b, j, i] = total

    return adjoint_of_grid


def render_affine_adjoint(grid, affine, outside, adj_image, rows_out, adj_grid_out, adj_affine_out) -> None:
    """Launch; overwrites."""
    dtype = float_of(grid)
    launch(make_adjoint_of_affine(dtype), grid, affine, outside, adj_image, rows_out)
    add_partials(rows_out, adj_affine_out)
    launch(make_adjoint_of_grid(dtype), affine, adj_image, adj_grid_out)
