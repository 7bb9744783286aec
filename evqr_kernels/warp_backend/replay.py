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

Recorded: TypeAlias = "wp.Launch | wp.array"
"""A launch, or an array to fill with zeros."""

ENTRIES_OF = ("1.19.",)
"""Versions of Warp whose compiled kernels are known to be functions of two pointers, to the bounds of the
launch and to a structure of its arguments; with others, each step is launched by itself."""

_ENTRY = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)


@wp.func_native("""
    typedef void (*entry_t)(void*, void*);
    const wp::uint64* step = steps_inout.data;
    for (int i = 0; i < count; ++i, step += 3) {
        void* where = (void*)step[1];
        if (step[0])
            ((entry_t)step[0])(where, (void*)step[2]);
        else
            memset(where, 0, step[2]);
    }
""")
def run_steps(count: int, steps_inout: wp.array(dtype=wp.uint64)):
    """Call kernels by their addresses."""
    ...


@wp.kernel(module="unique", enable_backward=False)
def run_sequence(count: int, steps_inout: wp.array(dtype=wp.uint64)):
    """Run each step: a kernel's address, bounds and arguments, or zero, an address and a number of bytes."""
    run_steps(count, steps_inout)


def replayer(steps: list[Recorded]) -> Callable[[], Any]:
    """Give the function that makes the steps, in order."""
    solid = all(isinstance(step, wp.Launch) or step.is_contiguous for step in steps)
    if steps and steps[0].device.is_cpu and solid and wp.config.version.startswith(ENTRIES_OF):
        return _Sequence(steps)
    calls = [step.launch if isinstance(step, wp.Launch) else step.zero_ for step in steps]

    def replay() -> None:
        for call in calls:
            call()

    return replay


class _Sequence:
    """Steps on the CPU as one call; keeps what the call, or a graph, has only the addresses of."""

    def __init__(self, steps: list[Recorded]) -> None:
        self._steps, self._arguments = steps, []
        self._table = np.zeros((len(steps), 3), np.uint64)
        for row, step in zip(self._table, steps, strict=True):
            if isinstance(step, wp.Launch):
                row[:] = self._call_of(step)
            else:
                row[1:] = step.ptr, step.size * wp.types.type_size_in_bytes(step.dtype)
        self._array = wp.array(self._table.ravel(), dtype=wp.uint64, device="cpu")
        self._launch = wp.launch(
            run_sequence, 1, inputs=[len(steps)], outputs=[self._array], device="cpu", record_cmd=True
        )
        entry, *self._call = self._call_of(self._launch)
        self._entry = _ENTRY(entry)
        self._device = self._launch.device

    def _call_of(self, launch: wp.Launch) -> tuple[int, int, int]:
        """Lay a launch's arguments out in memory; the address of its kernel, its bounds and its arguments."""
        values = launch.params[1:]  # behind the bounds
        fields = [(f"argument_{i}", type(value)) for i, value in enumerate(values)]
        arguments = type("Arguments", (ctypes.Structure,), {"_fields_": fields})(*values)
        self._arguments.append(arguments)
        entry = ctypes.cast(launch.hooks.forward, ctypes.c_void_p).value
        return entry, ctypes.addressof(launch.bounds), ctypes.addressof(arguments)

    def __call__(self) -> None:
        if self._device.is_capturing:
            self._launch.launch()  # noted down in the graph
        else:
            self._entry(*self._call)
