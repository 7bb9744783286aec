"""Stage two's linear system, and its solution.

The model of the residual image in code coordinates is ``A q = a_u B q B'^T + a_v B' q B^T`` (rows v, columns u), with B the
module profile sampled K times a module and B' its derivative.  With E sampled on the same lattice under a pose:

    rhs = A^T E = a_u B^T (E B') + a_v B'^T (E B)

``sample_rows`` samples one row of the lattice and folds it with the two profiles at once, ``fold_columns`` finishes.
A module meets only its near neighbours and all alike, so A^T A is a stencil of (2 reach + 1)^2 numbers.

``solve_code`` is conjugate gradients on ``(S + damping I) q = -rhs`` over the free modules; the rest of the q it is given is
fixed (function patterns, quiet zone).  One thread owns one row; each dot product is a sum of row sums that every row adds up
for itself, so there is no atomic and no host read, and an iteration is two launches.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.pose import make_bilinear


@cache
def make_code_rhs(dtype: type):
    """Build the two passes; launch: one thread per (window, lattice row), then per (window, module)."""
    bilinear = make_bilinear(dtype)

    @wp.kernel(module="unique", enable_backward=False)
    def sample_rows(
        image: wp.array3d(dtype=dtype),
        pose: wp.array2d(dtype=dtype),
        lattice: wp.array(dtype=dtype),
        profile: wp.array(dtype=dtype),
        slope: wp.array(dtype=dtype),
        samples_a_module: int,
        samples_out: wp.array3d(dtype=dtype),
        rows_out: wp.array4d(dtype=dtype),
    ):
        b, row = wp.tid()
        v = lattice[row]
        count = lattice.shape[0]
        p0 = pose[b, 0]
        p3 = pose[b, 3]
        p6 = pose[b, 6]
        x0 = pose[b, 1] * v + pose[b, 2]
        y0 = pose[b, 4] * v + pose[b, 5]
        z0 = pose[b, 7] * v + pose[b, 8]
        for i in range(count):
            u = lattice[i]
            inverse_depth = dtype(1.0) / (p6 * u + z0)
            samples_out[b, row, i] = bilinear(image, b, (p0 * u + x0) * inverse_depth, (p3 * u + y0) * inverse_depth)
        support = profile.shape[0]
        before = (support - samples_a_module) // 2
        for j in range(rows_out.shape[3]):
            first = j * samples_a_module - before
            total = dtype(0.0)
            total_slope = dtype(0.0)
            for k in range(wp.max(0, -first), wp.min(support, count - first)):
                e = samples_out[b, row, first + k]
                total += e * profile[k]
                total_slope += e * slope[k]
            rows_out[b, 0, row, j] = total
            rows_out[b, 1, row, j] = total_slope

    @wp.kernel(module="unique", enable_backward=False)
    def fold_columns(
        rows: wp.array4d(dtype=dtype),
        profile: wp.array(dtype=dtype),
        slope: wp.array(dtype=dtype),
        gain: wp.array2d(dtype=dtype),
        samples_a_module: int,
        rhs_out: wp.array3d(dtype=dtype),
    ):
        b, i, j = wp.tid()
        support = profile.shape[0]
        count = rows.shape[2]
        first = i * samples_a_module - (support - samples_a_module) // 2
        along_u = dtype(0.0)
        along_v = dtype(0.0)
        for k in range(wp.max(0, -first), wp.min(support, count - first)):
            along_u += profile[k] * rows[b, 1, first + k, j]
            along_v += slope[k] * rows[b, 0, first + k, j]
        rhs_out[b, i, j] = gain[b, 0] * along_u + gain[b, 1] * along_v

    return sample_rows, fold_columns


@cache
def make_solve_code(dtype: type):
    """Build the three steps of conjugate gradients; launch each: one thread per (window, module row)."""

    @wp.func
    def stencil_at(field: wp.array3d(dtype=dtype), stencil: wp.array3d(dtype=dtype), b: int, i: int, j: int) -> dtype:
        reach = stencil.shape[1] // 2
        total = dtype(0.0)
        for k in range(wp.max(-reach, -i), wp.min(reach + 1, field.shape[1] - i)):
            for m in range(wp.max(-reach, -j), wp.min(reach + 1, field.shape[2] - j)):
                total += stencil[b, k + reach, m + reach] * field[b, i + k, j + m]
        return total

    @wp.func
    def sum_rows(rows: wp.array3d(dtype=dtype), b: int, slot: int) -> dtype:
        total = dtype(0.0)
        for i in range(rows.shape[2]):
            total += rows[b, slot, i]
        return total

    @wp.kernel(module="unique", enable_backward=False)
    def start(
        rhs: wp.array3d(dtype=dtype),
        stencil: wp.array3d(dtype=dtype),
        damping: wp.array(dtype=dtype),
        free: wp.array2d(dtype=wp.int32),
        q: wp.array3d(dtype=dtype),
        residual_out: wp.array3d(dtype=dtype),
        direction_out: wp.array3d(dtype=dtype),
        rows_out: wp.array3d(dtype=dtype),
    ):
        b, i = wp.tid()
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
        rows_out[b, 3, i] = norm

    @wp.kernel(module="unique", enable_backward=False)
    def apply(
        stencil: wp.array3d(dtype=dtype),
        damping: wp.array(dtype=dtype),
        free: wp.array2d(dtype=wp.int32),
        residual: wp.array3d(dtype=dtype),
        direction: wp.array3d(dtype=dtype),
        tolerance_sq: dtype,
        rows: wp.array3d(dtype=dtype),
        direction_out: wp.array3d(dtype=dtype),
        product_out: wp.array3d(dtype=dtype),
    ):
        b, i = wp.tid()
        now = sum_rows(rows, b, 1)
        if now <= tolerance_sq * sum_rows(rows, b, 0):
            return
        before = sum_rows(rows, b, 3)
        beta = now / before
        reach = stencil.shape[1] // 2
        for j in range(free.shape[1]):
            direction_out[b, i, j] = residual[b, i, j] + beta * direction[b, i, j]
        curvature = dtype(0.0)
        for j in range(free.shape[1]):
            total = dtype(0.0)
            if free[i, j] != 0:
                total = damping[b] * direction_out[b, i, j]
                for k in range(wp.max(-reach, -i), wp.min(reach + 1, free.shape[0] - i)):
                    for m in range(wp.max(-reach, -j), wp.min(reach + 1, free.shape[1] - j)):
                        # a neighbour's new direction, not yet written by its owner, is made again here
                        d = residual[b, i + k, j + m] + beta * direction[b, i + k, j + m]
                        total += stencil[b, k + reach, m + reach] * d
            product_out[b, i, j] = total
            curvature += total * direction_out[b, i, j]
        rows[b, 2, i] = curvature

    @wp.kernel(module="unique", enable_backward=False)
    def update(
        residual: wp.array3d(dtype=dtype),
        direction: wp.array3d(dtype=dtype),
        product: wp.array3d(dtype=dtype),
        tolerance_sq: dtype,
        rows: wp.array3d(dtype=dtype),
        rows_out: wp.array3d(dtype=dtype),
        q_out: wp.array3d(dtype=dtype),
        iterations_out: wp.array(dtype=wp.int32),
    ):
        b, i = wp.tid()
        rows_out[b, 0, i] = rows[b, 0, i]
        rows_out[b, 1, i] = rows[b, 1, i]
        rows_out[b, 3, i] = rows[b, 1, i]
        now = sum_rows(rows, b, 1)
        if now <= tolerance_sq * sum_rows(rows, b, 0):
            return
        step = now / sum_rows(rows, b, 2)
        norm = dtype(0.0)
        for j in range(residual.shape[2]):
            q_out[b, i, j] += step * direction[b, i, j]
            r = residual[b, i, j] - step * product[b, i, j]
            residual[b, i, j] = r
            norm += r * r
        rows_out[b, 1, i] = norm
        if i == 0:
            iterations_out[b] += 1

    return start, apply, update
