"""The specification: every kernel in plain NumPy, float32 and float64, written to be read and not to be fast.

One file a concept, mirroring ``warp_backend``.  The other backends are tested against this one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from evqr_kernels.backend import Calls, Launchers, part_of, refusal
from evqr_kernels.checks import check_contiguous
from evqr_kernels.operations import OPERATIONS


class NumpyBackend(Launchers):
    """Plain NumPy on the CPU."""

    name = "numpy"

    def __init__(self) -> None:
        super().__init__(__name__)

    def devices(self) -> tuple[str, ...]:
        """Name the CPU, the only one."""
        return ("cpu",)

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike, device: str) -> NDArray[Any]:
        """Make an array with undefined contents."""
        return np.empty(shape, dtype)

    def from_host(self, array: NDArray[Any], device: str) -> NDArray[Any]:
        """Give the same memory."""
        check_contiguous("array", array.flags.c_contiguous)
        return array

    def to_host(self, array: NDArray[Any]) -> NDArray[Any]:
        """Give the same memory."""
        return array

    def assign(self, array: NDArray[Any], values: NDArray[Any]) -> None:
        """Copy an array into another."""
        array[...] = values

    def part(self, block: NDArray[Any], first: int, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """View some words of a block as an array."""
        return part_of(block, first, shape, dtype)

    def clear(self, array: NDArray[Any]) -> None:
        """Fill an array with zeros."""
        array.fill(0)

    def record(self, run: Callable[[], None]) -> Callable[[], None]:
        """Give the function itself."""
        return run

    def synchronize(self, device: str) -> None:
        """Do nothing: NumPy has finished when it returns."""

    def supports(self, op: str, dtype: DTypeLike, device: str) -> str | None:
        """None when the operation can run, otherwise the reason why not."""
        return refusal(op, dtype, device, self.devices())

    def tile(self, op: str, device: str) -> int:
        """Give that of any CPU: no result depends on it."""
        return OPERATIONS[op].variant(self.name, "cpu").tile

    def needs_compile(self, device: str, calls: Calls) -> bool:
        """Nothing to compile."""
        return False

    def load(self, device: str, calls: Calls) -> None:
        """Nothing to load."""


def load() -> NumpyBackend:
    """Make the backend; the registry calls it."""
    return NumpyBackend()
