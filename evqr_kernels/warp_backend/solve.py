"""The modules of a planar code, solved for: conjugate gradients over the free modules.

A module meets only its near neighbours and all alike, so A^T A is a stencil S of (2 reach + 1)^2 numbers (see
``code``), and

    (S + damping I) q = -rhs        on the free modules; the rest of the q that is given stays as it is

is solved from the q that is given until the residual is ``tolerance`` times what it was:

    beta = |r|^2 / |r before|^2,    d = r + beta d,        p = (S + damping I) d,
    step = |r|^2 / d.p,             q = q + step d,        r = r - step p

On the CPU one thread solves one window in a single launch (a launch costs as much as an iteration).  On a GPU
one thread owns one row of modules and an iteration is two launches; each dot product is a sum of row sums
that every row adds up for itself, so there is no atomic and no host read.  Windows that have converged do
nothing in the launches that are left.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, launch_bounds, module_of, neighbours, vector

BLOCK = 8
"""Neighbouring modules done together on the CPU."""


@cache
def make_stencil_at(dtype: type) -> wp.Function:
    """Build the function that applies the stencil at one module; outside the grid everything is 0."""

    @wp.func
    def stencil_at(
        field: wp.array3d(dtype=dtype), stencil: wp.array3d(dtype=dtype), b: int, i: int, j: int
    ) -> dtype:
        reach = stencil.shape[1] // 2
        total = dtype(0.0)
        for k in range(wp.max(-reach, -i), wp.min(reach + 1, field.shape[1] - i)):
            for m in range(wp.max(-reach, -j), wp.min(reach + 1, field.shape[2] - j)):
                total += stencil[b, k + reach, m + reach] * field[b, i + k, j + m]
        return total

    return stencil_at


@cache
def make_solve_windows(dtype: type) -> wp.Kernel:
    """Build the whole solution; launch: one thread per window.  ``.._blocks``: `neighbours` of direction."""
    vec_block = vector(BLOCK, dtype)
    stencil_at = make_stencil_at(dtype)

    @wp.kernel(module=module_of("solve", dtype))
    def solve_windows(
        rhs: wp.array3d(dtype=dtype),
        stencil: wp.array3d(dtype=dtype),
        damping: wp.array(dtype=dtype),
        free: wp.array2d(dtype=wp.int32),
        max_iterations: int,
        tolerance: dtype,
        residual_out: wp.array3d(dtype=dtype),
        direction_out: wp.array3d(dtype=dtype),
        direction_blocks_out: wp.array3d(dtype=vec_block),
        product_out: wp.array3d(dtype=dtype),
        q_inout: wp.array3d(dtype=dtype),
        iterations_out: wp.array(dtype=wp.int32),
    ):
        b = wp.tid()
        rows = free.shape[0]
        columns = free.shape[1]
        reach = stencil.shape[1] // 2
        norm = dtype(0.0)
        for i in range(rows):
            for j in range(columns):
                r = dtype(0.0)
                if free[i, j] != 0:
                    r = -rhs[b, i, j] - stencil_at(q_inout, stencil, b, i, j) - damping[b] * q_inout[b, i, j]
                residual_out[b, i, j] = r
                direction_out[b, i, j] = dtype(0.0)
                product_out[b, i, j] = dtype(0.0)
                norm += r * r
        enough = tolerance * tolerance * norm
        before = norm
        iterations = wp.int32(0)
        while iterations < max_iterations and norm > enough:
            beta = norm / before
            for i in range(rows):
                for j in range(columns):
                    direction_out[b, i, j] = residual_out[b, i, j] + beta * direction_out[b, i, j]
            curvature = dtype(0.0)
            for i in range(rows):
                j = wp.int32(0)
                while j < columns:
                    # a whole block whose neighbourhood lies inside the grid, or a single module
                    if i >= reach and i + reach < rows and j >= reach and j + BLOCK + reach <= columns:
                        total = vec_block()
                        for k in range(2 * reach + 1):
                            for m in range(2 * reach + 1):
                                total += (
                                    stencil[b, k, m] * direction_blocks_out[b, i + k - reach, j + m - reach]
                                )
                        for c in range(BLOCK):
                            if free[i, j + c] != 0:
                                d = direction_out[b, i, j + c]
                                product = total[c] + damping[b] * d
                                product_out[b, i, j + c] = product
                                curvature += product * d
                        j += BLOCK
                    else:
                        if free[i, j] != 0:
                            d = direction_out[b, i, j]
                            product = stencil_at(direction_out, stencil, b, i, j) + damping[b] * d
                            product_out[b, i, j] = product
                            curvature += product * d
                        j += 1
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
        make_solve_windows(rhs.dtype),
        rhs.shape[0],
        inputs=[rhs, stencil, damping, free, max_iterations, tolerance],
        outputs=[residual, direction, neighbours(direction, BLOCK), product, q_inout, iterations_out],
        device=rhs.device,
    )


@cache
def make_sum_rows(dtype: type) -> wp.Function:
    """Build the sum of one slot of the row sums: 0 |r|^2 at the start, 1 now, 2 d.p, 3 |r|^2 before."""

    @wp.func
    def sum_rows(rows: wp.array3d(dtype=dtype), b: int, slot: int) -> dtype:
        total = dtype(0.0)
        for i in range(rows.shape[2]):
            total += rows[b, slot, i]
        return total

    return sum_rows


@cache
def make_product_at(dtype: type) -> wp.Function:
    """Build the function that applies the stencil at one module to ``first + beta second``."""

    @wp.func
    def product_at(
        stencil: wp.array3d(dtype=dtype),
        first: wp.array3d(dtype=dtype),
        second: wp.array3d(dtype=dtype),
        beta: dtype,
        b: int,
        i: int,
        j: int,
    ) -> dtype:
        side = stencil.shape[1]
        total = dtype(0.0)
        # one loop, not two: a GPU's compiler unrolls each four times, which takes twice the registers
        for n in range(side * side):
            k = n // side
            m = n - k * side
            row = i + k - side // 2
            column = j + m - side // 2
            if row >= 0 and column >= 0 and row < first.shape[1] and column < first.shape[2]:
                total += stencil[b, k, m] * (first[b, row, column] + beta * second[b, row, column])
        return total

    return product_at


@cache
def make_start(dtype: type) -> wp.Kernel:
    """Build the first residual; launch: one thread per (window, module row)."""
    product_at = make_product_at(dtype)

    @wp.kernel(module=module_of("solve_rows", dtype))
    def start(
        rhs: wp.array3d(dtype=dtype),
        stencil: wp.array3d(dtype=dtype),
        damping: wp.array(dtype=dtype),
        free: wp.array2d(dtype=wp.int32),
        q: wp.array3d(dtype=dtype),
        residual_out: wp.array3d(dtype=dtype),
        direction_out: wp.array3d(dtype=dtype),
        rows_out: wp.array3d(dtype=dtype),
        iterations_out: wp.array(dtype=wp.int32),
    ):
        b, i = wp.tid()
        norm = dtype(0.0)
        for j in range(free.shape[1]):
            r = dtype(0.0)
            if free[i, j] != 0:
                product = product_at(stencil, q, q, dtype(0.0), b, i, j)
                r = -rhs[b, i, j] - product - damping[b] * q[b, i, j]
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
def make_apply(dtype: type) -> wp.Kernel:
    """Build the new direction and its product with the system; launch: one thread per (window, row)."""
    sum_rows = make_sum_rows(dtype)
    product_at = make_product_at(dtype)

    @wp.kernel(module=module_of("solve_rows", dtype), launch_bounds=launch_bounds(dtype))
    def apply(
        stencil: wp.array3d(dtype=dtype),
        damping: wp.array(dtype=dtype),
        free: wp.array2d(dtype=wp.int32),
        residual: wp.array3d(dtype=dtype),
        direction: wp.array3d(dtype=dtype),
        tolerance: dtype,
        direction_out: wp.array3d(dtype=dtype),
        product_out: wp.array3d(dtype=dtype),
        rows_inout: wp.array3d(dtype=dtype),
    ):
        b, i = wp.tid()
        norm = sum_rows(rows_inout, b, 1)
        if norm <= tolerance * tolerance * sum_rows(rows_inout, b, 0):
            return
        beta = norm / sum_rows(rows_inout, b, 3)
        curvature = dtype(0.0)
        for j in range(free.shape[1]):
            own = residual[b, i, j] + beta * direction[b, i, j]
            total = dtype(0.0)
            if free[i, j] != 0:
                # the neighbours' new directions, perhaps not yet written by their owners, are made again here
                total = product_at(stencil, residual, direction, beta, b, i, j) + damping[b] * own
            direction_out[b, i, j] = own
            product_out[b, i, j] = total
            curvature += total * own
        rows_inout[b, 2, i] = curvature

    return apply


@cache
def make_update(dtype: type) -> wp.Kernel:
    """Build the step along the direction; launch: one thread per (window, module row)."""
    sum_rows = make_sum_rows(dtype)

    @wp.kernel(module=module_of("solve_rows", dtype))
    def update(
        direction: wp.array3d(dtype=dtype),
        product: wp.array3d(dtype=dtype),
        tolerance: dtype,
        rows: wp.array3d(dtype=dtype),
        rows_out: wp.array3d(dtype=dtype),
        residual_inout: wp.array3d(dtype=dtype),
        q_inout: wp.array3d(dtype=dtype),
        iterations_inout: wp.array(dtype=wp.int32),
    ):
        b, i = wp.tid()
        rows_out[b, 0, i] = rows[b, 0, i]
        rows_out[b, 1, i] = rows[b, 1, i]
        rows_out[b, 3, i] = rows[b, 1, i]
        norm = sum_rows(rows, b, 1)
        if norm <= tolerance * tolerance * sum_rows(rows, b, 0):
            return
        step = norm / sum_rows(rows, b, 2)
        norm_row = dtype(0.0)
        for j in range(product.shape[2]):
            q_inout[b, i, j] = q_inout[b, i, j] + step * direction[b, i, j]
            r = residual_inout[b, i, j] - step * product[b, i, j]
            residual_inout[b, i, j] = r
            norm_row += r * r
        rows_out[b, 1, i] = norm_row
        if i == 0:
            iterations_inout[b] = iterations_inout[b] + 1

    return update


def solve_rows(
    rhs, stencil, damping, free, scratch, q_inout, iterations_out, max_iterations, tolerance
) -> None:
    """Launch the GPU's variant; q is updated in place, the rest overwritten."""
    dtype, device, rows = rhs.dtype, rhs.device, rhs.shape[:2]
    residual, direction, next_direction, product, sums, next_sums = scratch
    launch(
        make_start(dtype),
        rows,
        inputs=[rhs, stencil, damping, free, q_inout],
        outputs=[residual, direction, sums, iterations_out],
        device=device,
    )
    for _ in range(max_iterations):
        launch(
            make_apply(dtype),
            rows,
            inputs=[stencil, damping, free, residual, direction, tolerance],
            outputs=[next_direction, product, sums],
            device=device,
        )
        launch(
            make_update(dtype),
            rows,
            inputs=[next_direction, product, tolerance, sums],
            outputs=[next_sums, residual, q_inout, iterations_out],
            device=device,
        )
        direction, next_direction = next_direction, direction
        sums, next_sums = next_sums, sums


def solve_code(
    rhs, stencil, damping, free, max_iterations: int, tolerance: float, residual_out, direction_out,
    next_direction_out, product_out, sums_out, next_sums_out, q_inout, iterations_out,
) -> None:  # fmt: skip
    """Launch the variant that suits the device."""
    launch_variant = solve_windows if rhs.device.is_cpu else solve_rows
    scratch = residual_out, direction_out, next_direction_out, product_out, sums_out, next_sums_out
    launch_variant(rhs, stencil, damping, free, scratch, q_inout, iterations_out, max_iterations, tolerance)
