"""The Warp backend: buffers, devices and dispatch; the mathematics is in the files beside this one.

A launch on the CPU is one plain loop on the calling thread with the GIL released, so disjoint windows run on
as many Python threads as the caller likes (call `WarpBackend.load` before they start).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import DTypeLike, NDArray

from evqr_kernels.backend import Calls, Launchers, refusal
from evqr_kernels.call import example
from evqr_kernels.checks import check_contiguous
from evqr_kernels.registry import require_device
from evqr_kernels.warp_backend import cache, replay
from evqr_kernels.warp_backend.cache import is_compiled
from evqr_kernels.warp_backend.graph import turn_on
from evqr_kernels.warp_backend.language import clear, kernels_of, record, variant

_DTYPES = {
    np.dtype(dtype.__name__): dtype for dtype in (wp.float32, wp.float64, wp.int32, wp.uint16, wp.uint32)
}


class WarpBackend(Launchers):
    """Kernels written in NVIDIA Warp, for CPUs and NVIDIA GPUs."""

    name = "warp"

    def __init__(self) -> None:
        super().__init__(__name__)
        cache.start()
        self._cpu = wp.get_device("cpu")
        self._names = tuple(device.alias for device in wp.get_devices())
        self._modules_of: dict[Any, list[wp.Module]] = {}

    def devices(self) -> tuple[str, ...]:
        """Names of the devices that this machine has; "cpu" first."""
        return self._names

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike, device: str) -> wp.array:
        """Make an array with undefined contents."""
        require_device(self, device)
        with turn_on(device == "cpu"):
            return wp.empty(shape, dtype=_DTYPES[np.dtype(dtype)], device=device)

    def from_host(self, array: NDArray[Any], device: str) -> wp.array:
        """Bring a NumPy array to the device; on the CPU it is the same memory."""
        require_device(self, device)
        check_contiguous("array", array.flags.c_contiguous)
        if device != "cpu":
            with turn_on(False):
                return wp.array(array, dtype=_DTYPES[array.dtype], device=device)
        # half the time that Warp takes to look the array over, some fifty times a window
        address = array.__array_interface__["data"][0]
        wrapped = wp.array(ptr=address, dtype=_DTYPES[array.dtype], shape=array.shape, device=self._cpu)
        wrapped._ref = array  # keeps the memory for as long as the wrapper lives, as Warp does
        return wrapped

    def to_host(self, array: wp.array) -> NDArray[Any]:
        """Bring an array back; on the CPU it is the same memory.  Waits for the device."""
        with turn_on(array.device.is_cpu):
            return array.numpy()

    def assign(self, array: wp.array, values: NDArray[Any]) -> None:
        """Copy a NumPy array of the same shape and dtype into an array."""
        with turn_on(array.device.is_cpu):
            array.assign(values)

    def part(self, block: wp.array, first: int, shape: tuple[int, ...], dtype: DTypeLike) -> wp.array:
        """View some words of a block as an array."""
        kind = _DTYPES[np.dtype(dtype)]
        part = wp.array(ptr=block.ptr + 4 * first, dtype=kind, shape=shape, device=block.device)
        part._ref = block  # keeps the memory for as long as the view lives
        return part

    def clear(self, array: wp.array) -> None:
        """Fill an array with zeros."""
        clear(array)

    def record(self, run: Callable[[], None]) -> Callable[[], None]:
        """Note down what ``run`` launches; the result launches it again at a fraction of the cost."""
        return record(run)

    def synchronize(self, device: str) -> None:
        """Wait for everything launched on the device."""
        wp.synchronize_device(device)

    def supports(self, op: str, dtype: DTypeLike, device: str) -> str | None:
        """None when the operation can run, otherwise the reason why not."""
        return refusal(op, dtype, device, self.devices())

    def tile(self, op: str, device: str) -> int:
        """How much one thread of an operation takes together there."""
        return variant(op, wp.get_device(device)).tile

    def needs_compile(self, device: str, calls: Calls) -> bool:
        """Whether this machine's cache lacks kernels of these calls, so that `load` takes seconds."""
        require_device(self, device)
        return not all(is_compiled(module, device) for module in self._modules(device, calls))

    def load(self, device: str, calls: Calls) -> None:
        """Compile or load the kernels of these calls (float32); call it before threads start."""
        require_device(self, device)
        for module in self._modules(device, calls):
            cache.load_module(module, device)

    def cache_dir(self) -> str:
        """Where compiled kernels are kept."""
        return cache.directory()

    def _modules(self, device: str, calls: Calls) -> list[wp.Module]:
        """List the Warp modules of what calls launch, recorded or not; every solver asks for the same."""
        calls = [(op, dict(given)) for op, given in calls]
        key = device, *((op, *sorted(given.items())) for op, given in calls)
        if key not in self._modules_of:
            kernels = [
                kernel for op, given in calls for kernel in kernels_of(example(self, device, op, given))
            ]
            if kernels and device == "cpu":
                kernels.append(replay.run_sequence)
            self._modules_of[key] = list(dict.fromkeys(kernel.module for kernel in kernels))
        return self._modules_of[key]


def load() -> WarpBackend:
    """Make the backend; the registry calls it."""
    return WarpBackend()
