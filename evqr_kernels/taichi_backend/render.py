"""Image of a grid of modules under an affine map or a homography; see ``warp_backend/render.py``."""

import math
from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, row_of, run_at, ti
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.transcendental import make_erf, make_exp

EDGE = 6.0
"""Standard deviations from an edge of a module at which its blur ends."""

INVERSE_SQRT2 = math.sqrt(0.5)

STRETCH = 1.0 / math.erf(EDGE * INVERSE_SQRT2)
"""What makes a blurred edge 0 and 1 from `EDGE` on."""

DENSITY = STRETCH / math.sqrt(2.0 * math.pi)


def reach_of(sigma: float) -> float:
    """Give how far from its node a module is seen [modules]."""
    return 0.5 + EDGE * sigma if sigma else 1.0


def taps_of(sigma: float) -> int:
    """Give how many nodes along an axis a pixel sees, at most; 2 means bilinear."""
    return max(math.ceil(2.0 * reach_of(sigma)), 3) if sigma else 2


@ti.func
def map_of(to_grid: ti.template(), b, parameters: ti.template()):
    """Give a window's map as a vector."""
    return ti.Vector([to_grid[b, k] for k in range(parameters)])


@cache
def make_look(dtype, parameters: int):
    """Build the function that maps a pixel to the grid: u, v, and 1 / d or 0 where d is not positive."""

    @ti.func
    def look(w, x, y):
        u = w[0] * x + (w[1] * y + w[2])
        v = w[3] * x + (w[4] * y + w[5])
        inverse_depth = dtype(1.0)
        if ti.static(parameters == 8):
            depth = w[6] * x + (w[7] * y + dtype(1.0))
            inverse_depth = ti.select(depth > dtype(0.0), dtype(1.0) / depth, dtype(0.0))
            u *= inverse_depth
            v *= inverse_depth
        return u, v, inverse_depth

    return look


@cache
def make_near(dtype):
    """Build the test whether a position sees any node of the grid; also false for NaN."""

    @ti.func
    def near(u, v, inverse_depth, reach, rows, columns):
        return (
            inverse_depth > dtype(0.0)
            and u > -reach
            and v > -reach
            and u < dtype(columns - 1) + reach
            and v < dtype(rows - 1) + reach
        )

    return near


@cache
def make_edge(dtype):
    """Build the blurred edge P, and its slope."""
    erf = make_erf(dtype)
    exp = make_exp(dtype)

    @ti.func
    def edge(z):
        value = dtype(0.0)
        slope = dtype(0.0)
        if z >= dtype(EDGE):
            value = dtype(1.0)
        elif z > dtype(-EDGE):
            gauss = exp(dtype(-0.5) * z * z)
            value = dtype(0.5) + dtype(0.5 * STRETCH) * erf(z * dtype(INVERSE_SQRT2), gauss)
            slope = dtype(DENSITY) * gauss
        return value, slope

    return edge


@cache
def make_profile(dtype, taps: int):
    """Build the function that gives the first node a position sees, b of all that it sees, and b'."""
    edge = make_edge(dtype)

    @ti.func
    def bilinear(u, sigma):
        first = int(ti.floor(u))
        f = u - dtype(first)
        one = dtype(1.0)
        return first, ti.Vector([one - f, f]), ti.Vector([-one, one])

    @ti.func
    def smooth(u, sigma):
        first = int(ti.floor(u - dtype(0.5) - dtype(EDGE) * sigma)) + 1
        inverse_sigma = dtype(1.0) / sigma
        value = ti.Vector.zero(dtype, taps)
        slope = ti.Vector.zero(dtype, taps)
        before, before_slope = edge((u - dtype(first) + dtype(0.5)) * inverse_sigma)
        for k in range(taps):
            after, after_slope = edge((u - dtype(first + k) - dtype(0.5)) * inverse_sigma)
            value[k] = before - after
            slope[k] = (before_slope - after_slope) * inverse_sigma
            before = after
            before_slope = after_slope
        return first, value, slope

    return bilinear if taps == 2 else smooth


@cache
def make_row_of_nodes(dtype, taps: int):
    """Build the look-up of ``taps`` nodes of a row, some beyond the grid unless all are ``within``."""

    @ti.func
    def row_of_nodes(grid: ti.template(), within, beyond, b, j, i):
        nodes = ti.Vector([beyond for _ in range(taps)])
        if within:
            at = run_at(row_of(grid, b, j) + i)
            for k in ti.static(range(taps)):
                nodes[k] = grid[0, 0, at + k]
        elif j >= 0 and j < grid.shape[1]:
            for k in ti.static(range(taps)):
                if i + k >= 0 and i + k < grid.shape[2]:
                    nodes[k] = grid[b, j, i + k]
        return nodes

    return row_of_nodes


@ti.func
def all_within(grid: ti.template(), j, i, taps: ti.template()):
    """Tell whether all nodes that a pixel sees are of the grid."""
    return j >= 0 and i >= 0 and j + taps <= grid.shape[1] and i + taps <= grid.shape[2]


@cache
def make_render_code(dtype, parameters: int, taps: int):
    """Build the kernel for a map and a number of taps; one thread per row of pixels."""
    look = make_look(dtype, parameters)
    near = make_near(dtype)
    profile = make_profile(dtype, taps)
    row_of_nodes = make_row_of_nodes(dtype, taps)

    @ti.kernel
    def render_code(
        grid: array(dtype, 3),
        to_grid: array(dtype, 2),
        outside: array(dtype, 1),
        sigma: dtype,
        reach: dtype,
        image_out: array(dtype, 3),
    ):
        for b, y in ti.ndrange(image_out.shape[0], image_out.shape[1]):
            rows = grid.shape[1]
            columns = grid.shape[2]
            beyond = outside[b]
            w = map_of(to_grid, b, parameters)
            for x in range(image_out.shape[2]):
                u, v, inverse_depth = look(w, dtype(x), dtype(y))
                value = beyond
                if near(u, v, inverse_depth, reach, rows, columns):
                    i, share_u, _slope_u = profile(u, sigma)
                    j, share_v, _slope_v = profile(v, sigma)
                    within = all_within(grid, j, i, taps)
                    value = dtype(0.0)
                    if ti.static(taps == 2):
                        for k in ti.static(range(taps)):
                            value += share_v[k] * share_u.dot(row_of_nodes(grid, within, beyond, b, j + k, i))
                    else:  # unrolled it would take minutes to compile
                        for k in range(taps):
                            value += share_v[k] * share_u.dot(row_of_nodes(grid, within, beyond, b, j + k, i))
                image_out[b, y, x] = value

    return render_code


def render_code(grid, to_grid, outside, sigma: float, image_out) -> None:
    """Launch; overwrites."""
    kernel = make_render_code(float_of(grid), to_grid.shape[1], taps_of(sigma))
    launch(kernel, grid, to_grid, outside, sigma, reach_of(sigma), image_out)
