"""Adjoint of ``render_code`` in the grid and in the map; the formulas are in ``render.py``.

For adj = d loss / d image, and the pixel's slopes image_du, image_dv:

    adj_q(j, i)    = sum_{y, x} adj b(v - j) b(u - i)
    adj_W_0..2     = sum_{y, x} adj image_du / d (x, y, 1)
    adj_W_3..5     = sum_{y, x} adj image_dv / d (x, y, 1)
    adj_W_6..7     = -sum_{y, x} adj (image_du u + image_dv v) / d (x, y)

Each row of pixels sums its part of adj_W; a second pass adds the rows up.  On the CPU the same pass adds to
the nodes, atomically, which there is a plain addition.  On a GPU each node gathers from the pixels that can
see it, in a pass of its own.  Both repeat bit for bit.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import (
    clear,
    last_axis_as_vector,
    launch,
    module_of,
    neighbours,
    vector,
)
from evqr_kernels.warp_backend.render import (
    EDGE,
    make_edge,
    make_look,
    make_near,
    make_profile,
    make_row_of_nodes,
    reach_of,
    taps_of,
)
from evqr_kernels.warp_backend.sums import add_partials


@cache
def make_along_map(dtype: type) -> wp.Function:
    """Build the adjoint of one pixel along u, v and 1 / d, given ``adj`` = adj / d and the pixel's slopes."""
    vec3 = vector(3, dtype)

    @wp.func
    def along_map(adj: dtype, u: dtype, v: dtype, du: dtype, dv: dtype) -> vec3:
        return vec3(adj * du, adj * dv, adj * (du * u + dv * v))

    return along_map


@cache
def make_map_adjoint(dtype: type, parameters: int) -> wp.Function:
    """Build the adjoint of one row's maps, from sums over its pixels.

    ``at_0`` and ``at_x``: sums of (adj image_du, adj image_dv, adj (image_du u + image_dv v)) / d, plain and
    times x.
    """
    vec_map = vector(parameters, dtype)
    vec3 = vector(3, dtype)
    if parameters == 6:

        @wp.func
        def map_adjoint(at_0: vec3, at_x: vec3, y: dtype) -> vec_map:
            return vec_map(at_x[0], at_0[0] * y, at_0[0], at_x[1], at_0[1] * y, at_0[1])

        return map_adjoint

    @wp.func
    def homography_adjoint(at_0: vec3, at_x: vec3, y: dtype) -> vec_map:
        return vec_map(
            at_x[0], at_0[0] * y, at_0[0], at_x[1], at_0[1] * y, at_0[1], -at_x[2], -at_0[2] * y
        )  # fmt: skip

    return homography_adjoint


@cache
def make_node(dtype: type) -> wp.Function:
    """Build the look-up of one node, which may lie beyond the grid."""

    @wp.func
    def node(grid: wp.array3d(dtype=dtype), beyond: dtype, b: int, j: int, i: int) -> dtype:
        value = beyond
        if j >= 0 and j < grid.shape[1] and i >= 0 and i < grid.shape[2]:
            value = grid[b, j, i]
        return value

    return node


