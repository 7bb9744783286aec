"""Device arrays that are made once and used for every window, with the launches that work on them."""

from __future__ import annotations

import operator
import weakref
from collections import OrderedDict
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from evqr.clock import one_time
from evqr_kernels import make_scratch
from evqr_kernels.backend import part_of, words_of

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

FEWEST_EVENTS, MANY_EVENTS = 1 << 14, 1 << 18
"""Room for events grows from the one in powers of two up to the other, then by an eighth or less, as all that
was recorded is recorded anew for more."""

LARGEST_GAP = 1 << 17
"""Events that there may be less than there is room for, for their columns to be copied as one with what is
between them: as many bytes as go over a slow bus in the time that two more copies take."""


COLUMNS = np.uint16, np.uint16, np.uint32
"""Of events."""

LEAST_BEFORE = 1 << 20
"""Words before the events of a device: as many as what is asked and answered of 128 small codes takes."""

ALIGNED = 16
"""Words of 32 bits that parts of a block begin with a multiple of: a line of the cache."""


MOST_BYTES = {"host": 1 << 27, "device": 1 << 32}
"""Bytes that windows side by side may take: of a host's memory, where more of them are no faster, and of a
device's own."""

MOST_KEPT_BYTES = {"host": 1 << 30, "device": 1 << 34}
"""Bytes that what a workspace keeps may take."""

FEWEST_KEPT = 16
"""Things that are kept whatever they take: what is in use is among them."""


class Mirror:
    """A device array and its copy on the host, both parts of the blocks of a `Staging`.

    They are the same memory where the device is the CPU.
    """

    def __init__(self, staging: Staging, shape: tuple[int, ...], dtype: DTypeLike, value: ArrayLike) -> None:
        self.shape, self.dtype, self.value = shape, dtype, value
        self._staging = staging
        self._filled = 0

    @cached_property
    def host(self) -> NDArray[Any]:
        """What the host writes before its sequence runs, and reads after `read`."""
        return self._staging.host_part(self)

    @cached_property
    def device(self) -> Any:
        """What kernels take."""
        return self._staging.device_part(self)

    def write(self, values: ArrayLike) -> None:
        """Set the array."""
        self.host[...] = values

    def fill(self, values: ArrayLike) -> None:
        """Set the first rows of the array; those behind them are 0."""
        count = len(values)  # pyright: ignore[reportArgumentType]
        self.host[:count] = values
        if count < self._filled:
            self.host[count : self._filled] = 0
        self._filled = count

    def read(self) -> NDArray[Any]:
        """Wait for the device and give the host's copy, which the next run overwrites."""
        self._staging.pull()
        return self.host


