"""Arrays of other libraries, without a copy: whatever speaks DLPack or one of the array interfaces.

The checked functions take such arrays wherever they take NumPy's, as long as they lie in the host's memory
(`any_arrays`).  For a backend's own methods `warp_view` gives Warp's view of an array, on a GPU too.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import numpy as np

from evqr_kernels.backend import Array, get_backend

P = ParamSpec("P")
R = TypeVar("R")

PROTOCOLS = ("__dlpack__", "__cuda_array_interface__", "__array_interface__")


def any_arrays(function: Callable[P, R]) -> Callable[P, R]:
    """Let a checked function take arrays of other libraries; it sees NumPy's views of them."""
    names = list(inspect.signature(function).parameters)
    call: Callable[..., R] = function

    @functools.wraps(function)
    def with_views(*args: P.args, **kwargs: P.kwargs) -> R:
        positional = [host_view(name, value) for name, value in zip(names, args, strict=False)]
        positional += args[len(names) :]  # too many: Python says so
        named = {name: host_view(name, value) for name, value in kwargs.items()}
        return call(*positional, **named)

    return with_views


def host_view(name: str, value: Any) -> Any:
    """Give NumPy's view of an array of another library; anything else as it is.

    Raises
    ------
    TypeError
        If the array is not in the host's memory, or does not give it away (one that takes part in automatic
        differentiation, say).
    ValueError
        If it is not contiguous: it would have to be copied.
    """
    if isinstance(value, np.ndarray | np.generic) or not _speaks(value, *PROTOCOLS):
        return value
    if _speaks(value, "__cuda_array_interface__"):
        raise TypeError(
            f"{name} is not in the host's memory: give evqr_kernels.interop.warp_view to a backend"
        )
    try:
        view = np.from_dlpack(value) if _speaks(value, "__dlpack__") else np.asarray(value)
    except (BufferError, RuntimeError, TypeError, ValueError) as error:
        raise TypeError(f"{name} cannot be read without a copy: {error}") from error
    if not view.flags.c_contiguous:
        raise ValueError(f"{name} must be contiguous: an array of another library is not copied")
    return view


def warp_view(array: Any) -> Array:
    """Give Warp's view of an array, on the device where it is; for the methods of the Warp backend.

    Parameters
    ----------
    array   float32, float64 or int32; speaks DLPack or one of the array interfaces

    Raises
    ------
    TypeError
        If it speaks none of them.
    ValueError
        If it is not contiguous: it would have to be copied.
    """
    import warp as wp

    backend = get_backend("warp")

    if isinstance(array, np.ndarray) or not _speaks(array, *PROTOCOLS[:2]):
        host = host_view("array", array)
        if not isinstance(host, np.ndarray):
            raise TypeError(f"array must speak {' or '.join(PROTOCOLS)}, got {type(array).__name__}")
        if not host.flags.c_contiguous:
            raise ValueError("array must be contiguous: it is not copied")
        return backend.from_host(host, "cpu")
    view: Any = wp.from_dlpack(array) if _speaks(array, "__dlpack__") else wp.array(array, copy=False)
    if not view.is_contiguous:
        raise ValueError("array must be contiguous: it is not copied")
    return view


def _speaks(value: Any, *protocols: str) -> bool:
    # not of the type: PyTorch's tensors have an interface for GPUs only if they are on one
    return any(hasattr(value, protocol) for protocol in protocols)
