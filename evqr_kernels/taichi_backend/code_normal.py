"""Normal equations of modules; the formulas are in ``warp_backend/code_normal.py``."""

from functools import cache

from evqr_kernels.taichi_backend.code import code_rhs
from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.solve import make_stencil_at


@cache
def make_correlation(dtype):
    """Build the correlation of two profiles at a shift: sum over s of f(s) g(s + shift)."""

    @ti.func
    def correlation(f: ti.template(), g: ti.template(), shift):
        total = dtype(0.0)
        for s in range(ti.max(0, -shift), ti.min(f.shape[0], g.shape[0] - shift)):
            total += f[s] * g[s + shift]
        return total

    return correlation


@cache
def make_code_stencil(dtype):
    """Build the stencil; one thread per entry."""
    correlation = make_correlation(dtype)

    @ti.kernel
    def code_stencil(
        profile: array(dtype, 1),
        slope: array(dtype, 1),
        gain: array(dtype, 2),
        samples_a_module: ti.i32,
        stencil_out: array(dtype, 3),
    ):
        for b, i, j in ti.ndrange(stencil_out.shape[0], stencil_out.shape[1], stencil_out.shape[2]):
            k = (i - stencil_out.shape[1] // 2) * samples_a_module
            m = (j - stencil_out.shape[2] // 2) * samples_a_module
            gain_u = gain[b, 0]
            gain_v = gain[b, 1]
            along_u = correlation(profile, profile, k) * correlation(slope, slope, m)
            along_v = correlation(slope, slope, k) * correlation(profile, profile, m)
            mixed = correlation(profile, slope, k) * correlation(profile, slope, -m)
            mixed += correlation(profile, slope, -k) * correlation(profile, slope, m)
            total = gain_u * gain_u * along_u + gain_v * gain_v * along_v
            stencil_out[b, i, j] = total + gain_u * gain_v * mixed

    return code_stencil


def code_normal_equations(
    image, pose, space_idx, lattice_u, lattice_v, sides, profile, slope, gain, samples_a_module: int,
    samples_out, rows_out, stencil_out, rhs_out,
) -> None:  # fmt: skip
    """Launch; overwrites."""
    launch(make_code_stencil(float_of(image)), profile, slope, gain, samples_a_module, stencil_out)
    code_rhs(
        image, pose, space_idx, lattice_u, lattice_v, sides, profile, slope, gain, samples_a_module,
        samples_out, rows_out, rhs_out,
    )  # fmt: skip


@cache
def make_code_product(dtype):
    """Build the product; one thread per (window, row of modules)."""
    stencil_at = make_stencil_at(dtype)

    @ti.kernel
    def code_product(
        q: array(dtype, 3),
        stencil: array(dtype, 3),
        damping: array(dtype, 1),
        free: array(ti.i32, 2),
        product_out: array(dtype, 3),
    ):
        for b, i in ti.ndrange(product_out.shape[0], product_out.shape[1]):
            for j in range(product_out.shape[2]):
                total = dtype(0.0)
                if free[i, j] != 0:
                    total = stencil_at(q, stencil, b, i, j) + damping[b] * q[b, i, j]
                product_out[b, i, j] = total

    return code_product


def code_product(q, stencil, damping, free, product_out) -> None:
    """Launch; overwrites."""
    launch(make_code_product(float_of(q)), q, stencil, damping, free, product_out)
