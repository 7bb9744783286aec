"""The one stage between what is stored or sent and what is read: checked, in order of time, cut, counted.

Recordings are often disordered locally: readout rows, packets of several threads, simulated frames.  Every
chunk is held back until no later event may precede it any more, so the memory is what the sensor fires within
`MAX_DISORDER_US`.  Files and live streams go through the same stage.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np

from evqr.events.array import EventArray

from ..errors import RecordingError
from .clock import MAX_DISORDER_US, ClockWatch
from .columns import ColumnChecker
from .faults import Faults
from .source import RawColumns

__all__ = ["MAX_DISORDER_US", "EventIntake", "Sorter", "in_order"]


class EventIntake:
    """Takes raw columns as they come; gives events that are right, ascending in time, and asked for.

    Parameters
    ----------
    checker : ColumnChecker
        Checks and converts.
    faults : Faults
        Is told what is wrong; refuses when it is too much.
    chunk_events : int
        Sorted stretches are cut to this length again.
    start_us, end_us : int | None [us]
        Events with ``start_us <= t < end_us`` are given; None: all.

    Attributes
    ----------
    done : bool
        Whether ``end_us`` has passed: nothing more will come.
    """

    def __init__(
        self,
        checker: ColumnChecker,
        faults: Faults,
        chunk_events: int,
        *,
        start_us: int | None = None,
        end_us: int | None = None,
    ) -> None:
        self._checker = checker
        self._faults = faults
        self._clock = ClockWatch(faults)
        self._sorter = Sorter(chunk_events, faults)
        self._start_us, self._end_us = start_us, end_us
        self.done = False

    def push(self, raw: RawColumns) -> Iterator[EventArray]:
        """Take some consecutive events; yield those that nothing can precede any more."""
        events = self._checker(raw)
        if len(events):
            for trusted in self._clock.push(events):
                yield from self._cut(self._sorter.push(trusted))

    def finish(self) -> Iterator[EventArray]:
        """Yield the rest; raises `RecordingError` when too many events were wrong."""
        for trusted in self._clock.finish():
            yield from self._cut(self._sorter.push(trusted))
        self._faults.judge(finished=True)
        yield from self._cut(self._sorter.finish())

    def _cut(self, chunks: Iterable[EventArray]) -> Iterator[EventArray]:
        for chunk in chunks:
            if self._end_us is not None and chunk.t[-1] >= self._end_us:
                self.done = self.done or bool(chunk.t[0] >= self._end_us)
                chunk = chunk.cut(0, chunk.first_at(self._end_us))
            if self._start_us is not None and len(chunk) and chunk.t[0] < self._start_us:
                chunk = chunk.cut(chunk.first_at(self._start_us), len(chunk))
            if len(chunk):
                yield chunk


class Sorter:
    """Gives the same events, ascending in time within and across chunks; equal times keep their order.

    Parameters
    ----------
    chunk_events : int
        Sorted stretches are cut to this length again.
    faults : Faults
        Counts of what was late are added to it on the way.
    """

    def __init__(self, chunk_events: int, faults: Faults) -> None:
        self._chunk_events = chunk_events
        self._faults = faults
        self._held: deque[EventArray] = deque()
        self._newest = np.iinfo(np.int64).min
        self._seen = 0

    def push(self, chunk: EventArray) -> Iterator[EventArray]:
        """Take nearly sorted events, not empty; yield those that nothing can precede any more.

        Raises
        ------
        RecordingError
            When a stamp lies more than `MAX_DISORDER_US` before one that came earlier.
        """
        held = self._held
        if chunk.t[0] >= self._newest and np.all(chunk.t[1:] >= chunk.t[:-1]):
            held.append(chunk)
        else:
            latest = np.maximum(np.maximum.accumulate(chunk.t), self._newest)
            back = latest - chunk.t
            worst = int(back.max())
            if worst > MAX_DISORDER_US:
                at = int(np.argmax(back > MAX_DISORDER_US))
                raise RecordingError(
                    f"{self._faults.name}: times jump back by {int(back[at]):,} us to {chunk.t[at]} us"
                    f" at event {self._seen + at:,}; up to {MAX_DISORDER_US:,} us are sorted, more is"
                    " refused: cut the recording there"
                )
            self._faults.late += int(np.count_nonzero(back))
            self._faults.worst_us = max(self._faults.worst_us, worst)
            held.extend(self._merged(chunk))
        self._seen += len(chunk)
        self._newest = held[-1].t[-1]
        while held and held[0].t[-1] <= self._newest - MAX_DISORDER_US:
            yield held.popleft()

    def finish(self) -> Iterator[EventArray]:
        """Yield the rest."""
        while self._held:
            yield self._held.popleft()

    def _merged(self, chunk: EventArray) -> list[EventArray]:
        """Take from what is held what overlaps ``chunk`` in time; return both sorted, cut to length."""
        earliest = chunk.t.min()
        parts = [chunk]
        while self._held and self._held[-1].t[-1] > earliest:
            parts.insert(0, self._held.pop())
        t = np.concatenate([part.t for part in parts])
        order = np.argsort(t, kind="stable")
        merged = EventArray(
            t[order],
            np.concatenate([part.x for part in parts])[order],
            np.concatenate([part.y for part in parts])[order],
            np.concatenate([part.p for part in parts])[order],
            chunk.width,
            chunk.height,
        )
        return [merged.cut(i, i + self._chunk_events) for i in range(0, len(merged), self._chunk_events)]


def in_order(chunks: Iterable[EventArray], chunk_events: int, faults: Faults) -> Iterator[EventArray]:
    """Sort chunks of nearly sorted events, none of them empty, with a `Sorter`."""
    sorter = Sorter(chunk_events, faults)
    for chunk in chunks:
        yield from sorter.push(chunk)
    yield from sorter.finish()
