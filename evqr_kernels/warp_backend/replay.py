"""A recorded sequence of launches on the CPU, made in one call.

Each launch from Python takes some microseconds, and lets go of the GIL and waits for it again: seventy times
a window, for which two threads wait for each other.  One kernel that calls the others in turn does so once.
Warp's graphs do the same, but while one thread captures a graph on the CPU, the launches of every other
thread are taken for part of it.

Who waits for the GIL sleeps, and being woken takes longer than what most waits are for.  So a thread that
has made its steps first waits awake for its turn, which the others have while they are between two sequences,
and finds the GIL free.  A turn is no lock: who has waited too long takes it, as from a thread that has gone.
"""

import ctypes
import functools
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
import warp as wp

from evqr_kernels.warp_backend.graph import Graph

Recorded: TypeAlias = "wp.Launch | wp.array"
"""A launch, or an array to fill with zeros."""

ENTRIES_OF = ("1.19.",)
"""Versions of Warp whose compiled kernels are known to be functions of two pointers, to the bounds of the
launch and to a structure of its arguments; with others, each step is launched by itself."""

_ENTRY = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)

_cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
_has_gil = getattr(sys, "_is_gil_enabled", lambda: True)()  # of Python 3.13

MOST_LOOKS = 20_000 if _cores != 1 and _has_gil else 0
"""Times that a thread looks whether it is its turn: half a millisecond on a server of 2023, longer than most
turns.  On one core who looks keeps the others from ending theirs."""

_TURN = np.zeros(64, np.int32)[32:33]
"""What all threads look at, in a cache line of its own: 1 while one has its turn."""

_NO_STEPS = np.zeros(3, np.uint64)
"""A table for no steps."""


@wp.func_native("""
    typedef void (*entry_t)(void*, void*);
    const wp::uint64* step = steps_inout.data;
    wp::int32* turn = turn_inout.data;
    __atomic_store_n(turn, 0, __ATOMIC_RELEASE);
    for (int i = 0; i < count; ++i, step += 3) {
        void* where = (void*)step[1];
        if (step[0])
            ((entry_t)step[0])(where, (void*)step[2]);
        else
            memset(where, 0, step[2]);
    }
    for (int look = 0; look < looks && __atomic_exchange_n(turn, 1, __ATOMIC_ACQUIRE); ++look) {
        for (; look < looks && __atomic_load_n(turn, __ATOMIC_RELAXED); ++look) {
#if defined(__x86_64__)
            __builtin_ia32_pause();
#elif defined(__aarch64__)
            __builtin_arm_isb(15);
#endif
        }
    }
""")
def run_steps(
    count: int, looks: int, steps_inout: wp.array(dtype=wp.uint64), turn_inout: wp.array(dtype=wp.int32)
):
    """Call kernels by their addresses, then wait for this thread's turn."""
    ...


@wp.kernel(module="unique", enable_backward=False)
def run_sequence(
    count: int, looks: int, steps_inout: wp.array(dtype=wp.uint64), turn_inout: wp.array(dtype=wp.int32)
):
    """Run each step: a kernel's address, bounds and arguments, or zero, an address and a number of bytes."""
    run_steps(count, looks, steps_inout, turn_inout)


def replayer(steps: list[Recorded], looks: int = MOST_LOOKS) -> Callable[[], Any]:
    """Give the function that makes the steps, in order, and then looks so often whether it is its turn."""
    solid = all(isinstance(step, wp.Launch) or step.is_contiguous for step in steps)
    if steps and steps[0].device.is_cpu and solid and wp.config.version.startswith(ENTRIES_OF):
        return Replay(steps, looks)
    calls = [step.launch if isinstance(step, wp.Launch) else step.zero_ for step in steps]
    if steps and not steps[0].device.is_cpu:
        return Graph(calls, steps[0].device)

    def replay() -> None:
        for call in calls:
            call()

    return replay


@functools.cache
def _structure_of(types: tuple[type, ...]) -> type[ctypes.Structure]:
    """Give the structure of a kernel's arguments; to make a class takes longer than to fill one."""
    fields = [(f"argument_{i}", each) for i, each in enumerate(types)]
    return type("Arguments", (ctypes.Structure,), {"_fields_": fields})


@functools.cache
def _turn() -> wp.array:
    """Give what all threads look at, for launches."""
    return wp.array(ptr=_TURN.ctypes.data, dtype=wp.int32, shape=1, device="cpu")


def _launch_of(count: int, looks: int, table: wp.array) -> wp.Launch:
    """Give the launch that makes the steps of a table."""
    return wp.launch(
        run_sequence, 1, inputs=[count, looks], outputs=[table, _turn()], device="cpu", record_cmd=True
    )


@functools.cache
def _no_steps() -> wp.Launch:
    """Give a launch of no steps: sequences differ from it in their number of steps and their table alone."""
    return _launch_of(0, 0, wp.array(ptr=_NO_STEPS.ctypes.data, dtype=wp.uint64, shape=3, device="cpu"))


def _entry_of(launch: wp.Launch) -> int:
    return ctypes.cast(launch.hooks.forward, ctypes.c_void_p).value


class Replay:
    """Steps on the CPU as one call; keeps what the call, or a graph, has only the addresses of.

    Attributes
    ----------
    table : (3 * steps,) uint64
        See `run_sequence`.
    arguments : list of Structure
        Those of the launches, in order, as kernels read them; and of the call.
    """

    def __init__(self, steps: list[Recorded], looks: int) -> None:
        self._steps, self._looks, self.arguments = steps, looks, []
        rows = [
            self._call_of(_entry_of(step), step.bounds, step.params[1:])
            if isinstance(step, wp.Launch)
            else (0, step.ptr, step.size * wp.types.type_size_in_bytes(step.dtype))
            for step in steps
        ]
        self.table = np.array(rows, np.uint64).ravel()
        self._array = wp.array(ptr=self.table.ctypes.data, dtype=wp.uint64, shape=3 * len(rows), device="cpu")
        alike = _no_steps()
        _, count, _, _, turn = alike.params
        values = type(count)(len(steps)), type(count)(looks), self._array.__ctype__(), turn
        entry, *self._call = self._call_of(_entry_of(alike), alike.bounds, values)
        self._entry = _ENTRY(entry)
        self._device = alike.device

    def _call_of(self, entry: int, bounds: ctypes.Structure, values: Sequence[Any]) -> tuple[int, int, int]:
        """Lay a launch's arguments out in memory; the address of its kernel, its bounds and its arguments."""
        arguments = _structure_of(tuple(map(type, values)))(*values)
        self.arguments.append(arguments)
        return entry, ctypes.addressof(bounds), ctypes.addressof(arguments)

    @functools.cached_property
    def _launch(self) -> wp.Launch:
        return _launch_of(len(self._steps), self._looks, self._array)

    def __call__(self) -> None:
        """Make the steps."""
        if self._device.is_capturing:
            self._launch.launch()  # noted down in the graph
        else:
            self._entry(*self._call)
