"""Cost of a residual; the formulas are in ``warp_backend/cost.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import (
    array,
    float_of,
    is_alone,
    is_on_cpu,
    row_of,
    run_at,
    ti,
    variant,
)
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.residual import FEW, make_adjoint_of_row, make_slopes
from evqr_kernels.taichi_backend.sums import add_partials


@cache
def make_cost_rows(dtype):
    """Build the first pass of the cost; one thread per row, in blocks whose sums stay in registers."""
    block = FEW
    slopes = make_slopes(dtype)

    @ti.kernel
    def cost_rows(
        luminance: array(dtype, 3),
        events_image: array(dtype, 3),
        motion: array(dtype, 2),
        mask: array(dtype, 3),
        rows_out: array(dtype, 2),
    ):
        for b, y in ti.ndrange(luminance.shape[0], luminance.shape[1]):
            motion_x = motion[b, 0]
            motion_y = motion[b, 1]
            width = luminance.shape[2]
            above = row_of(luminance, b, ti.max(y - 1, 0))
            below = row_of(luminance, b, ti.min(y + 1, luminance.shape[1] - 1))
            row = row_of(luminance, b, y)
            sums = ti.Vector.zero(dtype, block)
            blocks = ti.max(width - 2, 0) // block
            for k in range(blocks):
                x = 1 + block * k
                at = run_at(row + x - 1)
                up = run_at(above + x)
                down = run_at(below + x)
                here = run_at(row + x)
                for p in ti.static(range(block)):
                    dx = dtype(0.5) * (luminance[0, 0, at + p + 2] - luminance[0, 0, at + p])
                    dy = dtype(0.5) * (luminance[0, 0, down + p] - luminance[0, 0, up + p])
                    value = motion_x * dx + motion_y * dy + events_image[0, 0, here + p]
                    sums[p] += mask[0, 0, here + p] * value * value
            total = sums.sum()
            for k in range(width - block * blocks):  # the first pixel, and the last ones
                x = ti.select(k == 0, 0, block * blocks + k)
                dx, dy = slopes(luminance, b, y, x)
                value = motion_x * dx + motion_y * dy + events_image[b, y, x]
                total += mask[b, y, x] * value * value
            rows_out[b, y] = dtype(0.5) * total

    return cost_rows


@cache
def make_add_rows(dtype, alone: bool):
    """Build the second pass of the cost; one thread per window."""

    @ti.kernel
    def add_rows(rows: array(dtype, 2), cost_out: array(dtype, 1)):
        ti.loop_config(serialize=alone)
        for b in range(cost_out.shape[0]):
            total = dtype(0.0)
            for y in range(rows.shape[1]):
                total += rows[b, y]
            cost_out[b] = total

    return add_rows


def brightness_cost(luminance, events_image, motion, mask, rows_out, cost_out) -> None:
    """Launch both passes; overwrites."""
    dtype = float_of(luminance)
    launch(make_cost_rows(dtype), luminance, events_image, motion, mask, rows_out)
    launch(make_add_rows(dtype, is_alone(luminance)), rows_out, cost_out)


@cache
def make_cost_adjoint_rows(dtype):
    """Build the first pass of the adjoint, all but that in the luminance; threads and blocks as forward."""
    block = FEW
    slopes = make_slopes(dtype)

    @ti.kernel
    def cost_adjoint_rows(
        luminance: array(dtype, 3),
        events_image: array(dtype, 3),
        motion: array(dtype, 2),
        mask: array(dtype, 3),
        adj_cost: array(dtype, 1),
        rows_out: array(dtype, 3),
        adj_events_image_out: array(dtype, 3),
    ):
        for b, y in ti.ndrange(luminance.shape[0], luminance.shape[1]):
            motion_x = motion[b, 0]
            motion_y = motion[b, 1]
            factor = adj_cost[b]
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
                up = run_at(above + x)
                down = run_at(below + x)
                here = run_at(row + x)
                adj = ti.Vector.zero(dtype, block)
                for p in ti.static(range(block)):
                    dx = dtype(0.5) * (luminance[0, 0, at + p + 2] - luminance[0, 0, at + p])
                    dy = dtype(0.5) * (luminance[0, 0, down + p] - luminance[0, 0, up + p])
                    value = motion_x * dx + motion_y * dy + events_image[0, 0, here + p]
                    adj[p] = factor * mask[0, 0, here + p] * value
                    sums_x[p] += adj[p] * dx
                    sums_y[p] += adj[p] * dy
                for p in ti.static(range(block)):
                    adj_events_image_out[0, 0, here + p] = adj[p]
            adj_x = sums_x.sum()
            adj_y = sums_y.sum()
            for k in range(width - block * blocks):  # the first pixel, and the last ones
                x = ti.select(k == 0, 0, block * blocks + k)
                dx, dy = slopes(luminance, b, y, x)
                value = motion_x * dx + motion_y * dy + events_image[b, y, x]
                adj = factor * mask[b, y, x] * value
                adj_events_image_out[b, y, x] = adj
                adj_x += adj * dx
                adj_y += adj * dy
            rows_out[b, y, 0] = adj_x
            rows_out[b, y, 1] = adj_y

    return cost_adjoint_rows


@cache
def make_adjoint_in_luminance(dtype, block: int):
    """Build the second pass of the adjoint; one thread per row, whose inside it does in blocks."""
    adjoint_of_row = make_adjoint_of_row(dtype, block)

    @ti.kernel
    def adjoint_in_luminance(
        motion: array(dtype, 2), adj_residual: array(dtype, 3), adj_luminance_out: array(dtype, 3)
    ):
        for b, y in ti.ndrange(adj_residual.shape[0], adj_residual.shape[1]):
            adjoint_of_row(adj_residual, motion, b, y, adj_luminance_out)

    return adjoint_in_luminance


def brightness_cost_adjoint(
    luminance, events_image, motion, mask, adj_cost, rows_out, adj_luminance_out, adj_events_image_out,
    adj_motion_out,
) -> None:  # fmt: skip
    """Launch all passes; overwrites."""
    dtype = float_of(luminance)
    launch(
        make_cost_adjoint_rows(dtype),
        luminance, events_image, motion, mask, adj_cost, rows_out, adj_events_image_out,
    )  # fmt: skip
    launch(
        make_adjoint_in_luminance(dtype, variant("brightness_cost_adjoint", is_on_cpu(luminance)).tile),
        motion,
        adj_events_image_out,
        adj_luminance_out,
    )
    add_partials(rows_out, adj_motion_out)
