"""Normal equations of one Gauss-Newton step on a pose, from moments of the image.

With the moments of an image seen through a pose (``pose``), the Gram matrix of the table they were taken
with, its last two columns L_u and L_v, and the residual ``r_s = e_s + a_u L_u + a_v L_v`` of its points:

    gain    a      = -(gram_LL + ridge tr(gram_LL) I)^-1 moments_L           least squares
    matrix  J^T J  = T gram T^T
    rhs     J^T r  = T (moments + gram_L a),        T = (sum_k factor(p, k) e_terms(p, k))_p

J are the derivatives of the residual; the image enters by its moments alone, whose sums ``sample_moments``
makes in two passes.  ``terms`` and ``factors``: see ``align``, which takes such steps until they are small;
the step is ``-matrix^-1 rhs``.  One thread owns each entry: no atomics, deterministic.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of


@cache
def make_fit_gain(dtype: type) -> wp.Kernel:
    """Build the least-squares gain; launch: one thread per pose."""

    @wp.kernel(module=module_of("pose_normal", dtype))
    def fit_gain(
        moments: wp.array2d(dtype=dtype),
        gram: wp.array2d(dtype=dtype),
        ridge: dtype,
        gain_out: wp.array2d(dtype=dtype),
    ):
        h = wp.tid()
        u = gram.shape[0] - 2
        v = gram.shape[0] - 1
        extra = ridge * (gram[u, u] + gram[v, v])
        guu = gram[u, u] + extra
        gvv = gram[v, v] + extra
        guv = gram[u, v]
        determinant = guu * gvv - guv * guv
        gain_out[h, 0] = -(gvv * moments[h, u] - guv * moments[h, v]) / determinant
        gain_out[h, 1] = -(guu * moments[h, v] - guv * moments[h, u]) / determinant

    return fit_gain


@cache
def make_factor_of(dtype: type) -> wp.Function:
    """Build what a term is multiplied with: 0 nothing, 1 and 2 the gain along u and v, 3 one."""

    @wp.func
    def factor_of(kind: int, gain: wp.array2d(dtype=dtype), h: int) -> dtype:
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
def make_normal_matrix(dtype: type) -> wp.Kernel:
    """Build the matrix; launch: one thread per (pose, entry)."""
    factor_of = make_factor_of(dtype)

    @wp.kernel(module=module_of("pose_normal", dtype))
    def normal_matrix(
        gram: wp.array2d(dtype=dtype),
        gain: wp.array2d(dtype=dtype),
        terms: wp.array2d(dtype=wp.int32),
        factors: wp.array2d(dtype=wp.int32),
        matrix_out: wp.array3d(dtype=dtype),
    ):
        h, p, q = wp.tid()
        total = dtype(0.0)
        count = terms.shape[1]
        # one loop, not two: a GPU's compiler unrolls each four times, which takes twice the registers
        for n in range(count * count):
            k = n // count
            m = n - k * count
            weight = factor_of(factors[p, k], gain, h) * factor_of(factors[q, m], gain, h)
            total += weight * gram[terms[p, k], terms[q, m]]
        matrix_out[h, p, q] = total

    return normal_matrix


@cache
def make_normal_rhs(dtype: type) -> wp.Kernel:
    """Build the right-hand side; launch: one thread per (pose, parameter)."""
    factor_of = make_factor_of(dtype)

    @wp.kernel(module=module_of("pose_normal", dtype))
    def normal_rhs(
        moments: wp.array2d(dtype=dtype),
        gram: wp.array2d(dtype=dtype),
        gain: wp.array2d(dtype=dtype),
        terms: wp.array2d(dtype=wp.int32),
        factors: wp.array2d(dtype=wp.int32),
        rhs_out: wp.array2d(dtype=dtype),
    ):
        h, p = wp.tid()
        columns = gram.shape[0]
        total = dtype(0.0)
        for k in range(terms.shape[1]):
            c = terms[p, k]
            model = gain[h, 0] * gram[c, columns - 2] + gain[h, 1] * gram[c, columns - 1]
            total += factor_of(factors[p, k], gain, h) * (moments[h, c] + model)
        rhs_out[h, p] = total

    return normal_rhs


def pose_normal_equations(moments, gram, terms, factors, ridge: float, gain_out, matrix_out, rhs_out) -> None:
    """Launch; overwrites."""
    dtype, device = moments.dtype, moments.device
    launch(
        make_fit_gain(dtype),
        moments.shape[0],
        inputs=[moments, gram, ridge],
        outputs=[gain_out],
        device=device,
    )
    launch(
        make_normal_matrix(dtype),
        matrix_out.shape,
        inputs=[gram, gain_out, terms, factors],
        outputs=[matrix_out],
        device=device,
    )
    launch(
        make_normal_rhs(dtype),
        rhs_out.shape,
        inputs=[moments, gram, gain_out, terms, factors],
        outputs=[rhs_out],
        device=device,
    )
