"""What the kernel files share: where kernels live, and views that load several neighbours at once."""

from functools import cache

import warp as wp


@cache
def module_of(concept: str, dtype: type) -> wp.Module:
    """Give the Warp module that a concept's kernels of one precision are compiled into, together."""
    module = wp.get_module(f"evqr_kernels_{concept}_{dtype.__name__}")
    module.options["enable_backward"] = False  # the adjoints are written by hand
    return module


def launch_bounds(dtype: type, narrow: bool = True) -> tuple[int, int]:
    """Give the threads of a GPU's block, and how many blocks shall fit on a multiprocessor.

    For kernels whose compiler would take more than 64 registers, or 128 in double precision, unasked; those
    that are not ``narrow`` need more.
    """
    return 256, (4 if dtype is wp.float32 else 2) if narrow else 1


@cache
def vector(length: int, dtype: type) -> type:
    """Give the vector type; Warp makes a new one each time it is asked."""
    return wp.types.vector(length=length, dtype=dtype)


def neighbours(array: wp.array, count: int) -> wp.array:
    """View whose element i of the last axis is the vector of entries i to i + count - 1: they overlap.

    A kernel cannot know that neighbours in an array lie side by side in memory, a vector's components do: one
    load and one index computation instead of ``count``, and arithmetic that runs on the CPU's vector units.
    """
    return wp.array(
        ptr=array.ptr,
        dtype=vector(count, array.dtype),
        shape=(*array.shape[:-1], max(array.shape[-1] - count + 1, 0)),
        strides=array.strides,
        device=array.device,
    )


def last_axis_as_vector(array: wp.array) -> wp.array:
    """View whose element i is the vector of all entries of the last axis; it may be empty."""
    dtype = vector(array.shape[-1], array.dtype)
    return (
        array.view(dtype)
        if array.size
        else wp.array(shape=array.shape[:-1], dtype=dtype, device=array.device)
    )
