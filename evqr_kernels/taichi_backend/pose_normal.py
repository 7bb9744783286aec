"""Normal equations of one Gauss-Newton step on a pose; see ``warp_backend/pose_normal.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import launch


@cache
def make_factor_of(dtype):
    """Build what a term is multiplied with: 0 nothing, 1 and 2 the gain along u and v, 3 one."""

    @ti.func
    def factor_of(kind, gain: ti.template(), h):
        factor = dtype(0.0)
        if kind == 1:
            factor = gain[h, 0]
        elif kind == 2:
            factor = gain[h, 1]
        elif kind == 3:
            factor = dtype(1.0)
        return factor

    return factor_of


@cache
def make_pose_normal_equations(dtype):
    """Build gain, matrix and right-hand side: one thread per pose, then per entry, then per parameter."""
    factor_of = make_factor_of(dtype)

    @ti.kernel
    def pose_normal_equations(
        moments: array(dtype, 2),
        gram: array(dtype, 2),
        terms: array(ti.i32, 2),
        factors: array(ti.i32, 2),
        ridge: dtype,
        gain_out: array(dtype, 2),
        matrix_out: array(dtype, 3),
        rhs_out: array(dtype, 2),
    ):
        for h in range(gain_out.shape[0]):
            u = gram.shape[0] - 2
            v = gram.shape[0] - 1
            extra = ridge * (gram[u, u] + gram[v, v])
            guu = gram[u, u] + extra
            gvv = gram[v, v] + extra
            guv = gram[u, v]
            determinant = guu * gvv - guv * guv
            gain_out[h, 0] = -(gvv * moments[h, u] - guv * moments[h, v]) / determinant
            gain_out[h, 1] = -(guu * moments[h, v] - guv * moments[h, u]) / determinant
        for h, p, q in ti.ndrange(matrix_out.shape[0], matrix_out.shape[1], matrix_out.shape[2]):
            total = dtype(0.0)
            for k in range(terms.shape[1]):
                for m in range(terms.shape[1]):
                    weight = factor_of(factors[p, k], gain_out, h) * factor_of(factors[q, m], gain_out, h)
                    total += weight * gram[terms[p, k], terms[q, m]]
            matrix_out[h, p, q] = total
        for h, p in ti.ndrange(rhs_out.shape[0], rhs_out.shape[1]):
            columns = gram.shape[0]
            total = dtype(0.0)
            for k in range(terms.shape[1]):
                c = terms[p, k]
                model = gain_out[h, 0] * gram[c, columns - 2] + gain_out[h, 1] * gram[c, columns - 1]
                total += factor_of(factors[p, k], gain_out, h) * (moments[h, c] + model)
            rhs_out[h, p] = total

    return pose_normal_equations


def pose_normal_equations(moments, gram, terms, factors, ridge: float, gain_out, matrix_out, rhs_out) -> None:
    """Launch; overwrites."""
    kernel = make_pose_normal_equations(float_of(moments))
    launch(kernel, moments, gram, terms, factors, ridge, gain_out, matrix_out, rhs_out)
