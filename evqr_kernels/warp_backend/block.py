"""Threads of a GPU that share one thing: what they hold together, and where they wait for each other.

A kernel with a block a window is launched with as many threads along its last axis as its module's blocks
have (`lanes_on`), and all of them pass every `wait` and every sum: conditions around those are the same for
all.  On a CPU a block is one thread, which has nobody to wait for.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import vector

MOST_BYTES = 46_080
"""Shared memory that any GPU gives a block without being asked, less what sums and Warp take."""


def lanes_on(device: wp.Device, lanes: int) -> int:
    """Give how many threads a block has that was built with so many."""
    return 1 if device.is_cpu else lanes


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
""")
def wait():
    """Wait for all threads of the block, and see what they have written."""
    ...


@cache
def make_block_sum(dtype: type, slots: int) -> wp.Function:
    """Build the sum over a block, which all of its threads get: in an order that is always the same.

    One wait: a ``slot`` is written again only once another sum, or a `wait`, lies between.
    """
    snippet = f"""
#if defined(__CUDA_ARCH__)
    __shared__ wp::{dtype.__name__} parts[{slots}][32];
    for (int far = 16; far > 0; far >>= 1)
        value += __shfl_xor_sync(0xffffffff, value, far);
    if ((threadIdx.x & 31) == 0)
        parts[slot][threadIdx.x >> 5] = value;
    __syncthreads();
    wp::{dtype.__name__} total = 0;
    for (int k = 0; k < (blockDim.x >> 5); ++k)
        total += parts[slot][k];
    return total;
#else
    return value;
#endif
"""

    @wp.func_native(snippet)
    def block_sum(value: dtype, slot: int) -> dtype: ...

    return block_sum


@cache
def make_block_moments(dtype: type, columns: int) -> wp.Function:
    """Build the sums of ``columns`` numbers of each thread, and of one more, side by side in memory."""
    snippet = f"""
    auto total = (wp::{dtype.__name__}*)address;
#if defined(__CUDA_ARCH__)
    __shared__ wp::{dtype.__name__} parts[32][{columns + 1}];
    for (int c = 0; c <= {columns}; ++c) {{
        wp::{dtype.__name__} value = c < {columns} ? moments[c] : energy;
        for (int far = 16; far > 0; far >>= 1)
            value += __shfl_xor_sync(0xffffffff, value, far);
        if ((threadIdx.x & 31) == 0)
            parts[threadIdx.x >> 5][c] = value;
    }}
    __syncthreads();
    for (int c = threadIdx.x; c <= {columns}; c += blockDim.x) {{
        total[c] = 0;
        for (int k = 0; k < (blockDim.x >> 5); ++k)
            total[c] += parts[k][c];
    }}
    __syncthreads();
#else
    for (int c = 0; c < {columns}; ++c)
        total[c] = moments[c];
    total[{columns}] = energy;
#endif
"""

    @wp.func_native(snippet)
    def block_moments(moments: vector(columns, dtype), energy: dtype, address: wp.uint64): ...

    return block_moments


@cache
def make_held(dtype: type, room: int) -> wp.Function:
    """Build what gives the address of so many numbers that a block holds together.

    On a CPU, where a block is one thread, threads of the host would share it: for tests alone.
    """
    snippet = f"""
#if defined(__CUDA_ARCH__)
    __shared__ wp::{dtype.__name__} numbers[{max(room, 1)}];
#else
    static wp::{dtype.__name__} numbers[{max(room, 1)}];
#endif
    return (wp::uint64)numbers;
"""

    @wp.func_native(snippet)
    def held() -> wp.uint64: ...

    return held
