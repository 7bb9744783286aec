"""The modules of a planar code by conjugate gradients; the method is in ``warp_backend/solve.py``.

Two variants, as there: on the CPU one thread solves a window, elsewhere a block of threads, unless a code is
too large for the memory that a block shares.
"""

from functools import cache

from evqr_kernels.taichi_backend.language import (
    array,
    float_of,
    indices_of_window,
    is_alone,
    is_on_cpu,
    ti,
    variant,
)
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.solve_blocks import room_for, solve_blocks, unclear_of

RESIDUAL, DIRECTION, PRODUCT = range(3)
"""Fields that a solution works on."""


@cache
def make_stencil_at(dtype):
    """Build the function that applies the stencil at one module; outside the grid everything is 0."""

    @ti.func
    def stencil_at(field: ti.template(), stencil: ti.template(), b, i, j):
        reach = stencil.shape[1] // 2
        total = dtype(0.0)
        for k in range(ti.max(-reach, -i), ti.min(reach + 1, field.shape[1] - i)):
            for m in range(ti.max(-reach, -j), ti.min(reach + 1, field.shape[2] - j)):
                total += stencil[b, k + reach, m + reach] * field[b, i + k, j + m]
        return total

    return stencil_at


@cache
def make_direction_at(dtype):
    """Build the function that applies the stencil at one module to the direction among the fields."""

    @ti.func
    def stencil_at(fields: ti.template(), stencil: ti.template(), b, i, j):
        reach = stencil.shape[1] // 2
        total = dtype(0.0)
        for k in range(ti.max(-reach, -i), ti.min(reach + 1, fields.shape[2] - i)):
            for m in range(ti.max(-reach, -j), ti.min(reach + 1, fields.shape[3] - j)):
                total += stencil[b, k + reach, m + reach] * fields[b, DIRECTION, i + k, j + m]
        return total

    return stencil_at


@cache
def make_solve_windows(dtype, alone: bool):
    """Build the whole solution; one thread per window."""
    indices = indices_of_window(alone)
    stencil_at = make_stencil_at(dtype)
    direction_at = make_direction_at(dtype)

    @ti.kernel
    def solve_windows(
        rhs: array(dtype, 3),
        stencil: array(dtype, 3),
        damping: array(dtype, 1),
        space_idx: array(ti.i32, 1),
        free: array(ti.i32, 3),
        bounds: array(ti.i32, 2),
        unclear: array(ti.i32, 2),
        enough: array(ti.i32, 1),
        max_iterations: ti.i32,
        tolerance: dtype,
        fields_out: array(dtype, 4),
        q_inout: array(dtype, 3),
        iterations_out: array(ti.i32, 1),
    ):
        ti.loop_config(serialize=alone)
        for b, idle in ti.ndrange(rhs.shape[0], indices):
            if idle > 0:
                continue
            m = space_idx[b]
            top, bottom, left, right = bounds[m, 0], bounds[m, 1], bounds[m, 2], bounds[m, 3]
            most = max_iterations
            if unclear_of(unclear, b) <= enough[m]:
                most = 0
            reach = stencil.shape[1] // 2
            for i in range(ti.max(top - reach, 0), ti.min(bottom + reach, rhs.shape[1])):
                for j in range(ti.max(left - reach, 0), ti.min(right + reach, rhs.shape[2])):
                    fields_out[b, DIRECTION, i, j] = dtype(0.0)
            norm = dtype(0.0)
            for i in range(top, bottom):
                for j in range(left, right):
                    r = dtype(0.0)
                    if free[m, i, j] != 0:
                        r = (
                            -rhs[b, i, j]
                            - stencil_at(q_inout, stencil, b, i, j)
                            - damping[b] * q_inout[b, i, j]
                        )
                    fields_out[b, RESIDUAL, i, j] = r
                    fields_out[b, PRODUCT, i, j] = dtype(0.0)
                    norm += r * r
            enough_norm = tolerance * tolerance * norm
            before = norm
            iterations = 0
            while iterations < most and norm > enough_norm:
                beta = norm / before
                for i in range(top, bottom):
                    for j in range(left, right):
                        d = beta * fields_out[b, DIRECTION, i, j]
                        fields_out[b, DIRECTION, i, j] = fields_out[b, RESIDUAL, i, j] + d
                curvature = dtype(0.0)
                for i in range(top, bottom):
                    for j in range(left, right):
                        if free[m, i, j] != 0:
                            d = fields_out[b, DIRECTION, i, j]
                            product = direction_at(fields_out, stencil, b, i, j) + damping[b] * d
                            fields_out[b, PRODUCT, i, j] = product
                            curvature += product * d
                step = norm / curvature
                before = norm
                norm = dtype(0.0)
                for i in range(top, bottom):
                    for j in range(left, right):
                        q_inout[b, i, j] = q_inout[b, i, j] + step * fields_out[b, DIRECTION, i, j]
                        r = fields_out[b, RESIDUAL, i, j] - step * fields_out[b, PRODUCT, i, j]
                        fields_out[b, RESIDUAL, i, j] = r
                        norm += r * r
                iterations += 1
            iterations_out[b] = iterations

    return solve_windows


def solve_windows(
    rhs, stencil, damping, space_idx, free, bounds, unclear, enough, scratch, q_inout, iterations_out,
    max_iterations, tolerance,
) -> None:  # fmt: skip
    """Launch the CPU's variant; q is updated in place, the rest overwritten."""
    fields, _ = scratch
    launch(
        make_solve_windows(float_of(rhs), is_alone(rhs)),
        *(rhs, stencil, damping, space_idx, free, bounds, unclear, enough, max_iterations, tolerance),
        *(fields, q_inout, iterations_out),
    )


def solve_code(
    rhs, stencil, damping, space_idx, free, bounds, unclear, enough, max_iterations: int, tolerance: float,
    fields_out, direction_out, q_inout, iterations_out,
) -> None:  # fmt: skip
    """Launch a thread a window, or a block, as the table has it for the device; a block if the code fits."""
    in_blocks = variant("solve_code", is_on_cpu(rhs)).lanes > 1 and room_for(rhs, stencil)
    launch_variant = solve_blocks if in_blocks else solve_windows
    scratch = fields_out, direction_out
    launch_variant(
        rhs, stencil, damping, space_idx, free, bounds, unclear, enough, scratch, q_inout, iterations_out,
        max_iterations, tolerance,
    )  # fmt: skip
