"""What damping pulls modules to.

    expected(b, i, j) = clip(certainty (q(b, i, j) + 1), -1, 1)
    rhs(b, i, j) = seen(b, i, j) + damping(b) (1 - expected(b, i, j))
    unclear(b, i) = how many |expected(b, i, j)| < 1

q is a solution's distance from light, so q + 1 is -1 where dark and +1 where light.  The damping of
``(A^T A + damping I) q = -rhs`` then pulls each module to the dark or light that it leant to before.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of


@cache
def make_pull_modules(dtype: type) -> wp.Kernel:
    """Build the pull; launch: one thread per row."""

    @wp.kernel(module=module_of("solve", dtype))
    def pull_modules(
        seen: wp.array3d(dtype=dtype),
        q: wp.array3d(dtype=dtype),
        damping: wp.array(dtype=dtype),
        certainty: dtype,
        rhs_out: wp.array3d(dtype=dtype),
        unclear_out: wp.array2d(dtype=wp.int32),
    ):
        b, i = wp.tid()
        unclear = wp.int32(0)
        for j in range(q.shape[2]):
            leaning = certainty * (q[b, i, j] + dtype(1.0))
            expected = wp.clamp(leaning, dtype(-1.0), dtype(1.0))
            rhs_out[b, i, j] = seen[b, i, j] + damping[b] * (dtype(1.0) - expected)
            unclear += wp.where(wp.abs(leaning) < dtype(1.0), 1, 0)
        unclear_out[b, i] = unclear

    return pull_modules


def pull_modules(seen, q, damping, certainty: float, rhs_out, unclear_out) -> None:
    """Launch; overwrites."""
    launch(
        make_pull_modules(q.dtype),
        q.shape[:2],
        inputs=[seen, q, damping, certainty],
        outputs=[rhs_out, unclear_out],
        device=q.device,
    )
