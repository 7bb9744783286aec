"""`Recording`: one source of events, checked, converted and in order, a chunk at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from types import TracebackType

import numpy as np

from evqr.events.array import EventArray

from ..errors import RecordingError
from .columns import ColumnChecker, settle_sensor, usable_times
from .declared import PER_SECOND, DeclaredUnit, TimeUnit, Unclear
from .faults import EventCounts, Faults
from .options import Asked
from .ordering import EventIntake
from .source import RawColumns, Source
from .time_unit import decide_time_unit, odd_if_asked
from .triggers import Edge, TriggerKind

SAMPLE_EVENTS = 1 << 16  # the unit of time is judged by so many first events


class Recording:
    """Events of one recording, streamed; a context manager.  Made by `open_recording`.

    Attributes
    ----------
    path : str
        "" for arrays.
    format : str
        In words, such as "HDF5 events/{t,x,y,p}".
    stream : str
        Name of the event stream that is read, "" where the format has but one.
    streams : tuple of str
        Names of all event streams in the file.
    width, height : int [px]
        Sensor size.
    n_events : int | None
        Events that are given; None until known.
    t_first_us, t_last_us : int | None [us]
        First and last time stamp; None until streamed, but the last is known at once where the source can
        look at its end.
    time_unit, time_unit_reason : str
        Unit of the stored stamps, and how it is known.
    notes : tuple of str
        What was odd, and what was decided, each in one line; grows while streaming.
    counts : EventCounts
        Events left out and sorted, and clocks, by the last way through.
    """

    def __init__(self, source: Source, *, path: str, asked: Asked) -> None:
        self._source = source
        self._asked = asked
        self.path = path
        self.format = source.format
        self.stream, self.streams = source.stream, source.streams
        self.n_events = source.n_events
        self.t_first_us: int | None = None
        self.t_last_us: int | None = None
        self._notes = list(source.notes)
        self._faults = Faults(source.name, strict=asked.strict)

        first = self._first_events()
        size, remark = settle_sensor(asked.sensor, source.sensor, source.name)
        self.width, self.height = size
        if remark:
            self._notes.append(remark)
        good = usable_times(first.t, source.name)
        if asked.strict or np.mean(good) < 0.5:
            self._check(first, DeclaredUnit(asked.time_unit or "us", ""))  # has a word on what is wrong
        unit = self._unit(first.t[good])
        self.time_unit: TimeUnit = unit.unit
        self.time_unit_reason = unit.reason
        if first.t.dtype == np.float32:
            step_us = float(np.spacing(first.t[good].max())) * 1e6 / PER_SECOND[self.time_unit]
            if step_us > 1:
                self._notes.append(
                    f"times are stored as float32, which tells no less than {step_us:.2g} us apart"
                )
        self._check_end()

    @property
    def notes(self) -> tuple[str, ...]:
        """What was odd, and what was decided, each in one line."""
        return (*self._notes, *self._faults.notes)

    @property
    def counts(self) -> EventCounts:
        """Events left out and sorted, and clocks, by the last way through."""
        return self._faults.counts

    def _first_events(self) -> RawColumns:
        source, faults = self._source, Faults(self._source.name, strict=self._asked.strict)
        # The first chunk of a vendor file may hold nothing but trigger words.
        with closing(source.raw_chunks(SAMPLE_EVENTS, faults)) as raw_chunks:
            first = next((raw for raw in raw_chunks if len(raw.t)), None)
        if first is None:
            faults.judge(finished=True)
            more = "".join(f"; {note}" for note in faults.notes)
            raise RecordingError(
                f"{source.name}: the recording is empty: {source.format} with 0 events{more}"
            )
        return first

    def _check(
        self, raw: RawColumns, unit: DeclaredUnit, *, first: int = 0, whole: bool = False
    ) -> EventArray:
        """Check some events apart from the others."""
        faults = Faults(self._source.name, strict=self._asked.strict)
        events = self._checker(faults, unit.unit, first=first)(raw)
        faults.judge(finished=whole)
        return events

    def _checker(self, faults: Faults, unit: TimeUnit, *, first: int = 0) -> ColumnChecker:
        size = self.width, self.height
        return ColumnChecker(self._source.name, size, unit, self._source.t_offset_us, faults, first=first)

    def _check_end(self) -> None:
        tail = self._source.raw_tail(SAMPLE_EVENTS)
        if tail is None or not len(tail.t):
            return
        total = self._source.n_events or 0
        unit = DeclaredUnit(self.time_unit, "")
        events = self._check(tail, unit, first=total - len(tail.t), whole=len(tail.t) == total)
        if len(events):
            last = int(events.t.max())
            self.t_last_us = last if self._asked.end_us is None else min(last, self._asked.end_us)

    def _unit(self, t: np.ndarray) -> DeclaredUnit:
        asked, declared = self._asked.time_unit, self._source.unit
        if asked is not None:
            if isinstance(declared, Unclear):
                self._notes.append(f"{declared.said}; {asked} was asked for")
            elif declared is not None and declared.unit != asked:
                self._notes.append(f"times are taken as {asked} as asked, though {declared.reason}")
            sensor = self.width, self.height
            self._notes.extend(odd_if_asked(t, asked, sensor, self._source.name))
            return DeclaredUnit(asked, "as asked")
        if isinstance(declared, Unclear):
            raise RecordingError(f'{self._source.name}: {declared.said}; pass time_unit="us|ms|s|ns"')
        return declared or decide_time_unit(t, (self.width, self.height), self._source.name)

    def chunks(self) -> Iterator[EventArray]:
        """Yield all events, ascending in time also across chunks, about ``chunk_events`` at a time.

        Memory is bounded by the chunk and by what the sensor fires within `ordering.MAX_DISORDER_US`.  Can be
        called again for another pass.

        Yields
        ------
        events : EventArray
            The next chunk.

        Raises
        ------
        RecordingError
            When more is wrong than may be left out, or at the first event that is wrong if ``strict``.
        """
        asked, source = self._asked, self._source
        self._faults = faults = Faults(source.name, strict=asked.strict)
        checker = self._checker(faults, self.time_unit)
        intake = EventIntake(
            checker, faults, asked.chunk_events, start_us=asked.start_us, end_us=asked.end_us
        )
        given, last = 0, None
        for chunk in self._through(intake, faults):
            if last is None:
                self.t_first_us = int(chunk.t[0])
            last = int(chunk.t[-1])
            given += len(chunk)
            yield chunk
        if last is None:
            bounds = f"from {asked.start_us or 0} us" + (
                "" if asked.end_us is None else f" to {asked.end_us} us"
            )
            raise RecordingError(f"{source.name}: no event {bounds}; times are those that evqr info shows")
        self.n_events = given
        self.t_last_us = last

    def _through(self, intake: EventIntake, faults: Faults) -> Iterator[EventArray]:
        with closing(self._source.raw_chunks(self._asked.chunk_events, faults)) as raw_chunks:
            for raw in raw_chunks:
                if len(raw.t):
                    yield from intake.push(raw)
                if intake.done:
                    return
        yield from intake.finish()

    def triggers(self) -> list[tuple[int, TriggerKind]]:
        """Give the triggers that are in the file, in a way through of its own.

        Returns
        -------
        edges : list of (int [us], "pulse", "start" or "end")
            When, in order and by the clock of the file where that was reset; and whether a part passes, its
            gate opens as a signal rises, or closes as it falls.

        Raises
        ------
        RecordingError
            None are read from such files.
        """
        asked, offset_us = self._asked, self._source.t_offset_us
        edges = [Edge(edge.t_us + offset_us, edge.kind) for edge in self._source.edges()]
        first_us, last_us = asked.start_us or 0, math.inf if asked.end_us is None else asked.end_us
        return sorted(edge for edge in edges if first_us <= edge.t_us <= last_us)

    def read(self) -> EventArray:
        """Give all events at once.

        Returns
        -------
        events : EventArray
            Ascending in time.
        """
        parts = list(self.chunks())
        if len(parts) == 1:
            return parts[0]
        return EventArray(
            np.concatenate([part.t for part in parts]),
            np.concatenate([part.x for part in parts]),
            np.concatenate([part.y for part in parts]),
            np.concatenate([part.p for part in parts]),
            self.width,
            self.height,
        )

    def close(self) -> None:
        """Release the file; harmless when called twice."""
        self._source.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
