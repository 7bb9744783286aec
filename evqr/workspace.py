"""Device arrays that are made once and used for every window, with the launches that work on them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from evqr_kernels import make_scratch

if TYPE_CHECKING:
    from evqr.events.window import Window
    from evqr_kernels.backend import KernelBackend


T = TypeVar("T")

MOST_KEPT = 384
"""Things that a workspace keeps at once.  Codes differ in size from recording to recording, and each size of
region has its own."""

MOST_KEPT_WITH_ONE = 48
"""Things that are kept at once with one of those, as they work on its buffers."""

FEWEST_EVENTS = 1 << 14
"""Room for events grows from this in powers of two, so that launches recorded for it are used again."""

MOST_ROOM = 16
"""A window may lie in room for so many times its events: threads without events cost little."""


class Mirror:
    """A device array and its copy on the host: the same memory where the device is the CPU."""

    def __init__(self, backend: KernelBackend, shape: tuple[int, ...], dtype: DTypeLike, device: str) -> None:
        self.host: NDArray[Any] = np.zeros(shape, dtype)
        self.device = backend.from_host(self.host, device)
        self._backend = backend
        self._shared = np.shares_memory(self.host, backend.to_host(self.device))

    def write(self, values: ArrayLike) -> None:
        """Set the array."""
        self.host[...] = values
        self.push()

    def push(self) -> None:
        """Bring to the device what was written to the host's copy."""
        if not self._shared:
            self._backend.assign(self.device, self.host)

    def read(self) -> NDArray[Any]:
        """Wait for the device and give the host's copy, which later reads overwrite."""
        if not self._shared:
            self.host[...] = self._backend.to_host(self.device)
        return self.host


class Keeper:
    """Keeps what is made once and used for every window; what was not used for longest goes first.

    What works on somebody's buffers is kept with it, and so goes when it goes.
    """

    most_kept = MOST_KEPT_WITH_ONE

    @cached_property
    def _kept(self) -> OrderedDict[Any, Any]:
        return OrderedDict()

    def once(self, key: Any, make: Callable[[], T]) -> T:
        """Give whatever ``make`` gives, made when it is first asked for."""
        kept = self._kept
        try:
            kept.move_to_end(key)
        except KeyError:
            kept[key] = make()
            if len(kept) > self.most_kept:
                kept.popitem(last=False)
        return kept[key]


class Images(Keeper):
    """Images (N, Y, X) on the device.

    Attributes
    ----------
    device : (N, Y, X) float32, on the device
        Their buffer, which the step that makes them fills again for every window.
    """

    def __init__(self, device: Any) -> None:
        self.device = device


class Step(Keeper):
    """Launches on arrays of its own: alone, or as a part of a larger step."""

    def __init__(self, backend: KernelBackend) -> None:
        self._backend = backend

    def launch(self) -> None:
        """Launch the kernels one by one."""
        raise NotImplementedError

    @cached_property
    def run(self) -> Callable[[], None]:
        """Launches all of it, recorded when it is first asked for."""
        return self._backend.record(self.launch)


class EventSlots:
    """Room for the events of one window."""

    def __init__(self, workspace: Workspace, capacity: int) -> None:
        self.capacity = capacity
        self._mirrors = [workspace.mirror((capacity,)) for _ in range(4)]
        self.x, self.y, self.p, self.t = (mirror.device for mirror in self._mirrors)
        self._window: Window | None = None
        self._timed: Window | None = None

    def holds(self, window: Window) -> bool:
        """Whether the events of a window are there, alone or the first of more."""
        held = self._window
        if held is None or window is held:
            return window is held
        fits = len(window) <= len(held) and self.capacity <= max(FEWEST_EVENTS, MOST_ROOM * len(window))
        return fits and window.begins_like(held)

    def load(self, window: Window) -> None:
        """Put the events of a window there."""
        self._window, self._timed = window, None
        columns = window.events.x, window.events.y, window.events.p
        for mirror, values in zip(self._mirrors, columns, strict=False):
            mirror.host[: len(window)] = values
            mirror.push()

    def load_times(self, window: Window) -> None:
        """Put the times of a window there, relative to its middle [us]."""
        if window is not self._timed:
            window.write_times(self._mirrors[-1].host[: len(window)])
            self._mirrors[-1].push()
            self._timed = window


class Workspace(Keeper):
    """Device arrays and recorded launches of one thread, each made when it is first asked for."""

    most_kept = MOST_KEPT

    def __init__(self, backend: KernelBackend, device: str) -> None:
        self.backend = backend
        self.device = device
        self._slots: dict[int, EventSlots] = {}  # for good: recorded launches know them by their capacity

    def empty(self, *shape: int, dtype: DTypeLike = np.float32) -> Any:
        """Make a device array with undefined contents."""
        return self.backend.empty(shape, dtype, self.device)

    def buffer(self, name: str, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Any:
        """Give a device array of a name and shape, the same one each time."""
        key = ("buffer", name, shape, np.dtype(dtype))
        return self.once(key, lambda: self.empty(*shape, dtype=dtype))

    def scratch(self, op: str, floats: DTypeLike = np.float32, **sizes: Any) -> list[Any]:
        """Make the partial results that an operation takes, for sizes and settings of its table."""
        return make_scratch(self.backend, self.device, op, floats, **sizes)

    def mirror(self, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Mirror:
        """Make a device array that the host writes or reads, of zeros."""
        return Mirror(self.backend, shape, dtype, self.device)

    def table(self, key: tuple[Any, ...], array: NDArray[Any]) -> Any:
        """Give a constant table on the device, copied there when it is first asked for."""
        return self.once(key, lambda: self.put(array))

    def events(self, window: Window, times: bool = True) -> EventSlots:
        """Give the events of a window on the device, until the next window of that size.

        A window that is the beginning of one that is there lies in its room; without ``times`` the times
        there may be those of the other one.
        """
        for slots in self._slots.values():
            if slots.holds(window):
                break
        else:
            capacity = max(FEWEST_EVENTS, 1 << (len(window) - 1).bit_length())
            if capacity not in self._slots:
                self._slots[capacity] = EventSlots(self, capacity)
            slots = self._slots[capacity]
            slots.load(window)
        if times:
            slots.load_times(window)
        return slots

    def put(self, array: NDArray[Any]) -> Any:
        """Put an array on the device."""
        return self.backend.from_host(array, self.device)

    def get(self, array: Any) -> NDArray[Any]:
        """Give a device array on the host."""
        return self.backend.to_host(array)