@cache
def make_slopes(dtype: type, taps: int) -> wp.Function:
    """Build the slopes of the image at a position, image_du and image_dv, for GPUs.

    Of blurred modules only numbers are kept, no profiles: a thread has 64 registers.  Rows of nodes, and in
    each the nodes, are visited one by one, for as long as an edge is in sight; a module is between the edge
    before and the edge after.  Edges along u are computed again for each row.
    """
    node = make_node(dtype)
    if taps == 2:

        @wp.func
        def bilinear(
            grid: wp.array3d(dtype=dtype),
            beyond: dtype,
            b: int,
            u: dtype,
            v: dtype,
            sigma: dtype,
            reach: dtype,
        ):
            i = int(wp.floor(u))
            j = int(wp.floor(v))
            f = u - dtype(i)
            g = v - dtype(j)
            top_left = node(grid, beyond, b, j, i)
            top_right = node(grid, beyond, b, j, i + 1)
            bottom_left = node(grid, beyond, b, j + 1, i)
            bottom_right = node(grid, beyond, b, j + 1, i + 1)
            du = (dtype(1.0) - g) * (top_right - top_left) + g * (bottom_right - bottom_left)
            dv = (dtype(1.0) - f) * (bottom_left - top_left) + f * (bottom_right - top_right)
            return du, dv

        return bilinear

    edge = make_edge(dtype)
    end = wp.constant(dtype(EDGE))

    @wp.func
    def row_of_modules(
        grid: wp.array3d(dtype=dtype),
        beyond: dtype,
        b: int,
        j: int,
        u: dtype,
        inverse_sigma: dtype,
        reach: dtype,
    ):
        """Give what a row of nodes adds up to at u, and sigma times its slope."""
        value = dtype(0.0)
        slope = dtype(0.0)
        before = dtype(1.0)
        before_slope = dtype(0.0)
        i = int(wp.floor(u - reach))  # before the first that is in sight
        z = dtype(0.0)
        while z > -end:
            i += 1
            q = node(grid, beyond, b, j, i)
            z = (u - dtype(i) - dtype(0.5)) * inverse_sigma
            after, after_slope = edge(z)
            value += (before - after) * q
            slope += (before_slope - after_slope) * q
            before = after
            before_slope = after_slope
        return value, slope

    @wp.func
    def smooth(
        grid: wp.array3d(dtype=dtype), beyond: dtype, b: int, u: dtype, v: dtype, sigma: dtype, reach: dtype
    ):
        inverse_sigma = dtype(1.0) / sigma
        du = dtype(0.0)
        dv = dtype(0.0)
        before = dtype(1.0)
        before_slope = dtype(0.0)
        j = int(wp.floor(v - reach))
        z = dtype(0.0)
        while z > -end:
            j += 1
            value, slope = row_of_modules(grid, beyond, b, j, u, inverse_sigma, reach)
            z = (v - dtype(j) - dtype(0.5)) * inverse_sigma
            after, after_slope = edge(z)
            du += (before - after) * slope
            dv += (before_slope - after_slope) * value
            before = after
            before_slope = after_slope
        return du * inverse_sigma, dv * inverse_sigma

    return smooth


@cache
def make_adjoint_of_rows(dtype: type, parameters: int, taps: int) -> wp.Kernel:
    """Build the adjoint in the map, for GPUs; launch: one thread per row of pixels."""
    vec_map = vector(parameters, dtype)
    vec3 = vector(3, dtype)
    look = make_look(dtype, parameters)
    near = make_near(dtype)
    slopes = make_slopes(dtype, taps)
    along_map = make_along_map(dtype)
    map_adjoint = make_map_adjoint(dtype, parameters)

    @wp.kernel(module=module_of(f"render_adjoint_{parameters}_{taps}", dtype))
    def adjoint_of_rows(
        grid: wp.array3d(dtype=dtype),
        to_grid: wp.array(dtype=vec_map),
        outside: wp.array(dtype=dtype),
        sigma: dtype,
        reach: dtype,
        adj_image: wp.array3d(dtype=dtype),
        rows_out: wp.array2d(dtype=vec_map),
    ):
        b, y = wp.tid()
        w = to_grid[b]
        beyond = outside[b]
        at_0 = vec3()
        at_x = vec3()
        for x in range(adj_image.shape[2]):
            u, v, inverse_depth = look(w, dtype(x), dtype(y))
            if near(u, v, inverse_depth, reach, grid.shape[1], grid.shape[2]):
                du, dv = slopes(grid, beyond, b, u, v, sigma, reach)
                along = along_map(adj_image[b, y, x] * inverse_depth, u, v, du, dv)
                at_0 += along
                at_x += dtype(x) * along
        rows_out[b, y] = map_adjoint(at_0, at_x, dtype(y))

    return adjoint_of_rows


