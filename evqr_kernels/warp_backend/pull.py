"""What damping pulls modules to.

    expected(b, i, j) = clip(certainty (q(b, i, j) + 1), -1, 1)
    rhs(b, i, j) = seen(b, i, j) + damping(b) (1 - expected(b, i, j))
    unclear(b, i) = how many |expected(b, i, j)| < 1

q is a solution's distance from light, so q + 1 is -1 where dark and +1 where light.  The damping of
``(A^T A + damping I) q = -rhs`` then pulls each module to the dark or light that it leant to before.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, vector

BLOCK = 8
"""Neighbouring modules done together."""


@cache
def make_pull_modules(dtype: type) -> wp.Kernel:
    """Build the pull; launch: one thread per row.  ``.._blocks``: `neighbours`."""
    vec_block = vector(BLOCK, dtype)

    @wp.kernel(module=module_of("pull", dtype))
    def pull_modules(
        seen: wp.array3d(dtype=dtype),
        seen_blocks: wp.array3d(dtype=vec_block),
        q: wp.array3d(dtype=dtype),
        q_blocks: wp.array3d(dtype=vec_block),
        damping: wp.array(dtype=dtype),
        certainty: dtype,
        rhs_out: wp.array3d(dtype=dtype),
        rhs_blocks_out: wp.array3d(dtype=vec_block),
        unclear_out: wp.array2d(dtype=wp.int32),
    ):
        b, i = wp.tid()
        ones = vec_block(dtype(1.0))
        whole = (q.shape[2] // BLOCK) * BLOCK
        unclear = wp.int32(0)
        for j in range(0, whole, BLOCK):
            leaning_block = certainty * (q_blocks[b, i, j] + ones)
            # in this order 1 stands for NaN
            expected_block = wp.max(wp.min(leaning_block, ones), -ones)
            rhs_blocks_out[b, i, j] = seen_blocks[b, i, j] + damping[b] * (ones - expected_block)
            for c in range(wp.static(BLOCK)):
                unclear += wp.where(wp.abs(leaning_block[c]) < dtype(1.0), 1, 0)
        for j in range(whole, q.shape[2]):
            leaning = certainty * (q[b, i, j] + dtype(1.0))
            expected = wp.max(wp.min(leaning, dtype(1.0)), dtype(-1.0))
            rhs_out[b, i, j] = seen[b, i, j] + damping[b] * (dtype(1.0) - expected)
            unclear += wp.where(wp.abs(leaning) < dtype(1.0), 1, 0)
        unclear_out[b, i] = unclear

    return pull_modules


def pull_modules(seen, q, damping, certainty: float, rhs_out, unclear_out) -> None:
    """Launch; overwrites."""
    launch(
        make_pull_modules(q.dtype),
        q.shape[:2],
        inputs=[seen, neighbours(seen, BLOCK), q, neighbours(q, BLOCK), damping, certainty],
        outputs=[rhs_out, neighbours(rhs_out, BLOCK), unclear_out],
        device=q.device,
    )
