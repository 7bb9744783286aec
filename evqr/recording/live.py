"""What comes bit by bit from a source that has no end: checked, in order of time, with its clock watched.

Nothing that comes in can stop a line: events that are wrong, or later than the bound on disorder allows, are
left out and counted, and a clock that was reset begins a new epoch, in which times are those of its clock.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np

from evqr.events.array import EventArray

from .clock import MAX_DISORDER_US, ClockWatch, Reset
from .columns import ColumnChecker
from .declared import TimeUnit
from .faults import Faults
from .source import RawColumns

KINDS = tuple(np.dtype(kind) for kind in (np.int64, np.uint16, np.uint16, np.int8))
"""Of columns that need not be converted."""

Incoming: TypeAlias = "EventArray | Reset"
"""Events in order of time; or that those behind are of a clock that was reset."""


class LiveFaults(Faults):
    """Keeps count of what is wrong, and never refuses: a live source cannot be mended and read again."""

    def judge(self, *, finished: bool = False) -> None:
        """Do nothing, whatever share of the events is wrong."""


class LiveIntake:
    """Takes raw columns as they come; gives events that are right and in order of time.

    What is held back is what the sensor fires within ``disorder_us``, and while a clock may have been reset,
    within `MAX_DISORDER_US`.

    Parameters
    ----------
    name : str
        The source, for messages.
    sensor : (int, int) [px]
        Width and height.
    unit : "s", "ms", "us" or "ns"
        Of the times.
    disorder_us : int [us]
        How much later than others events may come to be sorted.

    Attributes
    ----------
    faults : LiveFaults
        Counts of what was wrong.
    known_us : int or None [us]
        Time up to which all events are given, by the clock of the epoch; None before any came.
    """

    def __init__(
        self, name: str, sensor: tuple[int, int], *, unit: TimeUnit = "us", disorder_us: int = 0
    ) -> None:
        self.faults = LiveFaults(name)
        self.known_us: int | None = None
        self._checker = ColumnChecker(name, sensor, unit, 0, self.faults)
        self._clock = ClockWatch(self.faults, ahead_us=-1)
        self._shift_us = 0
        self._disorder_us = disorder_us
        self._held: EventArray | None = None
        self._newest = -1

    @property
    def unit(self) -> TimeUnit:
        """Unit of the times of what comes next."""
        return self._checker.unit

    @unit.setter
    def unit(self, unit: TimeUnit) -> None:
        self._checker.unit = unit

    def push(self, raw: RawColumns) -> Iterator[Incoming]:
        """Take some consecutive events, in the unit of the source.

        Parameters
        ----------
        raw : RawColumns
            Unchecked.

        Yields
        ------
        incoming : EventArray or Reset
            What nothing can precede any more.
        """
        events = self._right(raw) or self._checker(raw)
        if not len(events):
            return
        first_us, last_us = int(events.t[0]), int(events.t[-1])
        known_us = -1 if self.known_us is None else self.known_us
        ascending = first_us >= known_us and bool((events.t[1:] >= events.t[:-1]).all())
        if not ascending or not self._clock.follows(first_us, last_us, len(events)):
            yield from self._trusted(self._clock.push(events))
        elif self._disorder_us:
            yield from self._sorted(events)
        else:  # usual, and quick
            self._newest = self.known_us = last_us
            yield events

    def _right(self, raw: RawColumns) -> EventArray | None:
        """Take columns as they are where that can be seen quickly; None where they must be looked at."""
        width, height = self._checker.width, self._checker.height
        kinds = tuple(column.dtype for column in raw)
        if (
            kinds != KINDS
            or self.unit != "us"
            or len({len(column) for column in raw}) > 1
            or not len(raw.t)
            or raw.x.max() >= width
            or raw.y.max() >= height
            or raw.t.min() < 0
            or not (raw.p * raw.p == 1).all()
        ):
            return None
        self.faults.met += len(raw.t)
        return EventArray(*raw, width, height)

    def advance(self, time_us: int) -> Iterator[Incoming]:
        """Say that the clock has reached a time, and that all events before it were pushed.

        Parameters
        ----------
        time_us : int [us]
            By the clock of the epoch; one before the newest says nothing.

        Yields
        ------
        incoming : EventArray or Reset
            What was held back up to then.
        """
        yield from self._trusted(self._clock.reached(time_us + self._shift_us))
        yield from self._released(time_us)

    def finish(self) -> Iterator[Incoming]:
        """Yield the rest."""
        yield from self._trusted(self._clock.finish())
        if self._held is not None:
            yield from self._released(self._newest)

    def _trusted(self, parts: list[EventArray]) -> Iterator[Incoming]:
        """Sort what the clock lets through, with times by the clock of its epoch."""
        for part in parts:
            if self._clock.resets and part.t[0] >= self._start_us(self._clock.resets[0]):
                yield from self._released(self._newest)
                reset = self._clock.resets.pop(0)
                self._shift_us, self._newest, self.known_us = reset.shift_us, -1, None
                yield reset
            yield from self._sorted(_later(part, -self._shift_us))

    @staticmethod
    def _start_us(reset: Reset) -> int:
        return reset.after_us + reset.shift_us - MAX_DISORDER_US

    def _sorted(self, part: EventArray) -> Iterator[EventArray]:
        t = part.t
        latest = np.maximum(np.maximum.accumulate(t), self._newest)
        in_time = latest - t <= self._disorder_us
        if self.known_us is not None and self.known_us > self._newest - self._disorder_us:
            in_time &= t >= self.known_us  # time was advanced further than events came
        self._newest = int(latest[-1])
        if not in_time.all():
            count = int(np.count_nonzero(~in_time))
            first = int(t[np.argmin(in_time)])
            self.faults.leave_out(count, f"time {first} us came after {self._newest} us", "")
            part = _picked(part, in_time)
        if self._disorder_us == 0 and self._held is None:
            if len(part):
                yield part
            self._know(self._newest)
            return
        if len(part):
            joined = part if self._held is None else _joined(self._held, part)
            self._held = _picked(joined, np.argsort(joined.t, kind="stable"))
        yield from self._released(self._newest - self._disorder_us)

    def _released(self, until_us: int) -> Iterator[EventArray]:
        """Give what is held back up to a time, and know that nothing before it will come."""
        held = self._held
        if held is not None:
            first = held.first_at(until_us + 1)
            self._held = held.cut(first, len(held)) if first < len(held) else None
            if first:
                yield held.cut(0, first)
        self._know(until_us)

    def _know(self, time_us: int) -> None:
        if self.known_us is None or time_us > self.known_us:
            self.known_us = time_us


def _later(events: EventArray, by_us: int) -> EventArray:
    if not by_us:
        return events
    return EventArray(events.t + by_us, events.x, events.y, events.p, events.width, events.height)


def _picked(events: EventArray, which: np.ndarray) -> EventArray:
    return EventArray(
        events.t[which], events.x[which], events.y[which], events.p[which], events.width, events.height
    )


def _joined(one: EventArray, other: EventArray) -> EventArray:
    t, x, y, p = (np.concatenate([getattr(one, name), getattr(other, name)]) for name in ("t", "x", "y", "p"))
    return EventArray(t, x, y, p, one.width, one.height)