@cache
def make_adjoint_of_rows_and_nodes(dtype: type, parameters: int, taps: int) -> wp.Kernel:
    """Build the adjoint in the map and in the grid, for CPUs; launch: one thread per row of pixels.

    ``.._rows``: `neighbours` of the array before.
    """
    vec_map = vector(parameters, dtype)
    vec_taps = vector(taps, dtype)
    vec3 = vector(3, dtype)
    look = make_look(dtype, parameters)
    near = make_near(dtype)
    profile = make_profile(dtype, taps)
    row_of_nodes = make_row_of_nodes(dtype, taps, at_once=True)
    along_map = make_along_map(dtype)
    map_adjoint = make_map_adjoint(dtype, parameters)

    @wp.kernel(module=module_of(f"render_adjoint_{parameters}_{taps}_on_cpu", dtype))
    def adjoint_of_rows_and_nodes(
        grid: wp.array3d(dtype=dtype),
        grid_rows: wp.array3d(dtype=vec_taps),
        to_grid: wp.array(dtype=vec_map),
        outside: wp.array(dtype=dtype),
        sigma: dtype,
        reach: dtype,
        adj_image: wp.array3d(dtype=dtype),
        rows_out: wp.array2d(dtype=vec_map),
        adj_grid_out: wp.array3d(dtype=dtype),
        adj_grid_rows_out: wp.array3d(dtype=vec_taps),
    ):
        b, y = wp.tid()
        w = to_grid[b]
        at_0 = vec3()
        at_x = vec3()
        for x in range(adj_image.shape[2]):
            u, v, inverse_depth = look(w, dtype(x), dtype(y))
            if near(u, v, inverse_depth, reach, grid.shape[1], grid.shape[2]):
                adj = adj_image[b, y, x]
                i, share_u, slope_u = profile(u, sigma)
                j, share_v, slope_v = profile(v, sigma)
                du = dtype(0.0)
                dv = dtype(0.0)
                for k in range(wp.static(taps)):
                    nodes = row_of_nodes(grid, grid_rows, outside[b], b, j + k, i)
                    du += share_v[k] * wp.dot(slope_u, nodes)
                    dv += slope_v[k] * wp.dot(share_u, nodes)
                    if j + k >= 0 and j + k < grid.shape[1]:
                        share = (adj * share_v[k]) * share_u
                        if i >= 0 and i + taps <= grid.shape[2]:
                            wp.atomic_add(adj_grid_rows_out, b, j + k, i, share)
                        else:
                            for m in range(wp.static(taps)):
                                if i + m >= 0 and i + m < grid.shape[2]:
                                    wp.atomic_add(adj_grid_out, b, j + k, i + m, share[m])
                along = along_map(adj * inverse_depth, u, v, du, dv)
                at_0 += along
                at_x += dtype(x) * along
        rows_out[b, y] = map_adjoint(at_0, at_x, dtype(y))

    return adjoint_of_rows_and_nodes


@cache
def make_share(dtype: type, taps: int) -> wp.Function:
    """Build the profile b of one module."""
    if taps == 2:

        @wp.func
        def hat(s: dtype, sigma: dtype) -> dtype:
            return wp.max(dtype(1.0) - wp.abs(s), dtype(0.0))

        return hat

    edge = make_edge(dtype)

    @wp.func
    def blurred_box(s: dtype, sigma: dtype) -> dtype:
        before, _slope = edge((s + dtype(0.5)) / sigma)
        after, _other = edge((s - dtype(0.5)) / sigma)
        return before - after

    return blurred_box


@cache
def make_pixels_around(dtype: type, parameters: int) -> wp.Function:
    """Build the function that gives the pixels that may look at a square of the grid.

    The square of half side ``reach`` around (u, v): first column and row, last column and row.  All of the
    image where a corner of the square is not in front of the map, or the map cannot be inverted.
    """
    vec_map = vector(parameters, dtype)
    vec4i = wp.types.vector(length=4, dtype=wp.int32)

    @wp.func
    def pixels_around(w: vec_map, u: dtype, v: dtype, reach: dtype, height: int, width: int) -> vec4i:
        w6 = dtype(0.0)
        w7 = dtype(0.0)
        if wp.static(parameters == 8):
            w6 = w[6]
            w7 = w[7]
        # rows of the adjugate of the map's matrix: its inverse, up to the determinant
        determinant = w[0] * (w[4] - w[5] * w7) - w[1] * (w[3] - w[5] * w6) + w[2] * (w[3] * w7 - w[4] * w6)
        left = dtype(width)
        right = dtype(-1.0)
        top = dtype(height)
        bottom = dtype(-1.0)
        in_front = determinant != dtype(0.0)
        for corner in range(4):
            s = u + wp.where(corner % 2 == 0, -reach, reach)
            r = v + wp.where(corner < 2, -reach, reach)
            x = (w[4] - w[5] * w7) * s + (w[2] * w7 - w[1]) * r + w[1] * w[5] - w[2] * w[4]
            y = (w[5] * w6 - w[3]) * s + (w[0] - w[2] * w6) * r + w[2] * w[3] - w[0] * w[5]
            depth = (w[3] * w7 - w[4] * w6) * s + (w[1] * w6 - w[0] * w7) * r + w[0] * w[4] - w[1] * w[3]
            # written so that it is false for NaN
            in_front = in_front and depth * determinant > dtype(0.0)
            left = wp.min(left, x / depth)
            right = wp.max(right, x / depth)
            top = wp.min(top, y / depth)
            bottom = wp.max(bottom, y / depth)
        around = vec4i(0, 0, width - 1, height - 1)
        if in_front:
            # a pixel more on each side for what rounding does
            around = vec4i(
                int(wp.max(wp.floor(left) - dtype(1.0), dtype(0.0))),
                int(wp.max(wp.floor(top) - dtype(1.0), dtype(0.0))),
                int(wp.min(wp.ceil(right) + dtype(1.0), dtype(width - 1))),
                int(wp.min(wp.ceil(bottom) + dtype(1.0), dtype(height - 1))),
            )
        return around

    return pixels_around


