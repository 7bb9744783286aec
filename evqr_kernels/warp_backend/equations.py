"""Windows' equations, added to those of earlier windows by their noise, and made ready to be solved.

    weight = 1 / max(noise, 1e-12)
    rhs = (rhs before + weight rhs of the window) / peak
    stencil = (stencil before + weight (a_u^2 P_0 + a_v^2 P_1 + a_u a_v P_2)) / peak
    damping = clip(damping of the sum / peak, least, most)

The normal matrix of a window depends on its gain (a_u, a_v) alone, see ``code_normal``.  The peak is the
middle of the summed stencil: windows add up, and single precision has its ends.  A window that agrees less
well than it should keeps its sum, but is not solved for: its code is number 0.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, vector

BLOCK = 8
"""Neighbouring modules done together."""

LEAST_NOISE = 1e-12
"""What less noise counts as."""


@cache
def make_sum_equations(dtype: type) -> wp.Kernel:
    """Build the sum; launch: one thread per row, the first of a window sums stencils.

    ``.._blocks``: `neighbours`.
    """
    vec_block = vector(BLOCK, dtype)

    @wp.func
    def stencil_at(
        stencil_before: wp.array3d(dtype=dtype),
        products: wp.array3d(dtype=dtype),
        weight: dtype,
        a_u: dtype,
        a_v: dtype,
        b: int,
        k: int,
        n: int,
    ) -> dtype:
        own = a_u * a_u * products[0, k, n] + a_v * a_v * products[1, k, n] + a_u * a_v * products[2, k, n]
        return stencil_before[b, k, n] + weight * own

    @wp.kernel(module=module_of("equations", dtype))
    def sum_equations(
        rhs: wp.array3d(dtype=dtype),
        rhs_blocks: wp.array3d(dtype=vec_block),
        gain: wp.array2d(dtype=dtype),
        noise: wp.array(dtype=dtype),
        products: wp.array3d(dtype=dtype),
        rhs_before: wp.array3d(dtype=dtype),
        rhs_before_blocks: wp.array3d(dtype=vec_block),
        stencil_before: wp.array3d(dtype=dtype),
        score: wp.array(dtype=dtype),
        least: wp.array(dtype=dtype),
        space_idx: wp.array(dtype=wp.int32),
        known: wp.array3d(dtype=dtype),
        known_blocks: wp.array3d(dtype=vec_block),
        damping: dtype,
        least_damping: dtype,
        most_damping: dtype,
        rhs_out: wp.array3d(dtype=dtype),
        rhs_blocks_out: wp.array3d(dtype=vec_block),
        stencil_out: wp.array3d(dtype=dtype),
        peak_out: wp.array(dtype=dtype),
        damping_out: wp.array(dtype=dtype),
        q_out: wp.array3d(dtype=dtype),
        q_blocks_out: wp.array3d(dtype=vec_block),
        solved_idx_out: wp.array(dtype=wp.int32),
    ):
        b, i = wp.tid()
        m = space_idx[b]
        weight = dtype(1.0) / wp.max(noise[b], dtype(LEAST_NOISE))
        a_u = gain[b, 0]
        a_v = gain[b, 1]
        middle = products.shape[1] // 2
        peak = stencil_at(stencil_before, products, weight, a_u, a_v, b, middle, middle)
        if peak == dtype(0.0):
            peak = dtype(1.0)
        scale = dtype(1.0) / peak
        whole = (rhs.shape[2] // BLOCK) * BLOCK
        for j in range(0, whole, BLOCK):
            rhs_blocks_out[b, i, j] = scale * (rhs_before_blocks[b, i, j] + weight * rhs_blocks[b, i, j])
            q_blocks_out[b, i, j] = known_blocks[m, i, j]
        for j in range(whole, rhs.shape[2]):
            rhs_out[b, i, j] = scale * (rhs_before[b, i, j] + weight * rhs[b, i, j])
            q_out[b, i, j] = known[m, i, j]
        if i > 0:
            return
        for k in range(products.shape[1]):
            for n in range(products.shape[2]):
                total = stencil_at(stencil_before, products, weight, a_u, a_v, b, k, n)
                stencil_out[b, k, n] = scale * total
        peak_out[b] = peak
        damping_out[b] = wp.min(wp.max(scale * damping, least_damping), most_damping)
        solved_idx_out[b] = wp.where(score[b] >= least[b], m, 0)

    return sum_equations


def sum_equations(
    rhs, gain, noise, products, rhs_before, stencil_before, score, least, space_idx, known, damping: float,
    least_damping: float, most_damping: float, rhs_out, stencil_out, peak_out, damping_out, q_out,
    solved_idx_out,
) -> None:  # fmt: skip
    """Launch; overwrites."""
    before = rhs_before, neighbours(rhs_before, BLOCK), stencil_before
    launch(
        make_sum_equations(rhs.dtype),
        rhs.shape[:2],
        inputs=[
            rhs, neighbours(rhs, BLOCK), gain, noise, products, *before, score, least, space_idx, known,
            neighbours(known, BLOCK), damping, least_damping, most_damping,
        ],
        outputs=[
            rhs_out, neighbours(rhs_out, BLOCK), stencil_out, peak_out, damping_out, q_out,
            neighbours(q_out, BLOCK), solved_idx_out,
        ],
        device=rhs.device,
    )  # fmt: skip
