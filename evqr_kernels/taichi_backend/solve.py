"""The modules of a planar code by conjugate gradients; the method is in ``warp_backend/solve.py``.

Two variants, as there: one thread solves a window in one launch on the CPU, one thread owns a row of modules
and an iteration is two launches elsewhere.
"""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, indices_of_window, is_alone, is_on_cpu, ti
from evqr_kernels.taichi_backend.launches import launch

RESIDUAL, DIRECTION, PRODUCT, NEXT_DIRECTION = range(4)
"""Fields that a solution works on; directions change places."""


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


@ti.func
def unclear_of(unclear: ti.template(), b):
    """Add up the unclear modules of a window."""
    total = 0
    for i in range(unclear.shape[1]):
        total += unclear[b, i]
    return total


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
    fields, _, _ = scratch
    launch(
        make_solve_windows(float_of(rhs), is_alone(rhs)),
        *(rhs, stencil, damping, space_idx, free, bounds, unclear, enough, max_iterations, tolerance),
        *(fields, q_inout, iterations_out),
    )


@cache
def make_sum_rows(dtype):
    """Build the sum of one slot of the row sums: 0 |r|^2 at the start, 1 now, 2 d.p, 3 |r|^2 before."""

    @ti.func
    def sum_rows(rows: ti.template(), b, slot):
        total = dtype(0.0)
        for i in range(rows.shape[2]):
            total += rows[b, slot, i]
        return total

    return sum_rows


@cache
def make_start(dtype):
    """Build the first residual; one thread per (window, module row)."""
    stencil_at = make_stencil_at(dtype)

    @ti.kernel
    def start(
        rhs: array(dtype, 3),
        stencil: array(dtype, 3),
        damping: array(dtype, 1),
        space_idx: array(ti.i32, 1),
        free: array(ti.i32, 3),
        bounds: array(ti.i32, 2),
        unclear: array(ti.i32, 2),
        enough: array(ti.i32, 1),
        q: array(dtype, 3),
        fields_out: array(dtype, 4),
        rows_out: array(dtype, 3),
        iterations_out: array(ti.i32, 1),
    ):
        for b, i in ti.ndrange(rhs.shape[0], rhs.shape[1]):
            m = space_idx[b]
            # of a window that is clear enough nothing is free: its residual is 0
            inside = unclear_of(unclear, b) > enough[m] and i >= bounds[m, 0] and i < bounds[m, 1]
            norm = dtype(0.0)
            for j in range(rhs.shape[2]):
                r = dtype(0.0)
                if inside and j >= bounds[m, 2] and j < bounds[m, 3] and free[m, i, j] != 0:
                    r = -rhs[b, i, j] - stencil_at(q, stencil, b, i, j) - damping[b] * q[b, i, j]
                fields_out[b, RESIDUAL, i, j] = r
                fields_out[b, DIRECTION, i, j] = dtype(0.0)
                norm += r * r
            rows_out[b, 0, i] = norm
            rows_out[b, 1, i] = norm
            rows_out[b, 2, i] = dtype(0.0)
            rows_out[b, 3, i] = norm
            if i == 0:
                iterations_out[b] = 0

    return start