class Staging:
    """What a sequence of launches takes from the host and gives to it: one copy there, and one back.

    Small arrays, side by side in one block on the host and in one on the device, which are made when one of
    them is first asked for: outputs first, inputs last, and between them what is both.  What launches work on
    ``events`` lies before these on the device, so that events that are not there yet go with it.
    """

    def __init__(self, workspace: Workspace, events: EventRoom | None = None) -> None:
        self._workspace = workspace
        self._events = None if workspace.shared else events
        self._inputs: list[Mirror] = []
        self._both: list[Mirror] = []
        self._outputs: list[Mirror] = []
        self._to_read = False

    def input(self, shape: tuple[int, ...], dtype: DTypeLike = np.float32, value: ArrayLike = 0) -> Mirror:
        """Make an array that the host writes; at first all of it is some value."""
        return self._add(self._inputs, shape, dtype, value)

    def both(self, shape: tuple[int, ...], dtype: DTypeLike = np.float32, value: ArrayLike = 0) -> Mirror:
        """Make an array that the host writes, and the device after it."""
        return self._add(self._both, shape, dtype, value)

    def output(self, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Mirror:
        """Make an array that the host reads."""
        return self._add(self._outputs, shape, dtype, 0)

    def _add(
        self, mirrors: list[Mirror], shape: tuple[int, ...], dtype: DTypeLike, value: ArrayLike
    ) -> Mirror:
        assert "_blocks" not in vars(self), "arrays are declared before one of them is used"
        mirrors.append(Mirror(self, shape, dtype, value))
        return mirrors[-1]

    @cached_property
    def _places(self) -> tuple[dict[Mirror, int], int, int, int]:
        """Give the first word of each array, and where outputs end, and what is both, and all."""
        places: dict[Mirror, int] = {}
        ends, end = [], 0
        for mirrors in (self._outputs, self._both, self._inputs):
            for mirror in mirrors:
                places[mirror] = end
                end += -(-words_of(mirror.shape, mirror.dtype) // ALIGNED) * ALIGNED
            ends.append(end)
        return places, *ends

    @cached_property
    def _blocks(self) -> tuple[NDArray[np.uint32], Any, int]:
        """Give the block on the host, that on the device, and where it begins in that."""
        places, *_, end = self._places
        host = np.zeros(end, np.uint32)
        for mirror, first in places.items():
            part_of(host, first, mirror.shape, mirror.dtype)[...] = mirror.value
        if self._events is None:
            return host, self._workspace.put(host), 0
        return host, *self._events.before(end)

    def host_part(self, mirror: Mirror) -> NDArray[Any]:
        """Give an array on the host."""
        return part_of(self._blocks[0], self._places[0][mirror], mirror.shape, mirror.dtype)

    def device_part(self, mirror: Mirror) -> Any:
        """Give an array on the device."""
        _, block, begin = self._blocks
        first = begin + self._places[0][mirror]
        return self._workspace.backend.part(block, first, mirror.shape, mirror.dtype)

    def push(self) -> None:
        """Bring to the device what was written."""
        _, first, _, end = self._places
        host, block, begin = self._blocks
        if self._events is not None:
            self._events.push(host[first:])
        elif end > first:
            assign_part(self._workspace.backend, block, begin + first, host[first:])

    def pull(self) -> None:
        """Bring back what the device wrote since the last time."""
        if self._to_read:
            _, _, end, _ = self._places
            host, block, begin = self._blocks
            backend = self._workspace.backend
            host[:end] = backend.to_host(backend.part(block, begin, (end,), np.uint32))
            self._to_read = False

    def sequence(self, launch: Callable[[], None]) -> Callable[[], None]:
        """Record what launches kernels on these arrays; it then runs with the inputs as they are."""
        with one_time():
            _ = self._blocks  # made before launches ask where events are
            recorded = self._workspace.backend.record(launch)
        if self._workspace.shared:
            return recorded

        def run() -> None:
            self.push()
            recorded()
            self._to_read = True

        return run


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
    """Launches on arrays of its own: alone, or as a part of a larger step, whose ``staging`` it is given.

    Alone it may work on ``events``.
    """

    def __init__(
        self, workspace: Workspace, staging: Staging | None = None, events: EventRoom | None = None
    ) -> None:
        self._backend = workspace.backend
        self._staging = staging or Staging(workspace, events)

    def launch(self) -> None:
        """Launch the kernels one by one."""
        raise NotImplementedError

    @cached_property
    def run(self) -> Callable[[], None]:
        """Launches all of it, recorded when it is first asked for."""
        return self._staging.sequence(self.launch)


class EventRoom:
    """Room on the device for the events of a batch, eight bytes each, and before them for what goes along.

    Attributes
    ----------
    capacity : int
        Events that there is room for.
    x, y, stamp : (capacity,) uint16, uint16, uint32, on the device
        Columns of them, as of `PackedEvents`.
    """

    def __init__(self, workspace: Workspace, capacity: int) -> None:
        self.capacity = capacity
        self._workspace = workspace
        self._parts: tuple[PackedEvents, ...] = ()
        self._count, self._waiting = 0, False
        self._make(0 if workspace.shared else LEAST_BEFORE)

    def _make(self, before: int) -> None:
        self._before, ends = before, [before]
        for dtype in COLUMNS:
            ends.append(ends[-1] + words_of((self.capacity,), dtype))
        self._host, self._begins = np.zeros(ends.pop(), np.uint32), ends
        self._block = self._workspace.put(self._host)
        there = [(begin, (self.capacity,), dtype) for begin, dtype in zip(ends, COLUMNS, strict=True)]
        self._columns = [part_of(self._host, *each) for each in there]
        self.x, self.y, self.stamp = (self._workspace.backend.part(self._block, *each) for each in there)

    @property
    def size(self) -> tuple[int, int]:
        """How much room there is: what is recorded for it is recorded anew for more."""
        return self.capacity, self._before

    def before(self, words: int) -> tuple[Any, int]:
        """Give the block on the device, and its word from which on there are so many before the events."""
        if words > self._before:
            columns = [column[: self._count] for column in self._columns]
            self._make(1 << (words - 1).bit_length())
            for column, values in zip(self._columns, columns, strict=True):
                column[: self._count] = values
            self._waiting = True
        return self._block, self._before - words

    def load(self, batch: EventBatch) -> None:
        """Take the events of a batch, unless they are here already, alone or the first of more."""
        parts, there = batch.parts, 0
        if len(parts) == len(self._parts):
            if all(map(operator.is_, parts, self._parts)) or (
                len(parts) == 1 and parts[0].begin(self._parts[0])
            ):
                return
            if len(parts) == 1 and self._parts[0].begin(parts[0]):
                there = len(self._parts[0])  # on the host, the first of these
        self._parts, self._count, self._waiting = parts, batch.n_events, True
        if parts:
            for name, column in zip(("x", "y", "stamp"), self._columns, strict=True):
                # of several parts none is there
                rest = column[there : self._count]
                np.concatenate([getattr(part, name)[there:] for part in parts], out=rest)

    def push(self, inputs: NDArray[np.uint32]) -> None:
        """Bring to the device what lies right before the events, and with it those that are not there yet."""
        first, backend = self._before - len(inputs), self._workspace.backend
        if not self._waiting:
            if len(inputs):
                assign_part(backend, self._block, first, inputs)
            return
        self._waiting, self._host[first : self._before] = False, inputs
        spans = [
            (begin, begin + words_of((self._count,), dtype))
            for begin, dtype in zip(self._begins, COLUMNS, strict=True)
        ]
        spans[0] = first, spans[0][1]
        if self.capacity - self._count <= LARGEST_GAP + self._count // 8:
            spans = [(first, spans[-1][1])]
        for begin, end in spans:
            assign_part(backend, self._block, begin, self._host[begin:end])


def assign_part(backend: KernelBackend, block: Any, first: int, values: NDArray[np.uint32]) -> None:
    """Copy words into a block, from one of its words on."""
    backend.assign(backend.part(block, first, values.shape, np.uint32), values)


class Workspace(Keeper):
    """Device arrays and recorded launches of one thread, each made when it is first asked for."""

    most_kept = MOST_KEPT

    def __init__(self, backend: KernelBackend, device: str) -> None:
        self.backend = backend
        self.device = device
        self._bytes: list[int] = []  # of each array that was made and is still there
        self._room = EventRoom(self, FEWEST_EVENTS)  # recorded launches know it by its capacity

    def once(self, key: Any, make: Callable[[], T]) -> T:
        """Give whatever ``make`` gives, made when it is first asked for; what takes too much in all goes."""
        arrays = len(self._bytes)
        made = super().once(key, make)
        if len(self._bytes) > arrays and sum(self._bytes) > MOST_KEPT_BYTES[self._memory]:
            while sum(self._bytes) > MOST_KEPT_BYTES[self._memory] // 2 and len(self._kept) > FEWEST_KEPT:
                self._kept.popitem(last=False)
        return made

    @property
    def _memory(self) -> str:
        return "host" if self.shared else "device"

    @cached_property
    def shared(self) -> bool:
        """Whether device and host have the same memory: then a few large launches are no better than many."""
        host = np.zeros(1, np.float32)
        return np.shares_memory(host, self.backend.to_host(self.put(host)))

    def windows_at_once(self, bytes_each: float) -> int:
        """Give how many windows, each of which takes so many bytes, are worked on side by side."""
        most = int(MOST_BYTES[self._memory] / bytes_each)
        return 1 << max(most, 1).bit_length() - 1  # what is made for windows has room for a power of two

    def empty(self, *shape: int, dtype: DTypeLike = np.float32) -> Any:
        """Make a device array with undefined contents."""
        return self._counted(self.backend.empty(shape, dtype, self.device))

    def _counted(self, array: Any) -> Any:
        """Count the bytes of an array for as long as it is there."""
        n_bytes = words_of(array.shape, np.float32) * 4
        self._bytes.append(n_bytes)
        # of the list alone: what is called must not hold the workspace
        weakref.finalize(array, self._bytes.remove, n_bytes).atexit = False
        return array

    def buffer(self, name: str, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Any:
        """Give a device array of a name and shape, the same one each time."""
        key = ("buffer", name, shape, np.dtype(dtype))
        return self.once(key, lambda: self.empty(*shape, dtype=dtype))

    def scratch(self, op: str, floats: DTypeLike = np.float32, **sizes: Any) -> list[Any]:
        """Make the partial results that an operation takes, for sizes and settings of its table."""
        return [*map(self._counted, make_scratch(self.backend, self.device, op, floats, **sizes))]

    def table(self, key: tuple[Any, ...], array: NDArray[Any]) -> Any:
        """Give a constant table on the device, copied there when it is first asked for."""
        return self.once(key, lambda: self.put(array))

    def events(self, batch: EventBatch) -> EventRoom:
        """Give room that holds the events of a batch, until those of another one are asked for.

        They are brought to the device once for all that `EventBatch.pick` makes of it, with the first of the
        sequences that work on them.
        """
        count = batch.n_events
        if count > self._room.capacity:
            step = 1 << (count - 1).bit_length() - (0 if count <= MANY_EVENTS else 4)
            self._room = EventRoom(self, -(-count // step) * step)
        self._room.load(batch)
        return self._room

    def put(self, array: NDArray[Any]) -> Any:
        """Put an array on the device."""
        return self.backend.from_host(array, self.device)

    def get(self, array: Any) -> NDArray[Any]:
        """Give a device array on the host."""
        return self.backend.to_host(array)
