"""Arrays on a GPU, with views as NumPy's arrays have them.

Taichi's kernels take whole arrays only, and its arrays on a GPU have no views: what is a part of one goes
through the host.  That is slow, and there for the few arrays that are parts of others.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr_kernels.taichi_backend.language import DTYPES, ti


class DeviceArray(ti.lang._ndarray.ScalarNdarray):
    """An array of Taichi's that has views."""

    def __getitem__(self, key) -> "View":
        """View what slices cut out of it."""
        return View(self, lambda array: array[key])

    def reshape(self, shape: tuple[int, ...]) -> "View":
        """View it in another shape."""
        return View(self, lambda array: array.reshape(shape))


class View:
    """What a function of NumPy arrays makes of an array on a GPU, or of a view: a view, for the host."""

    def __init__(self, whole: "DeviceArray | View", look: Callable[[NDArray[Any]], NDArray[Any]]) -> None:
        self.whole, self.look = whole, look
        kinds = (ours for ours, theirs in DTYPES.items() if whole.dtype in (ours, theirs))
        looked_at = look(np.empty(whole.shape, next(kinds)))
        self.shape, self.dtype = looked_at.shape, looked_at.dtype

    def __getitem__(self, key) -> "View":
        """View what slices cut out of it."""
        return View(self, lambda array: array[key])

    def reshape(self, shape: tuple[int, ...]) -> "View":
        """View it in another shape."""
        return View(self, lambda array: array.reshape(shape))

    def to_numpy(self) -> NDArray[Any]:
        """Bring it to the host."""
        return np.ascontiguousarray(self.look(self.whole.to_numpy()))

    def from_numpy(self, values: NDArray[Any]) -> None:
        """Write it from the host."""
        around = self.whole.to_numpy()
        self.look(around)[...] = values
        self.whole.from_numpy(around)

    def fill(self, value: float) -> None:
        """Fill it."""
        self.from_numpy(value)


def is_part(array) -> bool:
    """Whether an argument of a launch is a part of another array, and not all of its memory."""
    return isinstance(array, View) or (isinstance(array, np.ndarray) and not array.flags.c_contiguous)


def read(array) -> NDArray[Any]:
    """Give a copy on the host."""
    return array.copy() if isinstance(array, np.ndarray) else array.to_numpy()


def write(array, values: NDArray[Any]) -> None:
    """Copy values of the same shape into an array."""
    if isinstance(array, np.ndarray):
        array[...] = values
    else:
        array.from_numpy(np.ascontiguousarray(values))
