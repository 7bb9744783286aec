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


DTYPES = {np.dtype(np.float32): ti.f32, np.dtype(np.float64): ti.f64, np.dtype(np.int32): ti.i32}
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
