"""What a backend is: unchecked launchers that write into buffers which the caller owns; the hot path.

``evqr_kernels.ops`` is the other door, which checks and may allocate.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from evqr_kernels.operations import OPERATIONS

Array = Any
"""An array of the backend's own kind: NumPy's, Warp's, ..."""

Calls = Iterable[tuple[str, Mapping[str, Any]]]
"""Operations, each with those of its sizes and settings that its kernels are built for."""


class KernelBackend(Protocol):
    """What every backend offers: what is below, and for each operation a launcher of its name.

    A launcher takes the arguments that the table has, `evqr_kernels.operations.OPERATIONS`, in that order:
    inputs and settings first, then scratch and outputs, whose names end in ``_out`` or, of one that the
    operation begins with, ``_inout``.  Shapes and units are those of the functions in `evqr_kernels.ops`.
    Scratch holds partial sums, so that no result depends on the order of threads; `evqr_kernels.make_scratch`
    makes it.  Launchers check, allocate and wait for nothing.

    Attributes
    ----------
    name : str
        What `get_backend` knows it by.
    """

    name: str

    def __getattr__(self, op: str) -> Callable[..., None]:
        """Give the launcher of an operation.

        Parameters
        ----------
        op : str
            Name of the operation.

        Returns
        -------
        launcher : callable
            Takes the arguments that the table has.

        Raises
        ------
        AttributeError
            If there is no such operation.
        """
        ...

    def devices(self) -> tuple[str, ...]:
        """Name the devices that this machine has.

        Returns
        -------
        devices : tuple of str
            "cpu" first, "cuda:0", ...
        """
        ...

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike, device: str) -> Array:
        """Make an array with undefined contents.

        Parameters
        ----------
        shape : tuple of int
            Its shape.
        dtype : dtype
            float32, float64, int32, uint16 or uint32.
        device : str
            Where.

        Returns
        -------
        array : array
            Of the backend's kind.

        Raises
        ------
        ValueError
            If the backend does not have the device.
        """
        ...

    def from_host(self, array: NDArray[Any], device: str) -> Array:
        """Bring a NumPy array to the device; on the CPU it is the same memory.

        Parameters
        ----------
        array : NDArray
            C-contiguous; float32, float64, int32, uint16 or uint32.
        device : str
            Where.

        Returns
        -------
        array : array
            Of the backend's kind.

        Raises
        ------
        ValueError
            If the array is not contiguous, or the backend does not have the device.
        """
        ...

    def to_host(self, array: Array) -> NDArray[Any]:
        """Bring an array back; on the CPU it is the same memory.  Waits for the device.

        Parameters
        ----------
        array : array
            Of the backend's kind.

        Returns
        -------
        array : NDArray
            On the host.
        """
        ...

    def assign(self, array: Array, values: NDArray[Any]) -> None:
        """Copy a NumPy array into an array.

        Parameters
        ----------
        array : array
            Of the backend's kind; OVERWRITTEN.
        values : NDArray
            Of the same shape and dtype.
        """
        ...

    def part(self, block: Array, first: int, shape: tuple[int, ...], dtype: DTypeLike) -> Array:
        """View some words of a block as an array: many small arrays are then copied as one.

        Parameters
        ----------
        block : array
            (N,) uint32, of the backend's kind.
        first : int
            The word that it begins with.
        shape : tuple of int
            Of the array.
        dtype : dtype
            Of the array, as of `empty`.

        Returns
        -------
        array : array
            The same memory, of the backend's kind.
        """
        ...

    def clear(self, array: Array) -> None:
        """Fill an array with zeros.

        Parameters
        ----------
        array : array
            Of the backend's kind; OVERWRITTEN.
        """
        ...

    def record(self, run: Callable[[], None]) -> Callable[[], None]:
        """Note down what a function launches, launching nothing.

        Parameters
        ----------
        run : callable
            Made of this backend's launchers and `clear`.

        Returns
        -------
        replay : callable
            Launches it all on the same arrays, as often as it is called, with little to do between launches.
            Several threads may record and replay at once.  Keep it for as long as a graph lives that it was
            captured in.
        """
        ...

    def synchronize(self, device: str) -> None:
        """Wait for everything launched on a device.

        Parameters
        ----------
        device : str
            Which.
        """
        ...

    def supports(self, op: str, dtype: DTypeLike, device: str) -> str | None:
        """Tell whether an operation can run.

        Parameters
        ----------
        op : str
            Name of the operation.
        dtype : dtype
            Of its floats.
        device : str
            Where.

        Returns
        -------
        reason : str or None
            Why not; None if it can.
        """
        ...

    def tile(self, op: str, device: str) -> int:
        """Give how much one thread of an operation takes together: shapes of scratch may depend on it.

        Parameters
        ----------
        op : str
            Name of the operation.
        device : str
            Where.

        Returns
        -------
        tile : int
            Neighbours in memory, events or samples.
        """
        ...

    def needs_compile(self, device: str, calls: Calls) -> bool:
        """Tell whether this machine's cache lacks kernels of some calls, so that `load` takes seconds.

        Parameters
        ----------
        device : str
            Where.
        calls : iterable of (str, mapping)
            As of `load`.

        Returns
        -------
        lacks : bool
            Whether something is to be compiled.

        Raises
        ------
        ValueError
            As `load`.
        """
        ...

    def load(self, device: str, calls: Calls) -> None:
        """Compile or load the kernels of some calls, in float32; call it before threads start.

        Parameters
        ----------
        device : str
            Where.
        calls : iterable of (str, mapping)
            Names of operations, each with those of its sizes and settings that its kernels are built for:
            letters of the table, and names.  What is left out is of some size, and one window.

        Raises
        ------
        ValueError
            If there is no such operation, or the backend does not have the device.
        """
        ...


def part_of(block: NDArray[Any], first: int, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """View some words of a block on the host as an array."""
    words = block[first : first + words_of(shape, dtype)]
    return words.view(dtype)[: math.prod(shape)].reshape(shape)


def words_of(shape: tuple[int, ...], dtype: DTypeLike) -> int:
    """Give how many words of 32 bits an array takes."""
    return -(-math.prod(shape) * np.dtype(dtype).itemsize // 4)


class Launchers:
    """Launchers from the files of a package that the table names, each imported when it is asked for.

    Parameters
    ----------
    package : str
        The backend's package.
    """

    def __init__(self, package: str) -> None:
        self._package = package

    def __getattr__(self, op: str) -> Callable[..., None]:
        """Give the launcher of an operation."""
        if op not in OPERATIONS:
            raise AttributeError(f"{type(self).__name__} has no {op!r}, which is no operation")
        file = OPERATIONS[op].file  # novm  (no file of Python 2)
        launcher = getattr(importlib.import_module(f"{self._package}.{file}"), op)
        setattr(self, op, launcher)
        return launcher


def refusal(op: str, dtype: DTypeLike, device: str, devices: tuple[str, ...]) -> str | None:
    """Say why an operation cannot run whatever the backend; None if it is not known to."""
    if op not in OPERATIONS:
        return f"no operation {op!r}"
    known = [np.dtype(floats).name for floats in OPERATIONS[op].floats]
    if np.dtype(dtype).name not in known:
        return f"dtype {np.dtype(dtype)} is neither {' nor '.join(known)}"
    return None if device in devices else f"no device {device!r}"
