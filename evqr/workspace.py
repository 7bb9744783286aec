"""Device arrays that are made once and used for every window, with the launches that work on them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from evqr.clock import one_time
from evqr_kernels import make_scratch

if TYPE_CHECKING:
    from evqr.events.batch import EventBatch
    from evqr.events.packed import PackedEvents
    from evqr_kernels.backend import KernelBackend


T = TypeVar("T")

MOST_KEPT = 384
"""Things that a workspace keeps at once.  Codes differ in size from recording to recording, and each size of
region has its own."""

MOST_KEPT_WITH_ONE = 48
"""Things that are kept at once with one of those, as they work on its buffers."""

FEWEST_EVENTS = 1 << 14
"""Room for events grows from this in powers of two, as all that was recorded is recorded anew for more."""


class Mirror:
    """A device array and its copy on the host: ``shared`` memory where the device is the CPU."""

    def __init__(
        self, backend: KernelBackend, shape: tuple[int, ...], dtype: DTypeLike, device: str, shared: bool
    ) -> None:
        self.host: NDArray[Any] = np.zeros(shape, dtype)
        self.device = backend.from_host(self.host, device)
        self._backend, self._shared = backend, shared
        self._filled = 0

    def write(self, values: ArrayLike) -> None:
        """Set the array."""
        self.host[...] = values
        self.push()

    def fill(self, values: ArrayLike) -> None:
        """Set the first rows of the array; those behind them are 0."""
        count = len(values)  # pyright: ignore[reportArgumentType]
        self.host[:count] = values
        if count < self._filled:
            self.host[count : self._filled] = 0
        self._filled = count
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
            with one_time():
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
        with one_time():
            return self._backend.record(self.launch)


class EventRoom:
    """Room on the device for the events of a batch, eight bytes each.

    Attributes
    ----------
    capacity : int
        Events that there is room for.
    x, y, stamp : (capacity,) uint16, uint16, uint32, on the device
        Columns of them, as of `PackedEvents`.
    """

    def __init__(self, workspace: Workspace, capacity: int) -> None:
        self.capacity = capacity
        self._mirrors = [workspace.mirror((capacity,), dtype) for dtype in (np.uint16, np.uint16, np.uint32)]
        self.x, self.y, self.stamp = (mirror.device for mirror in self._mirrors)
        self._events: PackedEvents | None = None

    def load(self, events: PackedEvents) -> None:
        """Bring events there, unless they are there already, alone or the first of more."""
        if self._events is not None and events.begin(self._events):
            return
        self._events = events
        for mirror, values in zip(self._mirrors, (events.x, events.y, events.stamp), strict=True):
            mirror.host[: len(events)] = values
            mirror.push()


class Workspace(Keeper):
    """Device arrays and recorded launches of one thread, each made when it is first asked for."""

    most_kept = MOST_KEPT

    def __init__(self, backend: KernelBackend, device: str) -> None:
        self.backend = backend
        self.device = device
        self._room = EventRoom(self, FEWEST_EVENTS)  # recorded launches know it by its capacity

    @cached_property
    def shared(self) -> bool:
        """Whether device and host have the same memory: then a few large launches are no better than many."""
        host = np.zeros(1, np.float32)
        return np.shares_memory(host, self.backend.to_host(self.put(host)))

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
        return Mirror(self.backend, shape, dtype, self.device, self.shared)

    def table(self, key: tuple[Any, ...], array: NDArray[Any]) -> Any:
        """Give a constant table on the device, copied there when it is first asked for."""
        return self.once(key, lambda: self.put(array))

    def events(self, batch: EventBatch) -> EventRoom:
        """Give the events of a batch on the device, until those of another one are asked for.

        They are brought there once for all that `EventBatch.pick` makes of it.
        """
        if len(batch.events) > self._room.capacity:
            self._room = EventRoom(self, 1 << (len(batch.events) - 1).bit_length())
        self._room.load(batch.events)
        return self._room

    def put(self, array: NDArray[Any]) -> Any:
        """Put an array on the device."""
        return self.backend.from_host(array, self.device)

    def get(self, array: Any) -> NDArray[Any]:
        """Give a device array on the host."""
        return self.backend.to_host(array)
