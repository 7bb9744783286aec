"""Adjoint of ``render_code`` in the grid and in the map; see ``warp_backend/render_adjoint.py``.

On the CPU one thread owns a window: the pass over pixels adds to the nodes too.  Elsewhere each node gathers
from the pixels that can see it.
"""

from functools import cache

from evqr_kernels.taichi_backend.language import (
    array,
    float_of,
    indices_of_window,
    is_alone,
    is_on_cpu,
    row_of,
    run_at,
    ti,
)
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.render import (
    all_within,
    make_edge,
    make_look,
    make_near,
    make_profile,
    make_row_of_nodes,
    map_of,
    reach_of,
    taps_of,
)
from evqr_kernels.taichi_backend.sums import add_partials


@cache
def make_add_to_row(taps: int):
    """Build the addition to ``taps`` nodes of a row, as `make_row_of_nodes`; no other thread adds there."""

    @ti.func
    def add_to_row(grid: ti.template(), within, b, j, i, values):
        if within:
            at = run_at(row_of(grid, b, j) + i)
            for k in ti.static(range(taps)):
                grid[0, 0, at + k] = grid[0, 0, at + k] + values[k]
        elif j >= 0 and j < grid.shape[1]:
            for k in ti.static(range(taps)):
                if i + k >= 0 and i + k < grid.shape[2]:
                    grid[b, j, i + k] = grid[b, j, i + k] + values[k]

    return add_to_row


@cache
def make_adjoint_of_row(dtype, parameters: int, taps: int, scatter: bool):
    """Build the adjoint of a row of pixels in the map, and with ``scatter`` in the grid, added up there."""
    look = make_look(dtype, parameters)
    near = make_near(dtype)
    profile = make_profile(dtype, taps)
    row_of_nodes = make_row_of_nodes(dtype, taps)
    add_to_row = make_add_to_row(taps)

    @ti.func
    def of_nodes(
        grid: ti.template(),
        adj_grid_out: ti.template(),
        within,
        beyond,
        adj,
        b,
        j,
        i,
        share_u,
        slope_u,
        share,
        slope,
    ):
        """Give what a row of nodes adds to the pixel's slopes; what the pixel adds to them is added there."""
        nodes = row_of_nodes(grid, within, beyond, b, j, i)
        if ti.static(scatter):
            add_to_row(adj_grid_out, within, b, j, i, (adj * share) * share_u)
        return share * slope_u.dot(nodes), slope * share_u.dot(nodes)

    @ti.func
    def adjoint_of_row(
        grid: ti.template(),
        w,
        beyond,
        sigma,
        reach,
        adj_image: ti.template(),
        b,
        y,
        rows_out: ti.template(),
        adj_grid_out: ti.template(),
    ):
        rows = grid.shape[1]
        columns = grid.shape[2]
        # sums of (adj image_du, adj image_dv, adj (image_du u + image_dv v)) / d, plain and times x
        at_0 = ti.Vector.zero(dtype, 3)
        at_x = ti.Vector.zero(dtype, 3)
        for x in range(adj_image.shape[2]):
            u, v, inverse_depth = look(w, dtype(x), dtype(y))
            if near(u, v, inverse_depth, reach, rows, columns):
                i, share_u, slope_u = profile(u, sigma)
                j, share_v, slope_v = profile(v, sigma)
                within = all_within(grid, j, i, taps)
                adj = adj_image[b, y, x]
                adj_u = dtype(0.0)
                adj_v = dtype(0.0)
                if ti.static(taps == 2):
                    for k in ti.static(range(taps)):
                        change_u, change_v = of_nodes(
                            grid,
                            adj_grid_out,
                            within,
                            beyond,
                            adj,
                            b,
                            j + k,
                            i,
                            share_u,
                            slope_u,
                            share_v[k],
                            slope_v[k],
                        )
                        adj_u += change_u
                        adj_v += change_v
                else:  # unrolled it would take minutes to compile
                    for k in range(taps):
                        change_u, change_v = of_nodes(
                            grid,
                            adj_grid_out,
                            within,
                            beyond,
                            adj,
                            b,
                            j + k,
                            i,
                            share_u,
                            slope_u,
                            share_v[k],
                            slope_v[k],
                        )
                        adj_u += change_u
                        adj_v += change_v
                adj *= inverse_depth
                here = ti.Vector([adj * adj_u, adj * adj_v, adj * (adj_u * u + adj_v * v)])
                at_0 += here
                at_x += dtype(x) * here
        rows_out[b, y, 0] = at_x[0]
        rows_out[b, y, 1] = at_0[0] * dtype(y)
        rows_out[b, y, 2] = at_0[0]
        rows_out[b, y, 3] = at_x[1]
        rows_out[b, y, 4] = at_0[1] * dtype(y)
        rows_out[b, y, 5] = at_0[1]
        if ti.static(parameters == 8):
            rows_out[b, y, 6] = -at_x[2]
            rows_out[b, y, 7] = -at_0[2] * dtype(y)

    return adjoint_of_row


