"""The part of a stream that windows are still cut from."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Generator
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray
from evqr.events.packed import write_stamps
from evqr.events.window import Window

SMALLEST_BLOCK = 1 << 14
"""Room for events that is made at least: chunks of a few events then seldom ask for more."""

T = TypeVar("T")

Asking: TypeAlias = Generator[tuple[int, int], Window, T]
"""Work that asks for windows as it goes: it yields the bounds of each [us], is sent the window, and returns
what it worked out.  Who runs it decides when the events are there."""


class _Held(NamedTuple):
    """Events ``first`` to ``last - 1`` of a block, whose first event is number ``base`` of the stream."""

    block: EventArray
    stamps: NDArray[np.uint32]
    first: int
    last: int
    base: int

    def place_of(self, time_us: float) -> int:
        """Place in the block of the first event held at a time or later."""
        return bisect_left(self.block.t, time_us, self.first, self.last)


class EventBuffer:
    """The part of a stream that windows are still cut from.

    Chunks are copied one behind the other into a block of columns, so they may be of any size and the arrays
    of the caller are free again.  When a block is full, what is still wanted of it moves to a new one with as
    much room again: an event is moved about twice at most, however small the chunks and however long it is
    wanted.  Windows are views of blocks.  What a block holds never changes, so windows stay valid, and any
    number of threads may cut windows while one pushes and forgets.  Stamps are made once, as events come:
    most events are in several windows.

    Parameters
    ----------
    width, height : int [px]
        Size of the sensor.

    Attributes
    ----------
    first_us, last_us : int or None [us]
        Times of the first and of the newest event of the stream; None before any came.
    known_us : float [us]
        Time to which the stream has come: all events before it were pushed; minus infinity before any came.
    pushed : int
        Events of the stream so far.
    closed : bool
        Whether the stream has ended.
    """

    def __init__(self, width: int, height: int) -> None:
        self.first_us: int | None = None
        self.last_us: int | None = None
        self.pushed = 0
        self.closed = False
        self._stream = object()
        self._size = width, height
        self._held = _Held(_room(0, width, height), np.empty(0, np.uint32), 0, 0, 0)
        self.known_us: float = -np.inf
        self._forgotten_us: float = -np.inf

    @classmethod
    def of(cls, events: EventArray) -> EventBuffer:
        """Give a closed buffer that holds a whole recording.

        Parameters
        ----------
        events : EventArray
            All of it, in order of time.

        Returns
        -------
        buffer : EventBuffer
            To which nothing more can be pushed.
        """
        buffer = cls(events.width, events.height)
        buffer.push(events)
        buffer.close()
        return buffer

    def push(self, events: EventArray) -> None:
        """Take the next events of the stream.

        Parameters
        ----------
        events : EventArray
            In order of time, none before the newest that was pushed or the time advanced to.

        Raises
        ------
        ValueError
            When they come too late, after `close`, or of a sensor of another size.
        """
        if self.closed:
            raise ValueError("events were pushed to a stream that is closed")
        if (events.width, events.height) != self._size:
            width, height = self._size
            raise ValueError(
                f"events must be of a sensor {width}x{height}, got {events.width}x{events.height}"
            )
        count = len(events)
        if count == 0:
            return
        first_us = int(events.t[0])
        if first_us < self.known_us:
            raise ValueError(
                f"events must come in order of time: {first_us} us came after {self.known_us} us"
            )
        held = self._held
        if held.last + count > len(held.block):
            held = self._moved(held, count)
        block, end = held.block, held.last + count
        block.t[held.last : end] = events.t
        block.x[held.last : end] = events.x
        block.y[held.last : end] = events.y
        block.p[held.last : end] = events.p
        write_stamps(events, held.stamps[held.last : end])
        self._held = held._replace(last=end)
        if self.first_us is None:
            self.first_us = first_us
        self.last_us = int(events.t[-1])
        self.known_us = self.last_us
        self.pushed += count

    def _moved(self, held: _Held, count: int) -> _Held:
        """Give the events held in a new block with room for more."""
        live = held.last - held.first
        room = max(2 * live + count, SMALLEST_BLOCK)
        block, stamps = _room(room, *self._size), np.empty(room, np.uint32)
        old = held.block.cut(held.first, held.last)
        block.t[:live], block.x[:live], block.y[:live], block.p[:live] = old.t, old.x, old.y, old.p
        stamps[:live] = held.stamps[held.first : held.last]
        return _Held(block, stamps, 0, live, held.base + held.first)

    def advance(self, time_us: int) -> None:
        """Say that all events before a time were pushed, though none may have come since long.

        Parameters
        ----------
        time_us : int [us]
            The time.
        """
        self.known_us = max(self.known_us, time_us)

    def close(self) -> None:
        """Say that the stream has ended."""
        self.closed = True

    def reaches(self, time_us: float) -> bool:
        """Tell whether the stream went on to a time, so that all events before it are here.

        Parameters
        ----------
        time_us : float [us]
            The time.

        Returns
        -------
        reaches : bool
            Whether it did.
        """
        return self.known_us >= time_us

    def forget(self, before_us: float) -> None:
        """Let go of events before a time; no window may begin there any more.

        Parameters
        ----------
        before_us : float [us]
            The time.
        """
        if before_us > self._forgotten_us:
            self._forgotten_us = before_us
            self._held = self._held._replace(first=self._held.place_of(before_us))

    def count_before(self, time_us: float) -> int:
        """Count the events of the stream before a time.

        Parameters
        ----------
        time_us : float [us]
            The time, which must not be forgotten.

        Returns
        -------
        count : int
            Since the stream began.
        """
        held = self._held
        return held.base + held.place_of(time_us)

    def count_from(self, time_us: float) -> int:
        """Count the events from a time on that have come.

        Parameters
        ----------
        time_us : float [us]
            The time, which must not be forgotten.

        Returns
        -------
        count : int
            Up to the newest.
        """
        return self.pushed - self.count_before(time_us)

    def first_from(self, time_us: float) -> int | None:
        """Give the time of the first event at a time or later.

        Parameters
        ----------
        time_us : float [us]
            The time, which must not be forgotten.

        Returns
        -------
        time_us : int or None [us]
            None where none has come yet.
        """
        held = self._held
        place = held.place_of(time_us)
        return int(held.block.t[place]) if place < held.last else None

    def window(self, start_us: int, end_us: int) -> Window:
        """Cut a window.

        Windows of one stream that begin with the same event know it (`Window.begins_like`).

        Parameters
        ----------
        start_us, end_us : int [us]
            Bounds, the end not included.

        Returns
        -------
        window : Window
            Its events are views of what the buffer holds.

        Raises
        ------
        ValueError
            When it begins in what is forgotten, or ends after what has come while the stream goes on.
        """
        if start_us < self._forgotten_us:
            raise ValueError(
                f"a window from {start_us} us begins in what is forgotten, up to {self._forgotten_us} us"
            )
        if not self.closed and end_us > self.known_us:
            raise ValueError(f"a window to {end_us} us ends after what has come, up to {self.known_us} us")
        held = self._held
        first, last = held.place_of(start_us), held.place_of(end_us)
        last = max(first, last)
        origin, stamps = (self._stream, held.base + first), held.stamps[first:last]
        return Window(held.block.cut(first, last), start_us, end_us, origin=origin, stamps=stamps)

    def answer(self, asking: Asking[T]) -> T:
        """Run work that asks for windows, all of whose events are here.

        Parameters
        ----------
        asking : generator
            Yields the bounds of each window that it needs [us], and is sent the window.

        Returns
        -------
        answer : any
            What the generator returns.
        """
        try:
            bounds = next(asking)
            while True:
                bounds = asking.send(self.window(*bounds))
        except StopIteration as end:
            return end.value


def _room(count: int, width: int, height: int) -> EventArray:
    """Columns for so many events, with undefined contents."""
    x, y = np.empty((2, count), np.uint16)
    return EventArray(np.empty(count, np.int64), x, y, np.empty(count, np.int8), width, height)