@cache
def make_adjoint_of_nodes(dtype: type, parameters: int, taps: int) -> wp.Kernel:
    """Build the adjoint in the grid; launch: one thread per node, which visits the pixels that can see it."""
    vec_map = vector(parameters, dtype)
    look = make_look(dtype, parameters)
    share = make_share(dtype, taps)
    pixels_around = make_pixels_around(dtype, parameters)

    @wp.kernel(module=module_of(f"render_adjoint_{parameters}_{taps}", dtype))
    def adjoint_of_nodes(
        to_grid: wp.array(dtype=vec_map),
        sigma: dtype,
        reach: dtype,
        adj_image: wp.array3d(dtype=dtype),
        adj_grid_out: wp.array3d(dtype=dtype),
    ):
        b, j, i = wp.tid()
        w = to_grid[b]
        around = pixels_around(w, dtype(i), dtype(j), reach, adj_image.shape[1], adj_image.shape[2])
        total = dtype(0.0)
        for y in range(around[1], around[3] + 1):
            along = dtype(0.0)
            for x in range(around[0], around[2] + 1):
                u, v, inverse_depth = look(w, dtype(x), dtype(y))
                du = u - dtype(i)
                dv = v - dtype(j)
                if inverse_depth > dtype(0.0) and wp.abs(du) < reach and wp.abs(dv) < reach:
                    along += adj_image[b, y, x] * share(du, sigma) * share(dv, sigma)
            total += along
        adj_grid_out[b, j, i] = total

    return adjoint_of_nodes


def launch_rows(grid, to_grid, outside, sigma: float, adj_image, rows_out) -> None:
    """Launch the pass over pixels; overwrites."""
    launch(
        make_adjoint_of_rows(grid.dtype, to_grid.shape[1], taps_of(sigma)),
        adj_image.shape[:2],
        inputs=[grid, last_axis_as_vector(to_grid), outside, sigma, reach_of(sigma), adj_image],
        outputs=[last_axis_as_vector(rows_out)],
        device=grid.device,
    )


def launch_nodes(to_grid, sigma: float, adj_image, adj_grid_out) -> None:
    """Launch the pass over nodes; overwrites."""
    launch(
        make_adjoint_of_nodes(adj_image.dtype, to_grid.shape[1], taps_of(sigma)),
        adj_grid_out.shape,
        inputs=[last_axis_as_vector(to_grid), sigma, reach_of(sigma), adj_image],
        outputs=[adj_grid_out],
        device=adj_image.device,
    )


def launch_rows_and_nodes(grid, to_grid, outside, sigma: float, adj_image, rows_out, adj_grid_out) -> None:
    """Launch both as one pass over pixels; overwrites."""
    taps = taps_of(sigma)
    clear(adj_grid_out)
    launch(
        make_adjoint_of_rows_and_nodes(grid.dtype, to_grid.shape[1], taps),
        adj_image.shape[:2],
        inputs=[
            grid,
            neighbours(grid, taps),
            last_axis_as_vector(to_grid),
            outside,
            sigma,
            reach_of(sigma),
            adj_image,
        ],
        outputs=[last_axis_as_vector(rows_out), adj_grid_out, neighbours(adj_grid_out, taps)],
        device=grid.device,
    )


def render_code_adjoint(
    grid, to_grid, outside, sigma: float, adj_image, rows_out, adj_grid_out, adj_to_grid_out
) -> None:
    """Launch the passes that suit the device; overwrites."""
    if grid.device.is_cpu:
        launch_rows_and_nodes(grid, to_grid, outside, sigma, adj_image, rows_out, adj_grid_out)
    else:
        launch_rows(grid, to_grid, outside, sigma, adj_image, rows_out)
        launch_nodes(to_grid, sigma, adj_image, adj_grid_out)
    add_partials(rows_out, adj_to_grid_out)
