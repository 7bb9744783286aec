"""Launching kernels and recording launches, under the one lock that Taichi's front end needs."""

import inspect
import os
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from evqr_kernels.errors import BackendUnavailable
from evqr_kernels.taichi_backend.arrays import is_part, read, write
from evqr_kernels.taichi_backend.language import DTYPES, ti

LOCK = threading.RLock()
"""Held while Taichi compiles, launches or copies: its front end has one state for all threads."""


class _Fork:
    """Whether this process is a copy of one where Taichi ran: its threads have stayed there."""

    is_copy = False

    def note(self) -> None:
        self.is_copy = ti.cfg is not None


_fork = _Fork()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_fork.note)


def require_own_runtime() -> None:
    """Raise BackendUnavailable in a copy of a process where Taichi ran: it would wait for ever."""
    if _fork.is_copy:
        raise BackendUnavailable(
            "taichi runs in the process that this one was forked from, and cannot run here: start processes "
            "by 'spawn', or use backend 'warp'"
        )


class _Recording(threading.local):
    """What this thread records, or lists, instead of launching; None while it does not."""

    steps: list[Callable[[], Any]] | None = None
    kernels: list[Any] | None = None


_recording = _Recording()


def launch(kernel, *arguments) -> None:
    """Launch a kernel, or note the launch down while this thread records."""
    if _recording.kernels is not None:
        _recording.kernels.append(kernel)
        return
    step = partial(_launch, kernel, arguments)
    if _recording.steps is None:
        step()
    else:
        _recording.steps.append(step)


def clear(array) -> None:
    """Fill with zeros, or note that down while this thread records."""
    if _recording.kernels is None:
        launch(array.fill, 0)


def _launch(kernel, arguments) -> None:
    """Launch; kernels take whole arrays only, so that a part of one is copied, and back."""
    require_own_runtime()
    with LOCK:
        copies = {id(argument): read(argument) for argument in arguments if is_part(argument)}
        kernel(*(copies.get(id(argument), argument) for argument in arguments))
        for argument in arguments:
            if id(argument) in copies:
                write(argument, copies[id(argument)])


def record(run: Callable[[], None]) -> Callable[[], None]:
    """Note down what ``run`` launches, launching nothing; the result launches it all."""
    steps: list[Callable[[], Any]] = []
    _recording.steps = steps
    try:
        run()
    finally:
        _recording.steps = None

    def replay() -> None:
        for step in steps:
            step()

    return replay


def kernels_of(run: Callable[[], None]) -> list[Any]:
    """List the kernels that ``run`` launches, launching and compiling nothing."""
    _recording.kernels = kernels = []
    try:
        run()
    finally:
        _recording.kernels = None
    return kernels


def compile_kernel(kernel) -> None:
    """Compile a kernel, or load it from Taichi's cache, by launching it on empty arrays."""
    launch(
        kernel,
        *(_nothing(parameter.annotation) for parameter in inspect.signature(kernel).parameters.values()),
    )


def _nothing(annotation):
    if not hasattr(annotation, "ndim"):
        return 1  # what kernels divide by is among them
    (dtype,) = (ours for ours, theirs in DTYPES.items() if theirs == annotation.dtype)
    return np.empty((0,) * annotation.ndim, dtype)
