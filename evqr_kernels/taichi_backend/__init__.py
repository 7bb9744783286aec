"""The Taichi backend: buffers, devices and dispatch; the mathematics is in the files beside this one.

One file a concept, mirroring ``warp_backend``.  On the CPU an array is a NumPy array: Taichi's kernels take
its memory as it is.  A launch there runs on all cores and holds the GIL, so that Python threads take turns.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from evqr_kernels.backend import Calls, Launchers, part_of, refusal
from evqr_kernels.call import example
from evqr_kernels.checks import check_contiguous
from evqr_kernels.taichi_backend import runtime
from evqr_kernels.taichi_backend.arrays import DeviceArray, View, write
from evqr_kernels.taichi_backend.language import DTYPES, ti, variant
from evqr_kernels.taichi_backend.launches import LOCK, clear, compile_kernel, kernels_of, record


class TaichiBackend(Launchers):
    """Kernels written in Taichi, for CPUs, NVIDIA GPUs and whatever runs Vulkan or Metal."""

    name = "taichi"

    def __init__(self) -> None:
        super().__init__(__name__)
        self._loaded: dict[Any, None] = {}  # kernels

    def devices(self) -> tuple[str, ...]:
        """Names of the devices that can be asked for: once Taichi runs, the one where it runs."""
        running = runtime.running_on()
        return runtime.devices() if running is None else (running,)

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike, device: str) -> Any:
        """Make an array with undefined contents."""
        runtime.require(device)
        if math.prod(shape) > np.iinfo(np.int32).max:
            raise ValueError(f"an array of Taichi's must have fewer than 2^31 elements, got shape {shape}")
        if device == "cpu" or 0 in shape:  # Taichi has no empty arrays of its own
            return np.empty(shape, dtype)
        with LOCK:
            return DeviceArray(DTYPES[np.dtype(dtype)], shape)

    def from_host(self, array: NDArray[Any], device: str) -> Any:
        """Bring a NumPy array to the device; on the CPU it is the same memory."""
        check_contiguous("array", array.flags.c_contiguous)
        if device == "cpu" or array.size == 0:
            runtime.require(device)
            return array
        there = self.empty(array.shape, array.dtype, device)
        self.assign(there, array)
        return there

    def to_host(self, array: Any) -> NDArray[Any]:
        """Bring an array back; on the CPU it is the same memory.  Waits for the device."""
        if isinstance(array, np.ndarray):
            return array
        with LOCK:
            return array.to_numpy()

    def assign(self, array: Any, values: NDArray[Any]) -> None:
        """Copy a NumPy array of the same shape and dtype into an array."""
        with LOCK:
            write(array, values)

    def part(self, block: Any, first: int, shape: tuple[int, ...], dtype: DTypeLike) -> Any:
        """View some words of a block as an array; on a GPU it goes through the host in each launch."""
        if isinstance(block, np.ndarray):
            return part_of(block, first, shape, dtype)
        return View(block, lambda words: part_of(words, first, shape, dtype))

    def clear(self, array: Any) -> None:
        """Fill an array with zeros."""
        clear(array)

    def record(self, run: Callable[[], None]) -> Callable[[], None]:
        """Note down what ``run`` launches; the result launches it again."""
        return record(run)

    def synchronize(self, device: str) -> None:
        """Wait for everything launched on the device."""
        runtime.require(device)
        with LOCK:
            ti.sync()

    def supports(self, op: str, dtype: DTypeLike, device: str) -> str | None:
        """None when the operation can run, otherwise the reason why not."""
        reason = refusal(op, dtype, device, self.devices())
        if reason:
            return reason
        if np.dtype(dtype) == np.float64 and not runtime.has_float64(device):
            return (
                f"{device} computes in float32 only, not in float64: give float32 arrays, or another device"
            )
        return None

    def tile(self, op: str, device: str) -> int:
        """How much one thread of an operation takes together there."""
        return variant(op, device == "cpu").tile

    def needs_compile(self, device: str, calls: Calls) -> bool:
        """Whether `load` is still to be called, which takes a second even from Taichi's own cache."""
        return any(kernel not in self._loaded for kernel in self._kernels(device, calls))

    def load(self, device: str, calls: Calls) -> None:
        """Compile or load the kernels of these calls (float32); call it before threads start."""
        with LOCK:
            for kernel in self._kernels(device, calls):
                if kernel not in self._loaded:
                    compile_kernel(kernel)
                    self._loaded[kernel] = None

    def cache_dir(self) -> str:
        """Where compiled kernels are kept."""
        return runtime.cache_dir()

    def _kernels(self, device: str, calls: Calls) -> list[Any]:
        """List what calls launch."""
        runtime.require(device)
        return [kernel for op, given in calls for kernel in kernels_of(example(self, device, op, given))]


def load() -> TaichiBackend:
    """Make the backend; the registry calls it."""
    return TaichiBackend()
