"""Every check of an array, in one message format: ``affine must have shape (B, 6), got (4, 5)``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

Floats = NDArray[np.floating[Any]]
Ints = NDArray[np.int32]
Pixels = NDArray[np.uint16]
Stamps = NDArray[np.uint32]

Extent = str | int
"""A size that is given, or a letter that stands for the same size in every array of a call."""


DTYPES = tuple(map(np.dtype, (np.float32, np.float64, np.int32, np.uint16, np.uint32)))
"""Of all arrays."""

MOST_ELEMENTS = 2**31 - 1
"""Of an array: indices are 32 bits wide."""

MOST_EVENTS = 2**30
"""Of a call: kernels add a window's first event to the number of one within it."""


MOST_COUNTED = 2**24
"""To which float32 counts by one."""


def check_size(name: str, shape: tuple[int, ...]) -> None:
    """Raise ValueError for an array with more elements than an index can tell apart, or a size below 0."""
    if any(size < 0 for size in shape):
        raise ValueError(f"{name} must have no negative size, got {shape}")
    if math.prod(shape) > MOST_ELEMENTS:
        raise ValueError(
            f"{name} must have fewer than {MOST_ELEMENTS + 1} elements, got {math.prod(shape)}: cut the batch"
        )


def check_contiguous(name: str, contiguous: bool) -> None:
    """Raise ValueError for an array that is not C-contiguous: it would have to be copied."""
    if not contiguous:
        raise ValueError(f"{name} must be contiguous, it is not copied: give np.ascontiguousarray({name})")


def check_aligned(name: str, aligned: bool) -> None:
    """Raise ValueError for an array whose elements lie where a processor does not expect them."""
    if not aligned:
        raise ValueError(f"{name} must be aligned in memory, it is not copied: give {name}.copy()")


def check_dtype(name: str, dtype: DTypeLike) -> None:
    """Raise TypeError for a dtype that no kernel works on."""
    if np.dtype(dtype) not in DTYPES:
        raise TypeError(f"{name} must be float32, float64, int32, uint16 or uint32, got {np.dtype(dtype)}")


def check_counts(window_ptr: Ints, images: Sequence[NDArray[Any]]) -> None:
    """Raise ValueError for sums of so many events that float32 no longer tells one more."""
    ends = window_ptr[:, 1] - window_ptr[:, 0] if window_ptr.ndim == 2 else np.diff(window_ptr)
    if ends.max(initial=0) < MOST_COUNTED:
        return
    for image in images:
        if image.dtype == np.float32 and np.abs(image).max(initial=0.0) >= MOST_COUNTED:
            raise ValueError(
                f"images in float32 count to {MOST_COUNTED}, and a window of {ends.max()} events got there: "
                "give float64 arrays, or shorter windows"
            )


def check_apart(name: str, array: NDArray[Any], others: Mapping[str, Any]) -> None:
    """Raise ValueError if an array that is written shares memory with one that is read."""
    for other, value in others.items():
        if isinstance(value, np.ndarray) and np.may_share_memory(array, value):
            raise ValueError(
                f"{name} must not share memory with {other}, which is read meanwhile: give another array"
            )


