"""What the kernel files share: where kernels live, how they are launched, and views of several neighbours."""

import threading
from collections.abc import Callable
from functools import cache
from typing import Any

import warp as wp

from evqr_kernels.checks import MOST_ELEMENTS
from evqr_kernels.operation import Variant
from evqr_kernels.operations import OPERATIONS
from evqr_kernels.warp_backend.cache import load_module
from evqr_kernels.warp_backend.graph import turn_on
from evqr_kernels.warp_backend.replay import Recorded, replayer


class _Recording(threading.local):
    """What this thread records, or lists, instead of launching; None while it does not."""

    steps: list[Recorded] | None = None
    kernels: list[tuple[wp.Kernel, Any]] | None = None


_recording = _Recording()


def launch(kernel: wp.Kernel, dim: Any, *, inputs: list[Any], outputs: list[Any], device: wp.Device) -> None:
    """Launch a kernel, or note the launch down while this thread records."""
    if _recording.kernels is not None:
        _recording.kernels.append((kernel, dim))
        return
    noting = _recording.steps is not None
    with turn_on(device.is_cpu):
        try:
            command = wp.launch(kernel, dim, inputs=inputs, outputs=outputs, device=device, record_cmd=noting)
        except Exception:
            if not load_module(kernel.module, device.alias):
                raise
            command = wp.launch(kernel, dim, inputs=inputs, outputs=outputs, device=device, record_cmd=noting)
    if _recording.steps is None:
        return
    command.arrays = (inputs, outputs)  # a command has their addresses only
    _recording.steps.append(command)


def clear(array: wp.array) -> None:
    """Fill with zeros, or note that down while this thread records."""
    if _recording.kernels is not None:
        return
    if _recording.steps is None:
        with turn_on(array.device.is_cpu):
            array.zero_()
    elif array.size:
        _recording.steps.append(array)


def record(run: Callable[[], None]) -> Callable[[], Any]:
    """Note down what ``run`` launches, launching nothing; the result launches it, as often as it is called.

    A launch has its arguments checked and packed: a fifth of a millisecond for twenty kernels, which a
    recorded sequence pays once.
    """
    return replayer(recorded(run))


def recorded(run: Callable[[], None]) -> list[Recorded]:
    """List what ``run`` launches and clears, launching nothing."""
    steps: list[Recorded] = []
    _recording.steps = steps
    try:
        run()
    finally:
        _recording.steps = None
    return steps


def kernels_of(run: Callable[[], None]) -> list[wp.Kernel]:
    """List the kernels that ``run`` launches, launching and compiling nothing."""
    return [kernel for kernel, _ in launches_of(run)]


def launches_of(run: Callable[[], None]) -> list[tuple[wp.Kernel, Any]]:
    """List the kernels that ``run`` launches, each with its number of threads along each axis."""
    _recording.kernels = kernels = []
    try:
        run()
    finally:
        _recording.kernels = None
    return kernels


def variant(op: str, device: wp.Device, width: int = MOST_ELEMENTS) -> Variant:
    """Choose what an operation's kernels are built for, by device and width."""
    return OPERATIONS[op].variant("warp", kind_of(device), architecture_of(device), width)


def kind_of(device: wp.Device) -> str:
    """Name the kind of a device."""
    return "cpu" if device.is_cpu else "cuda"


def architecture_of(device: wp.Device) -> int:
    """Give the architecture of a device: 90 for compute capability 9.0, 0 of a CPU."""
    return 0 if device.is_cpu else device.arch


CPU_FLAGS = ("-ffp-contract=fast", "-mreassociate", "-fno-signed-zeros")
"""A multiplication and an addition are one instruction, as on GPUs, and sums of a vector are made in parts;
NaN and infinity keep their meaning."""


@cache
def module_of(concept: str, dtype: type, lanes: int = 256) -> wp.Module:
    """Give the Warp module that a concept's kernels of one precision are compiled into, together.

    ``lanes``: threads of their blocks on a GPU.
    """
    module = wp.get_module(f"evqr_kernels_{concept}_{dtype.__name__}")
    module.options["block_dim"] = lanes
    module.options["enable_backward"] = False  # the adjoints are written by hand
    module.options["cpu_compiler_flags"] = " ".join(
        [wp.config.cpu_compiler_flags or "-march=native", *CPU_FLAGS]
    )
    return module


def launch_bounds(dtype: type) -> tuple[int, int]:
    """Give the threads of a GPU's block, and how many blocks shall fit on a multiprocessor.

    For kernels whose compiler would take more than 64 registers, or 128 in double precision, unasked.
    """
    return 256, 4 if dtype is wp.float32 else 2


@cache
def vector(length: int, dtype: type) -> type:
    """Give the vector type; Warp makes a new one each time it is asked."""
    return wp.types.vector(length=length, dtype=dtype)


def neighbours(array: wp.array, count: int) -> wp.array:
    """View whose element i of the last axis is the vector of entries i to i + count - 1: they overlap.

    A kernel cannot know that neighbours in an array lie side by side in memory, a vector's components do: one
    load and one index computation instead of ``count``, and arithmetic that runs on the CPU's vector units.
    """
    view = wp.array(
        ptr=array.ptr,
        dtype=vector(count, array.dtype),
        shape=(*array.shape[:-1], max(array.shape[-1] - count + 1, 0)),
        strides=array.strides,
        device=array.device,
    )
    view._ref = array  # keeps the memory for as long as the view lives, as Warp's own views do
    return view


def last_axis_as_vector(array: wp.array) -> wp.array:
    """View whose element i is the vector of all entries of the last axis; it may be empty."""
    dtype = vector(array.shape[-1], array.dtype)
    return (
        array.view(dtype)
        if array.size
        else wp.array(shape=array.shape[:-1], dtype=dtype, device=array.device)
    )
