"""Threads of a GPU that do one thing together; see ``warp_backend/block.py``.

Taichi has no blocks on a CPU.  A kernel's loop runs over things times lanes, in blocks of so many lanes, so
that all lanes of a thing, and no others, are in one block.
"""

from functools import cache

from evqr_kernels.taichi_backend.language import ti

MOST_BYTES = 30_720
"""Shared memory that GPUs with Vulkan or Metal give a block, less what sums take."""


@ti.func
def wait():
    """Wait for all lanes of the block, and see what they have written."""
    ti.simt.block.mem_sync()
    ti.simt.block.sync()


@cache
def make_block_sum(dtype, lanes: int):
    """Build the sum over a block of a value of each lane, which all get: in an order that is always the same.

    One wait.  ``parts``: (2, lanes), shared.  A ``slot`` of it is written again only once another sum, or a
    `wait`, lies between.
    """

    @ti.func
    def block_sum(value, parts: ti.template(), slot: ti.template(), lane):
        parts[slot, lane] = value
        wait()
        total = dtype(0.0)
        for k in range(lanes):
            total += parts[slot, k]
        return total

    return block_sum