class ArrayChecks:
    """Checks of one call's arrays against each other: letters bind to the first size, floats to a dtype."""

    def __init__(self, sizes: Mapping[str, int] | None = None) -> None:
        self.sizes: dict[str, int] = dict(sizes or {})
        self.dtype: np.dtype[Any] | None = None

    def floats(self, name: str, array: Any, *shape: Extent) -> None:
        """Raise unless ``array`` is float32 or float64, as those before it, and has the shape."""
        self._numpy(name, array)
        if array.dtype not in (np.dtype(np.float32), np.dtype(np.float64)):
            raise TypeError(f"{name} must be float32 or float64, got {array.dtype}")
        if self.dtype is None:
            self.dtype = array.dtype
        if array.dtype != self.dtype:
            raise TypeError(f"{name} must be {self.dtype} like the arrays before it, got {array.dtype}")
        self._shape(name, array, shape)

    def parameters(self, name: str, array: Any, counts: tuple[int, ...], letter: Extent) -> None:
        """Raise unless ``array`` is of floats, with one of the counts of parameters for each window."""
        self._numpy(name, array)
        count = array.shape[-1] if array.ndim else 0
        if len(counts) > 1 and count not in counts:
            wanted = " or ".join(f"(B, {count})" for count in counts)
            raise ValueError(f"{name} must have shape {wanted}, got {array.shape}")
        self.sizes[str(letter)] = count if count in counts else min(counts)
        self.floats(name, array, "B", self.sizes[str(letter)])

    def ints(self, name: str, array: Any, *shape: Extent, dtype: DTypeLike = np.int32) -> None:
        """Raise unless ``array`` is of these integers and has the shape."""
        self._numpy(name, array)
        if array.dtype != np.dtype(dtype):
            wanted = np.dtype(dtype)
            remedy = f": give {name}.astype('{wanted}')" if array.dtype.kind in "iu" else ""
            raise TypeError(f"{name} must be {wanted}, got {array.dtype}{remedy}")
        self._shape(name, array, shape)

    def windows(self, window_ptr: Any) -> None:
        """Raise unless ``window_ptr`` can cut E events into B windows; E must be bound."""
        self.ints("window_ptr", window_ptr, "B + 1")
        self.sizes["B"] = len(window_ptr) - 1
        if self.sizes["B"] < (1 if self.sizes["E"] else 0):
            raise ValueError(
                f"window_ptr must have shape (B + 1,), got {window_ptr.shape} for {self.sizes['E']} events"
            )

    def window_values(self, array: Ints) -> None:
        """Raise unless ``array``, of a shape that fits, cuts E events into B windows."""
        if array[0] != 0 or array[-1] != self.sizes["E"]:
            raise ValueError(f"window_ptr must go from 0 to {self.sizes['E']}, got {array[0]} to {array[-1]}")
        if len(array) > 2 and (array[1:] < array[:-1]).any():
            first = int(np.argmax(np.diff(array) < 0)) + 1
            raise ValueError(f"window_ptr must not decrease, got {array[first]} after {array[first - 1]}")

    def choice(self, name: str, array: Ints, count: int) -> None:
        """Raise if ``array`` has indices, of none of ``count`` things."""
        if len(array) and not count:
            raise ValueError(
                f"{name} must have shape (0,) where there is nothing to choose from, got {array.shape}"
            )

    def index(self, name: str, array: Ints, count: int) -> None:
        """Raise unless every entry is the index of one of ``count`` things."""
        if len(array) and not (0 <= array.min() and array.max() < count):
            raise ValueError(f"{name} must be 0 to {count - 1}, got {array.min()} to {array.max()}")

    def ranges(self, name: str, array: Ints, count: int) -> None:
        """Raise unless every row is the first of ``count`` things and the one behind the last."""
        if len(array) and not (0 <= array.min() and array.max() <= count):
            raise ValueError(f"{name} must be 0 to {count}, got {array.min()} to {array.max()}")
        if (array[:, 0] > array[:, 1]).any():
            first, last = array[int(np.argmax(array[:, 0] > array[:, 1]))]
            raise ValueError(f"{name} must not end before it begins, got {first} to {last}")

    def at_most(self, name: str, array: Ints, most: Sequence[int]) -> None:
        """Raise unless every row is 0 to the numbers of ``most``."""
        for column, bound in zip(array.T, most, strict=True):
            if len(column) and not (0 <= column.min() and column.max() <= bound):
                raise ValueError(
                    f"{name} must be 0 to {tuple(most)}, got {column.min()} to {column.max()} for {bound}"
                )

    def at_least(self, name: str, value: float, least: float) -> None:
        """Raise unless ``value`` is a number of at least ``least``."""
        if not value >= least:
            raise ValueError(f"{name} must be at least {least}, got {value}")

    def _numpy(self, name: str, array: Any) -> None:
        if not isinstance(array, np.ndarray):
            raise TypeError(f"{name} must be a NumPy array, got {type(array).__name__}")

    def _shape(self, name: str, array: Any, shape: tuple[Extent, ...]) -> None:
        check_size(name, array.shape)
        if shape == ("E",) and len(array) > MOST_EVENTS:
            raise ValueError(
                f"{name} must have at most {MOST_EVENTS} events, got {len(array)}: cut the batch"
            )
        want = "(" + ", ".join(map(str, shape)) + (",)" if len(shape) == 1 else ")")
        if array.ndim != len(shape):
            raise ValueError(f"{name} must have shape {want}, got {array.shape}")
        for extent, size in zip(shape, array.shape, strict=True):
            expected = extent if isinstance(extent, int) else self.sizes.setdefault(extent, size)
            if size != expected:
                known = {e: self.sizes[e] for e in shape if isinstance(e, str) and e in self.sizes}
                where = " with " + ", ".join(f"{e} = {n}" for e, n in known.items()) if known else ""
                raise ValueError(f"{name} must have shape {want}{where}, got {array.shape}")