@cache
def make_apply(dtype):
    """Build the new direction and its product with the system; one thread per (window, row)."""
    sum_rows = make_sum_rows(dtype)

    @ti.kernel
    def apply(
        stencil: array(dtype, 3),
        damping: array(dtype, 1),
        space_idx: array(ti.i32, 1),
        free: array(ti.i32, 3),
        bounds: array(ti.i32, 2),
        tolerance: dtype,
        direction: ti.i32,
        next_direction: ti.i32,
        fields_inout: array(dtype, 4),
        rows_inout: array(dtype, 3),
    ):
        for b, i in ti.ndrange(fields_inout.shape[0], fields_inout.shape[2]):
            norm = sum_rows(rows_inout, b, 1)
            if norm > tolerance * tolerance * sum_rows(rows_inout, b, 0):
                beta = norm / sum_rows(rows_inout, b, 3)
                reach = stencil.shape[1] // 2
                curvature = dtype(0.0)
                m = space_idx[b]
                inside = i >= bounds[m, 0] and i < bounds[m, 1]
                for j in range(fields_inout.shape[3]):
                    own = fields_inout[b, RESIDUAL, i, j] + beta * fields_inout[b, direction, i, j]
                    total = dtype(0.0)
                    if inside and j >= bounds[m, 2] and j < bounds[m, 3] and free[m, i, j] != 0:
                        total = damping[b] * own
                        for k in range(ti.max(-reach, -i), ti.min(reach + 1, fields_inout.shape[2] - i)):
                            for n in range(ti.max(-reach, -j), ti.min(reach + 1, fields_inout.shape[3] - j)):
                                # a neighbour's new direction, perhaps not yet written by its owner, is made
                                # again here
                                d = beta * fields_inout[b, direction, i + k, j + n]
                                d += fields_inout[b, RESIDUAL, i + k, j + n]
                                total += stencil[b, k + reach, n + reach] * d
                    fields_inout[b, next_direction, i, j] = own
                    fields_inout[b, PRODUCT, i, j] = total
                    curvature += total * own
                rows_inout[b, 2, i] = curvature

    return apply


@cache
def make_update(dtype):
    """Build the step along the direction; one thread per (window, module row)."""
    sum_rows = make_sum_rows(dtype)

    @ti.kernel
    def update(
        tolerance: dtype,
        direction: ti.i32,
        rows: array(dtype, 3),
        rows_out: array(dtype, 3),
        fields_inout: array(dtype, 4),
        q_inout: array(dtype, 3),
        iterations_inout: array(ti.i32, 1),
    ):
        for b, i in ti.ndrange(q_inout.shape[0], q_inout.shape[1]):
            norm_row = rows[b, 1, i]
            norm = sum_rows(rows, b, 1)
            if norm > tolerance * tolerance * sum_rows(rows, b, 0):
                step = norm / sum_rows(rows, b, 2)
                norm_row = dtype(0.0)
                for j in range(q_inout.shape[2]):
                    q_inout[b, i, j] = q_inout[b, i, j] + step * fields_inout[b, direction, i, j]
                    r = fields_inout[b, RESIDUAL, i, j] - step * fields_inout[b, PRODUCT, i, j]
                    fields_inout[b, RESIDUAL, i, j] = r
                    norm_row += r * r
                if i == 0:
                    iterations_inout[b] = iterations_inout[b] + 1
            rows_out[b, 0, i] = rows[b, 0, i]
            rows_out[b, 1, i] = norm_row
            rows_out[b, 3, i] = rows[b, 1, i]

    return update


def solve_rows(
    rhs, stencil, damping, space_idx, free, bounds, unclear, enough, scratch, q_inout, iterations_out,
    max_iterations, tolerance,
) -> None:  # fmt: skip
    """Launch the GPU's variant; q is updated in place, the rest overwritten."""
    dtype = float_of(rhs)
    fields, sums, next_sums = scratch
    system = stencil, damping, space_idx, free, bounds
    launch(
        make_start(dtype),
        *(rhs, *system, unclear, enough, q_inout),
        *(fields, sums, iterations_out),
    )
    direction, next_direction = DIRECTION, NEXT_DIRECTION
    for _ in range(max_iterations):
        launch(
            make_apply(dtype),
            *(*system, tolerance, direction, next_direction),
            *(fields, sums),
        )
        launch(
            make_update(dtype),
            *(tolerance, next_direction, sums),
            *(next_sums, fields, q_inout, iterations_out),
        )
        direction, next_direction = next_direction, direction
        sums, next_sums = next_sums, sums


def solve_code(
    rhs, stencil, damping, space_idx, free, bounds, unclear, enough, max_iterations: int, tolerance: float,
    fields_out, sums_out, next_sums_out, q_inout, iterations_out,
) -> None:  # fmt: skip
    """Launch the variant that suits the device."""
    launch_variant = solve_windows if is_on_cpu(rhs) else solve_rows
    scratch = fields_out, sums_out, next_sums_out
    launch_variant(
        rhs, stencil, damping, space_idx, free, bounds, unclear, enough, scratch, q_inout, iterations_out,
        max_iterations, tolerance,
    )  # fmt: skip
