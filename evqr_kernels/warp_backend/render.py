"""Image of a grid of modules under an affine map or a homography.

A pixel (x, y) looks at the grid at

    u = (W_0 x + W_1 y + W_2) / d,    v = (W_3 x + W_4 y + W_5) / d,    d = W_6 x + W_7 y + 1

(six parameters: d = 1), integers being the nodes (module centres), and sees

    image(y, x) = sum_{j, i} q(j, i) b(v - j) b(u - i)

where beyond the grid, and where d is not positive, every node is ``outside``.  The profile b of a module is

    sigma = 0:  b(s) = max(0, 1 - |s|)                                    bilinear, equation 5 of the paper
    sigma > 0:  b(s) = P((s + 1/2) / sigma) - P((s - 1/2) / sigma)        a box blurred by sigma modules

with P the normal distribution, stretched by 2e-9 so that it is 0 and 1 from six standard deviations on
without a jump.  Either way the profiles of all nodes add up to 1, and a few neighbours along each axis, the
taps, are all that a pixel sees.

The adjoints are in ``render_adjoint.py``.
"""

import math
from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import (
    last_axis_as_vector,
    launch,
    launch_bounds,
    module_of,
    neighbours,
    vector,
)

EDGE = 6.0
"""Standard deviations from an edge of a module at which its blur ends."""


def reach_of(sigma: float) -> float:
    """Give how far from its node a module is seen [modules]."""
    return 0.5 + EDGE * sigma if sigma else 1.0


def taps_of(sigma: float) -> int:
    """Give how many nodes along an axis a pixel sees, at most; 2 means bilinear."""
    return max(math.ceil(2.0 * reach_of(sigma)), 3) if sigma else 2


@cache
def make_look(dtype: type, parameters: int) -> wp.Function:
    """Build the function that maps a pixel to the grid: u, v, and 1 / d or 0 where d is not positive."""
    vec_map = vector(parameters, dtype)
    if parameters == 6:

        @wp.func
        def look(w: vec_map, x: dtype, y: dtype):
            return w[0] * x + (w[1] * y + w[2]), w[3] * x + (w[4] * y + w[5]), dtype(1.0)

        return look

    @wp.func
    def look_through(w: vec_map, x: dtype, y: dtype):
        depth = w[6] * x + (w[7] * y + dtype(1.0))
        inverse_depth = dtype(0.0)
        if depth > dtype(0.0):
            inverse_depth = dtype(1.0) / depth
        u = (w[0] * x + (w[1] * y + w[2])) * inverse_depth
        v = (w[3] * x + (w[4] * y + w[5])) * inverse_depth
        return u, v, inverse_depth

    return look_through


@cache
def make_near(dtype: type) -> wp.Function:
    """Build the test whether a position sees any node of the grid; also false for NaN."""

    @wp.func
    def near(u: dtype, v: dtype, inverse_depth: dtype, reach: dtype, rows: int, columns: int) -> bool:
        return (
            inverse_depth > dtype(0.0)
            and u > -reach
            and v > -reach
            and u < dtype(columns - 1) + reach
            and v < dtype(rows - 1) + reach
        )

    return near


@cache
def make_edge(dtype: type) -> wp.Function:
    """Build the blurred edge P, and its slope."""
    inverse_sqrt2 = wp.constant(dtype(math.sqrt(0.5)))
    half = wp.constant(dtype(0.5 / math.erf(EDGE * math.sqrt(0.5))))
    density = wp.constant(dtype(1.0 / (math.erf(EDGE * math.sqrt(0.5)) * math.sqrt(2.0 * math.pi))))
    end = wp.constant(dtype(EDGE))

    @wp.func
    def edge(z: dtype):
        value = dtype(0.0)
        slope = dtype(0.0)
        if z >= end:
            value = dtype(1.0)
        elif z > -end:
            value = dtype(0.5) + half * wp.erf(z * inverse_sqrt2)
            slope = density * wp.exp(dtype(-0.5) * z * z)
        return value, slope

    return edge


