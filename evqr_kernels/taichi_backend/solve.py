"""The modules of a planar code by conjugate gradients; the method is in ``warp_backend/solve.py``.

Two variants, as there: one thread solves a window in one launch on the CPU, one thread owns a row of modules
and an iteration is two launches elsewhere.
"""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, indices_of_window, is_alone, is_on_cpu, ti
from evqr_kernels.taichi_backend.launches import launch


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
def make_solve_windows(dtype, alone: bool):
    """Build the whole solution; one thread per window."""
    indices = indices_of_window(alone)
    stencil_at = make_stencil_at(dtype)

    @ti.kernel
    def solve_windows(
        rhs: array(dtype, 3),
        stencil: array(dtype, 3),
        damping: array(dtype, 1),
        free: array(ti.i32, 2),
        max_iterations: ti.i32,
        tolerance: dtype,
        residual_out: array(dtype, 3),
        direction_out: array(dtype, 3),
        product_out: array(dtype, 3),
        q_inout: array(dtype, 3),
        iterations_out: array(ti.i32, 1),
    ):
        ti.loop_config(serialize=alone)
        for b, idle in ti.ndrange(rhs.shape[0], indices):
            if idle > 0:
                continue
            rows = free.shape[0]
            columns = free.shape[1]
            norm = dtype(0.0)
            for i in range(rows):
                for j in range(columns):
                    r = dtype(0.0)
                    if free[i, j] != 0:
                        r = (
                            -rhs[b, i, j]
                            - stencil_at(q_inout, stencil, b, i, j)
                            - damping[b] * q_inout[b, i, j]
                        )
                    residual_out[b, i, j] = r
                    direction_out[b, i, j] = dtype(0.0)
                    product_out[b, i, j] = dtype(0.0)
                    norm += r * r
            enough = tolerance * tolerance * norm
            before = norm
            iterations = 0
            while iterations < max_iterations and norm > enough:
                beta = norm / before
                for i in range(rows):
                    for j in range(columns):
                        direction_out[b, i, j] = residual_out[b, i, j] + beta * direction_out[b, i, j]
                curvature = dtype(0.0)
                for i in range(rows):
                    for j in range(columns):
                        if free[i, j] != 0:
                            d = direction_out[b, i, j]
                            product = stencil_at(direction_out, stencil, b, i, j) + damping[b] * d
                            product_out[b, i, j] = product
                            curvature += product * d
                step = norm / curvature
                before = norm
                norm = dtype(0.0)
                for i in range(rows):
                    for j in range(columns):
                        q_inout[b, i, j] = q_inout[b, i, j] + step * direction_out[b, i, j]
                        r = residual_out[b, i, j] - step * product_out[b, i, j]
                        residual_out[b, i, j] = r
                        norm += r * r
                iterations += 1
            iterations_out[b] = iterations

    return solve_windows


