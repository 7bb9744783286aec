"""The one place that imports Taichi, and what the kernel files share: array types, and launching.

Taichi is ``taichi``, or its maintained fork ``quadrants`` where ``taichi`` is not installed or the
environment variable EVQR_TAICHI is "quadrants".  Both compile the same kernels.
"""

import importlib
import importlib.util
import inspect
import os
import threading
import warnings
from collections.abc import Callable
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np


@contextmanager
def environment(**variables: str):
    """Set environment variables for a while."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _import_taichi():
    asked = os.environ.get("EVQR_TAICHI", "taichi")
    if asked not in ("taichi", "quadrants"):
        raise ImportError(f"EVQR_TAICHI must be taichi or quadrants, got {asked!r}")
    if asked == "taichi" and not importlib.util.find_spec("taichi") and importlib.util.find_spec("quadrants"):
        asked = "quadrants"
    # neither its greeting nor its own uses of what Python deprecates are for our users
    with (
        environment(ENABLE_TAICHI_HEADER_PRINT="0", ENABLE_QUADRANTS_HEADER_PRINT="0"),
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", category=DeprecationWarning, module=rf"{asked}\.")
        return importlib.import_module(asked)


ti = _import_taichi()

LOCK = threading.RLock()
"""Held while Taichi compiles, launches or copies: its front end has one state for all threads."""


def array(dtype, axes: int):
    """Give the type of a kernel's array argument: NumPy's on the CPU, Taichi's elsewhere."""
    return ti.types.ndarray(dtype, axes)


def float_of(array):
    """Give the Taichi type of a float array's elements."""
    return ti.f64 if str(array.dtype) in ("float64", "f64") else ti.f32


def is_on_cpu(array) -> bool:
    """Whether an array that is not empty lies in the host's memory."""
    return isinstance(array, np.ndarray)


class _Recording(threading.local):
    """What this thread records instead of launching; None while it does not."""

    steps: list[Callable[[], Any]] | None = None


_recording = _Recording()


def launch(kernel, *arguments) -> None:
    """Launch a kernel, or note the launch down while this thread records.

    Kernels that have one thread a window take ``alone``, where there is one window: on the CPU it then runs
    in the calling thread, which wakes no other.
    """
    step = partial(_launch, kernel, arguments)
    if _recording.steps is None:
        step()
    else:
        _recording.steps.append(step)


def _launch(kernel, arguments) -> None:
    """Launch; it takes whole arrays only, so that one cut out of another is copied, and back."""
    cut = [a for a in arguments if isinstance(a, np.ndarray) and not a.flags.c_contiguous]
    copies = {id(array): array.copy() for array in cut}
    with LOCK:
        kernel(*(copies.get(id(argument), argument) for argument in arguments))
    for array in cut:
        array[...] = copies[id(array)]


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


def compile_kernel(kernel) -> None:
    """Compile a kernel, or load it from Taichi's cache, by launching it on empty arrays."""
    launch(
        kernel,
        *(_nothing(parameter.annotation) for parameter in inspect.signature(kernel).parameters.values()),
    )


def _nothing(annotation):
    if not hasattr(annotation, "ndim"):
        return 1  # what kernels divide by is among them
    return np.empty(
        (0,) * annotation.ndim, {ti.f32: np.float32, ti.f64: np.float64, ti.i32: np.int32}[annotation.dtype]
    )