@cache
def make_adjoint_of_rows(dtype, parameters: int, taps: int):
    """Build the adjoint in the map; one thread per row of pixels."""
    adjoint_of_row = make_adjoint_of_row(dtype, parameters, taps, False)

    @ti.kernel
    def adjoint_of_rows(
        grid: array(dtype, 3),
        to_grid: array(dtype, 2),
        outside: array(dtype, 1),
        sigma: dtype,
        reach: dtype,
        adj_image: array(dtype, 3),
        rows_out: array(dtype, 3),
    ):
        for b, y in ti.ndrange(adj_image.shape[0], adj_image.shape[1]):
            w = map_of(to_grid, b, parameters)
            adjoint_of_row(grid, w, outside[b], sigma, reach, adj_image, b, y, rows_out, grid)

    return adjoint_of_rows


@cache
def make_adjoint_of_windows(dtype, parameters: int, taps: int, alone: bool):
    """Build the adjoint in map and grid; one thread per window."""
    indices = indices_of_window(alone)
    adjoint_of_row = make_adjoint_of_row(dtype, parameters, taps, True)

    @ti.kernel
    def adjoint_of_windows(
        grid: array(dtype, 3),
        to_grid: array(dtype, 2),
        outside: array(dtype, 1),
        sigma: dtype,
        reach: dtype,
        adj_image: array(dtype, 3),
        rows_out: array(dtype, 3),
        adj_grid_out: array(dtype, 3),
    ):
        ti.loop_config(serialize=alone)
        for b, idle in ti.ndrange(adj_image.shape[0], indices):
            if idle > 0:
                continue
            for j in range(adj_grid_out.shape[1]):
                for i in range(adj_grid_out.shape[2]):
                    adj_grid_out[b, j, i] = dtype(0.0)
            w = map_of(to_grid, b, parameters)
            beyond = outside[b]
            for y in range(adj_image.shape[1]):
                adjoint_of_row(grid, w, beyond, sigma, reach, adj_image, b, y, rows_out, adj_grid_out)

    return adjoint_of_windows


@cache
def make_share(dtype, taps: int):
    """Build the profile b of one module."""
    edge = make_edge(dtype)

    @ti.func
    def hat(s, sigma):
        return ti.max(dtype(1.0) - ti.abs(s), dtype(0.0))

    @ti.func
    def blurred_box(s, sigma):
        before, _slope = edge((s + dtype(0.5)) / sigma)
        after, _other = edge((s - dtype(0.5)) / sigma)
        return before - after

    return hat if taps == 2 else blurred_box


