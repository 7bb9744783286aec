"""What a checked function does around its operation: choose the backend, move arrays, bring results back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from evqr_kernels.backend import get_backend, require_device
from evqr_kernels.checks import ArrayChecks, check_size

CHUNK = 512
"""Samples that one thread adds up."""

EVENTS = 64
"""Events of a window that one thread adds up, or more where the window has more than most."""


def chunks_of_samples(samples: int) -> int:
    """Give how many threads a pose's samples are shared out among."""
    return max(1, -(-samples // CHUNK))


def chunks_of(events: int, windows: int) -> int:
    """Give how many threads a window's events are shared out among."""
    return max(1, -(-events // (EVENTS * max(windows, 1))))


class Launch:
    """One call: puts arrays on a device and brings the results back."""

    def __init__(self, op: str, checks: ArrayChecks, backend: str, device: str | None) -> None:
        self.backend = get_backend(backend)
        self.device = device or self.backend.devices()[0]
        self.dtype = checks.dtype or np.dtype(np.float32)
        require_device(self.backend, self.device)
        refusal = self.backend.supports(op, self.dtype, self.device)
        if refusal:
            raise NotImplementedError(f"{self.backend.name} refuses {op}: {refusal}")
        self.run = getattr(self.backend, op)
        self._results: list[tuple[NDArray[Any], Any]] = []

    def put(self, *arrays: NDArray[Any]) -> list[Any]:
        """Bring inputs to the device."""
        return [self.backend.from_host(array, self.device) for array in arrays]

    def scratch(self, *shape: int) -> Any:
        """Make a device array for partial sums."""
        check_size("scratch", shape)
        return self.backend.empty(shape, self.dtype, self.device)

    def result(self, out: NDArray[Any] | None, *shape: int, dtype: DTypeLike | None = None) -> Any:
        """Give the device array of a result: the contents of ``out``, which gets the result, or zeros."""
        check_size("result", shape)
        if out is not None and not out.flags.writeable:
            raise ValueError("out must be writable, it gets the result: give a copy of it, or no out")
        host = np.zeros(shape, dtype or self.dtype) if out is None else out
        on_device = self.backend.from_host(host, self.device)
        self._results.append((host, on_device))
        return on_device

    def results(self) -> list[NDArray[Any]]:
        """Wait, and give the results in the order in which they were asked for."""
        self.backend.synchronize(self.device)
        for host, on_device in self._results:
            back = self.backend.to_host(on_device)
            if not np.may_share_memory(host, back):
                np.copyto(host, back)
        return [host for host, _ in self._results]
