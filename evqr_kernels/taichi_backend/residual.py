"""Residual of the brightness change along a motion; the formulas are in ``warp_backend/residual.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, is_on_cpu, row_of, run_at, ti, variant
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.sums import add_partials

FEW = 4
"""Neighbouring pixels of a block whose sums of two kinds a CPU too has the registers for."""


@cache
def make_slopes(dtype):
    """Build the central differences at one pixel."""

    @ti.func
    def slopes(image: ti.template(), b, y, x):
        right = image[b, y, ti.min(x + 1, image.shape[2] - 1)]
        left = image[b, y, ti.max(x - 1, 0)]
        below = image[b, ti.min(y + 1, image.shape[1] - 1), x]
        above = image[b, ti.max(y - 1, 0), x]
        return dtype(0.5) * (right - left), dtype(0.5) * (below - above)

    return slopes


@cache
def make_brightness_residual(dtype, block: int):
    """Build the forward kernel; one thread per row, whose inside it does in blocks."""
    slopes = make_slopes(dtype)

    @ti.kernel
    def brightness_residual(
        luminance: array(dtype, 3),
        events_image: array(dtype, 3),
        motion: array(dtype, 2),
        residual_out: array(dtype, 3),
    ):
        for b, y in ti.ndrange(luminance.shape[0], luminance.shape[1]):
            motion_x = motion[b, 0]
            motion_y = motion[b, 1]
            width = luminance.shape[2]
            above = row_of(luminance, b, ti.max(y - 1, 0))
            below = row_of(luminance, b, ti.min(y + 1, luminance.shape[1] - 1))
            row = row_of(luminance, b, y)
            blocks = ti.max(width - 2, 0) // block
            for k in range(blocks):
                x = 1 + block * k
                at = run_at(row + x - 1)
                up = run_at(above + x)
                down = run_at(below + x)
                here = run_at(row + x)
                value = ti.Vector.zero(dtype, block)
                for p in ti.static(range(block)):
                    dx = dtype(0.5) * (luminance[0, 0, at + p + 2] - luminance[0, 0, at + p])
                    dy = dtype(0.5) * (luminance[0, 0, down + p] - luminance[0, 0, up + p])
                    value[p] = motion_x * dx + motion_y * dy + events_image[0, 0, here + p]
                for p in ti.static(range(block)):
                    residual_out[0, 0, here + p] = value[p]
            for k in range(width - block * blocks):  # the first pixel, and the last ones
                x = ti.select(k == 0, 0, block * blocks + k)
                dx, dy = slopes(luminance, b, y, x)
                residual_out[b, y, x] = motion_x * dx + motion_y * dy + events_image[b, y, x]

    return brightness_residual


def brightness_residual(luminance, events_image, motion, residual_out) -> None:
    """Launch; overwrites."""
    block = variant("brightness_residual", is_on_cpu(luminance)).tile
    launch(
        make_brightness_residual(float_of(luminance), block), luminance, events_image, motion, residual_out
    )


@ti.func
def beyond(adj: ti.template(), b, y, x):
    """Look a pixel up; beyond the border lies minus the border's own."""
    row = ti.min(ti.max(y, 0), adj.shape[1] - 1)
    column = ti.min(ti.max(x, 0), adj.shape[2] - 1)
    value = adj[b, row, column]
    if row != y or column != x:
        value = -value
    return value


@cache
def make_adjoint_of_row(dtype, block: int):
    """Build what writes a row of the adjoint in the luminance, for a given one of the residual."""

    @ti.func
    def adjoint_of_row(adj: ti.template(), motion: ti.template(), b, y, out: ti.template()):
        half_x = dtype(0.5) * motion[b, 0]
        half_y = dtype(0.5) * motion[b, 1]
        from_above, from_below = half_y, -half_y
        width = adj.shape[2]
        row = row_of(adj, b, y)
        above, below = row - width, row + width
        if y == 0:
            above = row
            from_above = -from_above
        if y == adj.shape[1] - 1:
            below = row
            from_below = -from_below
        blocks = ti.max(width - 2, 0) // block
        for k in range(blocks):
            x = 1 + block * k
            at, here = run_at(row + x - 1), run_at(row + x)
            up, down = run_at(above + x), run_at(below + x)
            value = ti.Vector.zero(dtype, block)
            for p in ti.static(range(block)):
                along_y = from_above * adj[0, 0, up + p] + from_below * adj[0, 0, down + p]
                value[p] = half_x * (adj[0, 0, at + p] - adj[0, 0, at + p + 2]) + along_y
            for p in ti.static(range(block)):
                out[0, 0, here + p] = value[p]
        for k in range(width - block * blocks):  # the first pixel, and the last ones
            x = ti.select(k == 0, 0, block * blocks + k)
            along_x = beyond(adj, b, y, x - 1) - beyond(adj, b, y, x + 1)
            along_y = beyond(adj, b, y - 1, x) - beyond(adj, b, y + 1, x)
            out[b, y, x] = half_x * along_x + half_y * along_y

    return adjoint_of_row


@cache
def make_brightness_residual_adjoint(dtype):
    """Build the adjoint kernel; one thread per row, in blocks whose sums a CPU too has the registers for."""
    block = FEW
    slopes = make_slopes(dtype)
    adjoint_of_row = make_adjoint_of_row(dtype, block)

    @ti.kernel
    def brightness_residual_adjoint(
        luminance: array(dtype, 3),
        motion: array(dtype, 2),
        adj_residual: array(dtype, 3),
        rows_out: array(dtype, 3),
        adj_luminance_out: array(dtype, 3),
    ):
        for b, y in ti.ndrange(luminance.shape[0], luminance.shape[1]):
            width = luminance.shape[2]
            above = row_of(luminance, b, ti.max(y - 1, 0))
            below = row_of(luminance, b, ti.min(y + 1, luminance.shape[1] - 1))
            row = row_of(luminance, b, y)
            sums_x = ti.Vector.zero(dtype, block)
            sums_y = ti.Vector.zero(dtype, block)
            blocks = ti.max(width - 2, 0) // block
            for k in range(blocks):
                x = 1 + block * k
                at = run_at(row + x - 1)
                here = run_at(row + x)
                up = run_at(above + x)
                down = run_at(below + x)
                adj = ti.Vector([adj_residual[0, 0, here + p] for p in range(block)])
                for p in ti.static(range(block)):
                    sums_x[p] += adj[p] * (luminance[0, 0, at + p + 2] - luminance[0, 0, at + p])
                for p in ti.static(range(block)):
                    sums_y[p] += adj[p] * (luminance[0, 0, down + p] - luminance[0, 0, up + p])
            adj_x = dtype(0.5) * sums_x.sum()
            adj_y = dtype(0.5) * sums_y.sum()
            for k in range(width - block * blocks):  # the first pixel, and the last ones
                x = ti.select(k == 0, 0, block * blocks + k)
                dx, dy = slopes(luminance, b, y, x)
                adj_x += adj_residual[b, y, x] * dx
                adj_y += adj_residual[b, y, x] * dy
            rows_out[b, y, 0] = adj_x
            rows_out[b, y, 1] = adj_y
            adjoint_of_row(adj_residual, motion, b, y, adj_luminance_out)

    return brightness_residual_adjoint


def brightness_residual_adjoint(
    luminance, motion, adj_residual, rows_out, adj_luminance_out, adj_motion_out
) -> None:
    """Launch both passes; overwrites."""
    kernel = make_brightness_residual_adjoint(float_of(luminance))
    launch(kernel, luminance, motion, adj_residual, rows_out, adj_luminance_out)
    add_partials(rows_out, adj_motion_out)