def solve_windows(
    rhs, stencil, damping, free, scratch, q_inout, iterations_out, max_iterations, tolerance
) -> None:
    """Launch the CPU's variant; q is updated in place, the rest overwritten."""
    residual, direction, _, product, _, _ = scratch
    launch(
        make_solve_windows(float_of(rhs), is_alone(rhs)),
        *(rhs, stencil, damping, free, max_iterations, tolerance),
        *(residual, direction, product, q_inout, iterations_out),
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
        free: array(ti.i32, 2),
        q: array(dtype, 3),
        residual_out: array(dtype, 3),
        direction_out: array(dtype, 3),
        rows_out: array(dtype, 3),
        iterations_out: array(ti.i32, 1),
    ):
        for b, i in ti.ndrange(rhs.shape[0], rhs.shape[1]):
            norm = dtype(0.0)
            for j in range(free.shape[1]):
                r = dtype(0.0)
                if free[i, j] != 0:
                    r = -rhs[b, i, j] - stencil_at(q, stencil, b, i, j) - damping[b] * q[b, i, j]
                residual_out[b, i, j] = r
                direction_out[b, i, j] = dtype(0.0)
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
        free: array(ti.i32, 2),
        residual: array(dtype, 3),
        direction: array(dtype, 3),
        tolerance: dtype,
        direction_out: array(dtype, 3),
        product_out: array(dtype, 3),
        rows_inout: array(dtype, 3),
    ):
        for b, i in ti.ndrange(residual.shape[0], residual.shape[1]):
            norm = sum_rows(rows_inout, b, 1)
            if norm > tolerance * tolerance * sum_rows(rows_inout, b, 0):
                beta = norm / sum_rows(rows_inout, b, 3)
                reach = stencil.shape[1] // 2
                curvature = dtype(0.0)
                for j in range(free.shape[1]):
                    own = residual[b, i, j] + beta * direction[b, i, j]
                    total = dtype(0.0)
                    if free[i, j] != 0:
                        total = damping[b] * own
                        for k in range(ti.max(-reach, -i), ti.min(reach + 1, free.shape[0] - i)):
                            for m in range(ti.max(-reach, -j), ti.min(reach + 1, free.shape[1] - j)):
                                # a neighbour's new direction, perhaps not yet written by its owner, is made
                                # again here
                                d = residual[b, i + k, j + m] + beta * direction[b, i + k, j + m]
                                total += stencil[b, k + reach, m + reach] * d
                    direction_out[b, i, j] = own
                    product_out[b, i, j] = total
                    curvature += total * own
                rows_inout[b, 2, i] = curvature

    return apply


@cache
def make_update(dtype):
    """Build the step along the direction; one thread per (window, module row)."""
    sum_rows = make_sum_rows(dtype)

    @ti.kernel
    def update(
        direction: array(dtype, 3),
        product: array(dtype, 3),
        tolerance: dtype,
        rows: array(dtype, 3),
        rows_out: array(dtype, 3),
        residual_inout: array(dtype, 3),
        q_inout: array(dtype, 3),
        iterations_inout: array(ti.i32, 1),
    ):
        for b, i in ti.ndrange(product.shape[0], product.shape[1]):
            norm_row = rows[b, 1, i]
            norm = sum_rows(rows, b, 1)
            if norm > tolerance * tolerance * sum_rows(rows, b, 0):
                step = norm / sum_rows(rows, b, 2)
                norm_row = dtype(0.0)
                for j in range(product.shape[2]):
                    q_inout[b, i, j] = q_inout[b, i, j] + step * direction[b, i, j]
                    r = residual_inout[b, i, j] - step * product[b, i, j]
                    residual_inout[b, i, j] = r
                    norm_row += r * r
                if i == 0:
                    iterations_inout[b] = iterations_inout[b] + 1
            rows_out[b, 0, i] = rows[b, 0, i]
            rows_out[b, 1, i] = norm_row
            rows_out[b, 3, i] = rows[b, 1, i]

    return update


def solve_rows(
    rhs, stencil, damping, free, scratch, q_inout, iterations_out, max_iterations, tolerance
) -> None:
    """Launch the GPU's variant; q is updated in place, the rest overwritten."""
    dtype = float_of(rhs)
    residual, direction, next_direction, product, sums, next_sums = scratch
    launch(
        make_start(dtype),
        *(rhs, stencil, damping, free, q_inout),
        *(residual, direction, sums, iterations_out),
    )
    for _ in range(max_iterations):
        launch(
            make_apply(dtype),
            *(stencil, damping, free, residual, direction, tolerance),
            *(next_direction, product, sums),
        )
        launch(
            make_update(dtype),
            *(next_direction, product, tolerance, sums),
            *(next_sums, residual, q_inout, iterations_out),
        )
        direction, next_direction = next_direction, direction
        sums, next_sums = next_sums, sums


def solve_code(
    rhs, stencil, damping, free, max_iterations: int, tolerance: float, residual_out, direction_out,
    next_direction_out, product_out, sums_out, next_sums_out, q_inout, iterations_out,
) -> None:  # fmt: skip
    """Launch the variant that suits the device."""
    launch_variant = solve_windows if is_on_cpu(rhs) else solve_rows
    scratch = residual_out, direction_out, next_direction_out, product_out, sums_out, next_sums_out
    launch_variant(rhs, stencil, damping, free, scratch, q_inout, iterations_out, max_iterations, tolerance)
