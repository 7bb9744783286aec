"""A recorded sequence of launches on the CPU, made in one launch.

Each launch from Python takes some microseconds, and lets go of the GIL and waits for it again: seventy times
a window, for which two threads wait for each other.  One kernel that calls the others in turn does so once.
Warp's graphs do the same, but while one thread captures a graph on the CPU, the launches of every other
thread are taken for part of it.
"""

import ctypes
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import warp as wp

Step: TypeAlias = "wp.Launch | wp.array"
"""A launch, or an array to fill with zeros."""

ENTRIES_OF = ("1.19.",)
"""Versions of Warp whose compiled kernels are known to be functions of two pointers, to the bounds of the
launch and to a structure of its arguments; with others, each step is launched by itself."""


@wp.func_native("""
    typedef void (*entry_t)(void*, void*);
    const wp::uint64* step = steps.data;
    for (int i = 0; i < count; ++i, step += 3) {
        void* where = (void*)step[1];
        if (step[0])
            ((entry_t)step[0])(where, (void*)step[2]);
        else
            memset(where, 0, step[2]);
    }
""")
def run_steps(steps: wp.array(dtype=wp.uint64), count: int):
    """Call kernels by their addresses."""
    ...


@wp.kernel(module="unique", enable_backward=False)
def run_sequence(steps: wp.array(dtype=wp.uint64), count: int):
    """Run each step: a kernel's address, bounds and arguments, or zero, an address and a number of bytes."""
    run_steps(steps, count)


def replayer(steps: list[Step]) -> Callable[[], Any]:
    """Give the function that makes the steps, in order."""
    solid = all(isinstance(step, wp.Launch) or step.is_contiguous for step in steps)
    if steps and steps[0].device.is_cpu and solid and wp.config.version.startswith(ENTRIES_OF):
        return _in_one_launch(steps)
    calls = [step.launch if isinstance(step, wp.Launch) else step.zero_ for step in steps]

    def replay() -> None:
        for call in calls:
            call()

    return replay


def _in_one_launch(steps: list[Step]) -> Callable[[], Any]:
    table = np.zeros((len(steps), 3), np.uint64)
    kept: list[Any] = [steps]
    for row, step in zip(table, steps, strict=True):
        if isinstance(step, wp.Launch):
            arguments = _structure(step.params[1:])
            kept.append(arguments)
            row[0] = ctypes.cast(step.hooks.forward, ctypes.c_void_p).value
            row[1], row[2] = ctypes.addressof(step.bounds), ctypes.addressof(arguments)
        else:
            row[1], row[2] = step.ptr, step.size * wp.types.type_size_in_bytes(step.dtype)
    array = wp.array(table.ravel(), dtype=wp.uint64, device="cpu")
    command = wp.launch(run_sequence, 1, inputs=[array, len(steps)], device="cpu", record_cmd=True)
    command.kept = (kept, table, array)  # the launch has their addresses only
    return command.launch


def _structure(values: list[Any]) -> ctypes.Structure:
    """Lay arguments out in memory as a kernel takes them."""
    fields = [(f"argument_{i}", type(value)) for i, value in enumerate(values)]
    structure = type("Arguments", (ctypes.Structure,), {"_fields_": fields})()
    for (name, _), value in zip(fields, values, strict=True):
        setattr(structure, name, value)
    return structure