@cache
def make_profile(dtype: type, taps: int) -> wp.Function:
    """Build the function that gives the first node a position sees, b of all that it sees, and b'."""
    vec_taps = vector(taps, dtype)
    if taps == 2:

        @wp.func
        def bilinear(u: dtype, sigma: dtype):
            first = int(wp.floor(u))
            f = u - dtype(first)
            return first, vec_taps(dtype(1.0) - f, f), vec_taps(dtype(-1.0), dtype(1.0))

        return bilinear

    edge = make_edge(dtype)
    end = wp.constant(dtype(EDGE))

    @wp.func
    def smooth(u: dtype, sigma: dtype):
        first = int(wp.floor(u - dtype(0.5) - end * sigma)) + 1
        inverse_sigma = dtype(1.0) / sigma
        value = vec_taps()
        slope = vec_taps()
        before, before_slope = edge((u - dtype(first) + dtype(0.5)) * inverse_sigma)
        for k in range(wp.static(taps)):
            after, after_slope = edge((u - dtype(first + k) - dtype(0.5)) * inverse_sigma)
            value[k] = before - after
            slope[k] = (before_slope - after_slope) * inverse_sigma
            before = after
            before_slope = after_slope
        return first, value, slope

    return smooth


@cache
def make_row_of_nodes(dtype: type, taps: int, at_once: bool) -> wp.Function:
    """Build the look-up of ``taps`` nodes of a row, which may lie beyond the grid.

    ``rows``: `neighbours` of the grid, from which nodes are taken ``at_once`` where none is beyond: that is
    for CPUs; a GPU loads them one by one either way, and the choice takes registers.
    """
    vec_taps = vector(taps, dtype)

    @wp.func
    def row_of_nodes(
        grid: wp.array3d(dtype=dtype),
        rows: wp.array3d(dtype=vec_taps),
        outside: dtype,
        b: int,
        j: int,
        i: int,
    ) -> vec_taps:
        nodes = vec_taps()
        if wp.static(at_once) and j >= 0 and j < grid.shape[1] and i >= 0 and i + taps <= grid.shape[2]:
            nodes = rows[b, j, i]
        else:
            for k in range(wp.static(taps)):
                nodes[k] = outside
                if j >= 0 and j < grid.shape[1] and i + k >= 0 and i + k < grid.shape[2]:
                    nodes[k] = grid[b, j, i + k]
        return nodes

    return row_of_nodes


@cache
def make_render_code(dtype: type, parameters: int, taps: int, on_cpu: bool) -> wp.Kernel:
    """Build the kernel for a map and a number of taps; launch: one thread per row of pixels.

    ``on_cpu``: the variant for CPUs, which hold more in registers.
    """
    vec_map = vector(parameters, dtype)
    vec_taps = vector(taps, dtype)
    look = make_look(dtype, parameters)
    near = make_near(dtype)
    profile = make_profile(dtype, taps)
    row_of_nodes = make_row_of_nodes(dtype, taps, at_once=on_cpu)

    @wp.kernel(
        module=module_of(f"render_{parameters}_{taps}{'_on_cpu' * on_cpu}", dtype),
        launch_bounds=launch_bounds(dtype),
    )
    def render_code(
        grid: wp.array3d(dtype=dtype),
        grid_rows: wp.array3d(dtype=vec_taps),
        to_grid: wp.array(dtype=vec_map),
        outside: wp.array(dtype=dtype),
        sigma: dtype,
        reach: dtype,
        image_out: wp.array3d(dtype=dtype),
    ):
        b, y = wp.tid()
        w = to_grid[b]
        beyond = outside[b]
        for x in range(image_out.shape[2]):
            if wp.static(not on_cpu):
                w = to_grid[b]  # again, rather than keep it in registers
            u, v, inverse_depth = look(w, dtype(x), dtype(y))
            value = beyond
            if near(u, v, inverse_depth, reach, grid.shape[1], grid.shape[2]):
                i, share_u, _slope_u = profile(u, sigma)
                j, share_v, _slope_v = profile(v, sigma)
                value = dtype(0.0)
                for k in range(wp.static(taps)):
                    nodes = row_of_nodes(grid, grid_rows, beyond, b, j + k, i)
                    value += share_v[k] * wp.dot(share_u, nodes)
            image_out[b, y, x] = value

    return render_code


def render_code(grid, to_grid, outside, sigma: float, image_out) -> None:
    """Launch; overwrites."""
    taps = taps_of(sigma)
    launch(
        make_render_code(grid.dtype, to_grid.shape[1], taps, on_cpu=grid.device.is_cpu),
        image_out.shape[:2],
        inputs=[
            grid,
            neighbours(grid, taps),
            last_axis_as_vector(to_grid),
            outside,
            sigma,
            reach_of(sigma),
        ],
        outputs=[image_out],
        device=grid.device,
    )
