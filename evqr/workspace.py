"""Buffers that are made once and used for every window."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

if TYPE_CHECKING:
    from evqr_kernels.backend import KernelBackend


T = TypeVar("T")


class Workspace:
    """Device buffers of one thread, by name and shape."""

    def __init__(self, backend: KernelBackend, device: str) -> None:
        self.backend = backend
        self.device = device
        self._buffers: dict[tuple[Any, ...], Any] = {}
        self._tables: dict[tuple[Any, ...], Any] = {}

    def buffer(self, name: str, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Any:
        """Give a buffer with undefined contents, the same one each time."""
        key = (name, shape, np.dtype(dtype))
        if key not in self._buffers:
            if len(self._buffers) > 512:
                self._buffers.clear()
            self._buffers[key] = self.backend.empty(shape, dtype, self.device)
        return self._buffers[key]

    def table(self, key: tuple[Any, ...], array: NDArray[Any]) -> Any:
        """Give a constant table on the device, copied there when it is first asked for."""
        return self.once(key, lambda: self.backend.from_host(array, self.device))

    def once(self, key: tuple[Any, ...], make: Callable[[], T]) -> T:
        """Give whatever ``make`` gives, made when it is first asked for."""
        if key not in self._tables:
            self._tables[key] = make()
        return self._tables[key]

    def put(self, array: NDArray[Any]) -> Any:
        """Put an array of this window on the device."""
        return self.backend.from_host(array, self.device)

    def get(self, array: Any) -> NDArray[Any]:
        """Give a device array on the host."""
        return self.backend.to_host(array)

    def clear(self, array: Any) -> None:
        """Fill a device array with zeros."""
        self.backend.clear(array)