@cache
def make_pixels_around(dtype, parameters: int):
    """Build the function that gives the pixels that may look at a square of the grid.

    The square of half side ``reach`` around (u, v): first column and row, last column and row.  All of the
    image where a corner of the square is not in front of the map, or the map cannot be inverted.
    """

    @ti.func
    def pixels_around(w, u, v, reach, height, width):
        w6 = dtype(0.0)
        w7 = dtype(0.0)
        if ti.static(parameters == 8):
            w6 = w[6]
            w7 = w[7]
        w0, w1, w2, w3, w4, w5 = w[0], w[1], w[2], w[3], w[4], w[5]
        # rows of the adjugate of the map's matrix: its inverse, up to the determinant
        determinant = w0 * (w4 - w5 * w7) - w1 * (w3 - w5 * w6) + w2 * (w3 * w7 - w4 * w6)
        left = dtype(width)
        right = dtype(-1.0)
        top = dtype(height)
        bottom = dtype(-1.0)
        in_front = 0
        for corner in ti.static(range(4)):
            s = u + (reach if corner % 2 else -reach)
            r = v + (-reach if corner < 2 else reach)
            x = (w4 - w5 * w7) * s + (w2 * w7 - w1) * r + w1 * w5 - w2 * w4
            y = (w5 * w6 - w3) * s + (w0 - w2 * w6) * r + w2 * w3 - w0 * w5
            depth = (w3 * w7 - w4 * w6) * s + (w1 * w6 - w0 * w7) * r + w0 * w4 - w1 * w3
            # written so that it is false for NaN
            if depth * determinant > dtype(0.0):
                in_front += 1
                left = ti.min(left, x / depth)
                right = ti.max(right, x / depth)
                top = ti.min(top, y / depth)
                bottom = ti.max(bottom, y / depth)
        around = ti.Vector([0, 0, width - 1, height - 1])
        if in_front == 4:
            # a pixel more on each side for what rounding does
            around[0] = int(ti.max(ti.floor(left) - dtype(1.0), dtype(0.0)))
            around[1] = int(ti.max(ti.floor(top) - dtype(1.0), dtype(0.0)))
            around[2] = int(ti.min(ti.ceil(right) + dtype(1.0), dtype(width - 1)))
            around[3] = int(ti.min(ti.ceil(bottom) + dtype(1.0), dtype(height - 1)))
        return around

    return pixels_around


@cache
def make_adjoint_of_nodes(dtype, parameters: int, taps: int):
    """Build the adjoint in the grid; one thread per node, which visits the pixels that can see it."""
    look = make_look(dtype, parameters)
    share = make_share(dtype, taps)
    pixels_around = make_pixels_around(dtype, parameters)

    @ti.kernel
    def adjoint_of_nodes(
        to_grid: array(dtype, 2),
        sigma: dtype,
        reach: dtype,
        adj_image: array(dtype, 3),
        adj_grid_out: array(dtype, 3),
    ):
        for b, j, i in ti.ndrange(adj_grid_out.shape[0], adj_grid_out.shape[1], adj_grid_out.shape[2]):
            w = map_of(to_grid, b, parameters)
            around = pixels_around(w, dtype(i), dtype(j), reach, adj_image.shape[1], adj_image.shape[2])
            total = dtype(0.0)
            for y in range(around[1], around[3] + 1):
                along = dtype(0.0)
                for x in range(around[0], around[2] + 1):
                    u, v, inverse_depth = look(w, dtype(x), dtype(y))
                    du = u - dtype(i)
                    dv = v - dtype(j)
                    if inverse_depth > dtype(0.0) and ti.abs(du) < reach and ti.abs(dv) < reach:
                        along += adj_image[b, y, x] * share(du, sigma) * share(dv, sigma)
                total += along
            adj_grid_out[b, j, i] = total

    return adjoint_of_nodes


def render_code_adjoint(
    grid, to_grid, outside, sigma: float, adj_image, rows_out, adj_grid_out, adj_to_grid_out
) -> None:
    """Launch the variant that suits the device; overwrites."""
    dtype, parameters, taps, reach = float_of(grid), to_grid.shape[1], taps_of(sigma), reach_of(sigma)
    if is_on_cpu(grid):
        windows = make_adjoint_of_windows(dtype, parameters, taps, is_alone(grid))
        launch(windows, grid, to_grid, outside, sigma, reach, adj_image, rows_out, adj_grid_out)
    else:
        rows = make_adjoint_of_rows(dtype, parameters, taps)
        launch(rows, grid, to_grid, outside, sigma, reach, adj_image, rows_out)
        nodes = make_adjoint_of_nodes(dtype, parameters, taps)
        launch(nodes, to_grid, sigma, reach, adj_image, adj_grid_out)
    add_partials(rows_out, adj_to_grid_out)
