"""What damping pulls modules to; the formula is in ``warp_backend/pull.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import launch


@cache
def make_pull_modules(dtype):
    """Build the pull; one thread per row."""

    @ti.kernel
    def pull_modules(
        seen: array(dtype, 3),
        q: array(dtype, 3),
        damping: array(dtype, 1),
        certainty: dtype,
        rhs_out: array(dtype, 3),
        unclear_out: array(ti.i32, 2),
    ):
        for b, i in ti.ndrange(q.shape[0], q.shape[1]):
            unclear = 0
            for j in range(q.shape[2]):
                leaning = certainty * (q[b, i, j] + dtype(1.0))
                # so that 1 stands for NaN
                expected = ti.select(leaning < dtype(1.0), leaning, dtype(1.0))
                expected = ti.max(expected, dtype(-1.0))
                rhs_out[b, i, j] = seen[b, i, j] + damping[b] * (dtype(1.0) - expected)
                unclear += ti.cast(ti.abs(leaning) < dtype(1.0), ti.i32)
            unclear_out[b, i] = unclear

    return pull_modules


def pull_modules(seen, q, damping, certainty: float, rhs_out, unclear_out) -> None:
    """Launch; overwrites."""
    launch(make_pull_modules(float_of(q)), seen, q, damping, certainty, rhs_out, unclear_out)
