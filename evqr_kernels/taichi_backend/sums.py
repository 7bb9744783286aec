"""The second pass of every sum that must not depend on the order of threads; see ``warp_backend/sums.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import launch


@cache
def make_add_partials(dtype):
    """Build the pass; one thread per result."""

    @ti.kernel
    def add_partials(partial: array(dtype, 3), total_out: array(dtype, 2)):
        for b, c in ti.ndrange(total_out.shape[0], total_out.shape[1]):
            total = dtype(0.0)
            for k in range(partial.shape[1]):
                total += partial[b, k, c]
            total_out[b, c] = total

    return add_partials


def add_partials(partial, total_out) -> None:
    """Launch; overwrites."""
    launch(make_add_partials(float_of(partial)), partial, total_out)
