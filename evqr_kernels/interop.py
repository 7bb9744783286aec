"""Arrays without a copy: NumPy's, and of any library that speaks DLPack or one of the array interfaces.

The checked functions take them wherever they lie in the host's memory (`host_view`), and refuse what would
have to be copied, whoever made it.  For a backend's own methods `warp_view` gives Warp's view of an array,
on a GPU too.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from evqr_kernels.backend import Array
from evqr_kernels.checks import check_aligned, check_contiguous, check_dtype
from evqr_kernels.registry import get_backend

PROTOCOLS = ("__dlpack__", "__cuda_array_interface__", "__array_interface__")


def host_view(name: str, value: Any) -> Any:
    """Give NumPy's view of an array of any library; what is no array as it is.

    Parameters
    ----------
    name : str
        What a message calls it.
    value : object
        An array, or anything else.

    Returns
    -------
    view : NDArray or object
        Read-only where the library says so: one of JAX is, and with NumPy before 2.1 any that came through
        DLPack.

    Raises
    ------
    TypeError
        If the array is not in the host's memory, or does not give it away (one that takes part in automatic
        differentiation, say).
    ValueError
        If it is not contiguous, or not aligned: it would have to be copied.
    """
    if isinstance(value, np.generic) or not _speaks(value, *PROTOCOLS):
        return value
    if _speaks(value, "__cuda_array_interface__"):
        raise TypeError(
            f"{name} is not in the host's memory: give evqr_kernels.interop.warp_view to a backend"
        )
    if isinstance(value, np.ndarray):
        view = value
    else:
        with _as_type_error(name):
            view = np.from_dlpack(value) if _speaks(value, "__dlpack__") else np.asarray(value)
    check_contiguous(name, view.flags.c_contiguous)
    check_aligned(name, view.flags.aligned)
    return view


def warp_view(array: Any) -> Array:
    """Give Warp's view of an array, on the device where it is; for the methods of the Warp backend.

    Warp knows no read-only arrays: give the view of one, as those of JAX are, as an input only.

    Parameters
    ----------
    array : array
        float32, float64, int32, uint16 or uint32; speaks DLPack or one of the array interfaces.

    Returns
    -------
    view : array
        Warp's; keeps the array alive.

    Raises
    ------
    TypeError
        If it speaks none of them, is of another dtype or does not give its memory away.
    ValueError
        If it is not contiguous: it would have to be copied.
    """
    import warp as wp

    backend = get_backend("warp")

    if isinstance(array, np.ndarray) or not _speaks(array, *PROTOCOLS[:2]):
        host = host_view("array", array)
        if not isinstance(host, np.ndarray):
            raise TypeError(f"array must speak {' or '.join(PROTOCOLS)}, got {type(array).__name__}")
        check_dtype("array", host.dtype)
        return backend.from_host(host, "cpu")
    with _as_type_error("array"):
        view: Any = wp.from_dlpack(array) if _speaks(array, "__dlpack__") else wp.array(array, copy=False)
    check_dtype("array", wp.dtype_to_numpy(view.dtype))
    check_contiguous("array", view.is_contiguous)
    return view


@contextlib.contextmanager
def _as_type_error(name: str) -> Iterator[None]:
    """Raise TypeError for whatever a library says why it does not give an array's memory away."""
    try:
        yield
    except (BufferError, RuntimeError, TypeError, ValueError) as error:
        raise TypeError(f"{name} cannot be read without a copy: {error}") from error


def _speaks(value: Any, *protocols: str) -> bool:
    # not of the type: PyTorch's tensors have an interface for GPUs only if they are on one
    return any(hasattr(value, protocol) for protocol in protocols)
