"""Windows' equations, summed; the formulas are in ``warp_backend/equations.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import launch

LEAST_NOISE = 1e-12
"""What less noise counts as."""


@cache
def make_sum_equations(dtype):
    """Build the sum; one thread per row, the first of a window sums stencils."""

    @ti.func
    def stencil_at(before: ti.template(), products: ti.template(), weight, a_u, a_v, b, k, n):
        own = a_u * a_u * products[0, k, n] + a_v * a_v * products[1, k, n] + a_u * a_v * products[2, k, n]
        return before[b, k, n] + weight * own

    @ti.kernel
    def sum_equations(
        rhs: array(dtype, 3),
        gain: array(dtype, 2),
        noise: array(dtype, 1),
        products: array(dtype, 3),
        rhs_before: array(dtype, 3),
        stencil_before: array(dtype, 3),
        score: array(dtype, 1),
        least: array(dtype, 1),
        space_idx: array(ti.i32, 1),
        known: array(dtype, 3),
        damping: dtype,
        least_damping: dtype,
        most_damping: dtype,
        rhs_out: array(dtype, 3),
        stencil_out: array(dtype, 3),
        peak_out: array(dtype, 1),
        damping_out: array(dtype, 1),
        q_out: array(dtype, 3),
        solved_idx_out: array(ti.i32, 1),
    ):
        for b, i in ti.ndrange(rhs.shape[0], rhs.shape[1]):
            m = space_idx[b]
            weight = dtype(1.0) / ti.max(noise[b], dtype(LEAST_NOISE))
            a_u = gain[b, 0]
            a_v = gain[b, 1]
            middle = products.shape[1] // 2
            peak = stencil_at(stencil_before, products, weight, a_u, a_v, b, middle, middle)
            if peak == dtype(0.0):
                peak = dtype(1.0)
            for j in range(rhs.shape[2]):
                rhs_out[b, i, j] = (rhs_before[b, i, j] + weight * rhs[b, i, j]) / peak
                q_out[b, i, j] = known[m, i, j]
            if i == 0:
                for k, n in ti.ndrange(products.shape[1], products.shape[2]):
                    total = stencil_at(stencil_before, products, weight, a_u, a_v, b, k, n)
                    stencil_out[b, k, n] = total / peak
                peak_out[b] = peak
                damping_out[b] = ti.min(ti.max(damping / peak, least_damping), most_damping)
                solved = 0
                if score[b] >= least[b]:
                    solved = m
                solved_idx_out[b] = solved

    return sum_equations


def sum_equations(
    rhs, gain, noise, products, rhs_before, stencil_before, score, least, space_idx, known, damping: float,
    least_damping: float, most_damping: float, rhs_out, stencil_out, peak_out, damping_out, q_out,
    solved_idx_out,
) -> None:  # fmt: skip
    """Launch; overwrites."""
    launch(
        make_sum_equations(float_of(rhs)), rhs, gain, noise, products, rhs_before, stencil_before, score,
        least, space_idx, known, damping, least_damping, most_damping, rhs_out, stencil_out, peak_out,
        damping_out, q_out, solved_idx_out,
    )  # fmt: skip
