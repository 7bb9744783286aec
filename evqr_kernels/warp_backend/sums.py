"""The second pass of every sum that must not depend on the order of threads.

    total(b, c) = sum_k partial(b, k, c)

A first pass leaves partial sums that one thread each owns; here one thread per result adds them up, in order.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of


@cache
def make_add_partials(dtype: type) -> wp.Kernel:
    """Build the pass; launch: one thread per result."""

    @wp.kernel(module=module_of("sums", dtype))
    def add_partials(
        partial: wp.array3d(dtype=dtype),
        total_out: wp.array2d(dtype=dtype),
    ):
        b, c = wp.tid()
        total = dtype(0.0)
        for k in range(partial.shape[1]):
            total += partial[b, k, c]
        total_out[b, c] = total

    return add_partials


def add_partials(partial, total_out) -> None:
    """Launch; overwrites."""
    launch(
        make_add_partials(partial.dtype),
        total_out.shape,
        inputs=[partial],
        outputs=[total_out],
        device=partial.device,
    )
