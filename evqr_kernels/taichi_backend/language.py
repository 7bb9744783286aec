"""The one place that imports Taichi, and the types that the kernel files share.

Taichi is ``taichi``, or its maintained fork ``quadrants`` where ``taichi`` is not installed or the
environment variable EVQR_TAICHI is "quadrants".  Both compile the same kernels.
"""

import importlib
import importlib.util
import os
import warnings
from contextlib import contextmanager

import numpy as np

from evqr_kernels.operation import Variant
from evqr_kernels.operations import OPERATIONS


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
    # neither its greeting, nor what it says of a standard output that is not the terminal's, nor its own uses
    # of what Python deprecates are for our users
    with (
        environment(
            ENABLE_TAICHI_HEADER_PRINT="0",
            ENABLE_QUADRANTS_HEADER_PRINT="0",
            TI_ENABLE_PYBUF="0",
            QD_ENABLE_PYBUF="0",
        ),
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", category=DeprecationWarning, module=rf"{asked}\.")
        return importlib.import_module(asked)


ti = _import_taichi()


DTYPES = {
    np.dtype(np.float32): ti.f32,
    np.dtype(np.float64): ti.f64,
    np.dtype(np.int32): ti.i32,
    np.dtype(np.uint16): ti.u16,
    np.dtype(np.uint32): ti.u32,
}
"""Taichi's types of elements by NumPy's."""


def array(dtype, axes: int):
    """Give the type of a kernel's array argument: NumPy's on the CPU, Taichi's elsewhere."""
    return ti.types.ndarray(dtype, axes)


def float_of(array):
    """Give the Taichi type of a float array's elements."""
    return ti.f64 if str(array.dtype) in ("float64", "f64") else ti.f32


def is_on_cpu(array) -> bool:
    """Whether an array that is not empty lies in the host's memory."""
    return isinstance(array, np.ndarray)


def is_alone(array) -> bool:
    """Whether an array on the CPU holds one window: a kernel with one thread a window then wakes no other."""
    return is_on_cpu(array) and array.shape[0] == 1


LEAST_INDICES = 512
"""Indices of a loop that Taichi gives one thread of a CPU, at least, however much work each is."""


def indices_of_window(alone: bool) -> int:
    """Choose how many indices of a loop a window has; all but the first are idle.

    A loop with one index a window would do hundreds of windows on one thread.
    """
    return 1 if alone else LEAST_INDICES


LONGEST_RUN = 64
"""Neighbours in memory that a kernel takes together, at most."""


@ti.func
def row_of(array: ti.template(), b, y):
    """Give where a row of an array of three axes starts in its memory."""
    return (b * array.shape[1] + y) * array.shape[2]


@ti.func
def row_of_plane(array: ti.template(), b, plane, y):
    """Give where a row of an array of four axes starts in its memory."""
    return ((b * array.shape[1] + plane) * array.shape[2] + y) * array.shape[3]


@ti.func
def run_at(at):
    """Give an index in an array's memory at which a run of neighbours starts.

    ``array[0, 0, at + p]`` is what lies there, since Taichi turns indices into one, of 32 bits.  The compiler
    takes neighbours into a vector where it knows that ``at + p`` does not wrap around, which the bound tells.
    No index reaches it.  This is what makes Taichi's kernels on a CPU four to eight times as fast.
    """
    return ti.min(at, (1 << 31) - 1 - LONGEST_RUN)


def variant(op: str, on_cpu: bool, width: int = LEAST_INDICES) -> Variant:
    """Choose what an operation's kernels are built for, by device and width."""
    return OPERATIONS[op].variant("taichi", "cpu" if on_cpu else "gpu", width=width)
