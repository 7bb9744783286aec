"""Normal equations of modules: A^T A and A^T E, and the product of the first with modules.

The model ``A q = a_u B q B'^T + a_v B' q B^T`` (see ``code``) meets itself, shifted by (k, m) modules, in

    stencil(k, m) = a_u^2 bb(k) ss(m) + a_v^2 ss(k) bb(m) + a_u a_v (bs(k) bs(-m) + bs(-k) bs(m))

with bb, ss and bs the correlations of profile and profile, slope and slope, profile and slope at whole
modules.  So A^T A is one banded matrix for all modules, stored as its stencil; next to the border of the
lattice, where profiles are cut off, it is that of a lattice without end.

    product = (stencil + damping I) q   on the free modules, 0 on the others

with q taken as it is on all modules.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.code import code_rhs
from evqr_kernels.warp_backend.language import launch, module_of


@cache
def make_product_at(dtype: type) -> wp.Function:
    """Build the function that applies the stencil at one module to two fields, ``first + beta second``."""

    @wp.func
    def product_at(
        stencil: wp.array3d(dtype=dtype),
        fields: wp.array4d(dtype=dtype),
        first: int,
        second: int,
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
            if row >= 0 and column >= 0 and row < fields.shape[2] and column < fields.shape[3]:
                both = fields[b, first, row, column] + beta * fields[b, second, row, column]
                total += stencil[b, k, m] * both
        return total

    return product_at


@cache
def make_correlation(dtype: type) -> wp.Function:
    """Build the correlation of two profiles at a shift: sum over s of f(s) g(s + shift)."""

    @wp.func
    def correlation(f: wp.array(dtype=dtype), g: wp.array(dtype=dtype), shift: int) -> dtype:
        total = dtype(0.0)
        for s in range(wp.max(0, -shift), wp.min(f.shape[0], g.shape[0] - shift)):
            total += f[s] * g[s + shift]
        return total

    return correlation


@cache
def make_code_stencil(dtype: type) -> wp.Kernel:
    """Build the stencil; launch: one thread per entry."""
    correlation = make_correlation(dtype)

    @wp.kernel(module=module_of("code_normal", dtype))
    def code_stencil(
        profile: wp.array(dtype=dtype),
        slope: wp.array(dtype=dtype),
        gain: wp.array2d(dtype=dtype),
        samples_a_module: int,
        stencil_out: wp.array3d(dtype=dtype),
    ):
        b, i, j = wp.tid()
        k = (i - stencil_out.shape[1] // 2) * samples_a_module
        m = (j - stencil_out.shape[2] // 2) * samples_a_module
        gain_u = gain[b, 0]
        gain_v = gain[b, 1]
        along_u = correlation(profile, profile, k) * correlation(slope, slope, m)
        along_v = correlation(slope, slope, k) * correlation(profile, profile, m)
        mixed = correlation(profile, slope, k) * correlation(profile, slope, -m)
        mixed += correlation(profile, slope, -k) * correlation(profile, slope, m)
        stencil_out[b, i, j] = gain_u * gain_u * along_u + gain_v * gain_v * along_v + gain_u * gain_v * mixed

    return code_stencil


def code_normal_equations(
    image, pose, space_idx, lattice_u, lattice_v, sides, profile, slope, gain, samples_a_module: int,
    samples_out, rows_out, stencil_out, rhs_out,
) -> None:  # fmt: skip
    """Launch; overwrites."""
    launch(
        make_code_stencil(image.dtype),
        stencil_out.shape,
        inputs=[profile, slope, gain, samples_a_module],
        outputs=[stencil_out],
        device=image.device,
    )
    code_rhs(
        image, pose, space_idx, lattice_u, lattice_v, sides, profile, slope, gain, samples_a_module,
        samples_out, rows_out, rhs_out,
    )  # fmt: skip


@cache
def make_code_product(dtype: type) -> wp.Kernel:
    """Build the product; launch: one thread per module."""
    product_at = make_product_at(dtype)

    @wp.kernel(module=module_of("code_normal", dtype))
    def code_product(
        q: wp.array4d(dtype=dtype),
        stencil: wp.array3d(dtype=dtype),
        damping: wp.array(dtype=dtype),
        free: wp.array2d(dtype=wp.int32),
        product_out: wp.array3d(dtype=dtype),
    ):
        b, i, j = wp.tid()
        total = dtype(0.0)
        if free[i, j] != 0:
            total = product_at(stencil, q, 0, 0, dtype(0.0), b, i, j) + damping[b] * q[b, 0, i, j]
        product_out[b, i, j] = total

    return code_product


def code_product(q, stencil, damping, free, product_out) -> None:
    """Launch; overwrites."""
    launch(
        make_code_product(q.dtype),
        q.shape,
        inputs=[q.reshape((q.shape[0], 1, *q.shape[1:])), stencil, damping, free],
        outputs=[product_out],
        device=q.device,
    )
