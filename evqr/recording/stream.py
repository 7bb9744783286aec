"""`Recording`: one source of events, checked, converted and in order, a chunk at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from types import TracebackType

import numpy as np

from evqr.events.array import EventArray

from ..errors import RecordingError
from .columns import ColumnChecker, check_sensor, check_times
from .ordering import Disorder, in_order
from .source import DeclaredUnit, RawColumns, Source, TimeUnit
from .time_unit import PER_SECOND, decide_time_unit

SAMPLE_EVENTS = 1 << 16  # the unit of time is judged by so many first events


class Recording:
    """Events of one recording, streamed; a context manager.  Made by `open_recording`.

    Attributes
    ----------
    path : str                        "" for arrays
    format : str                      in words, such as "HDF5 events/{t,x,y,p}"
    width, height : int [px]          sensor size
    n_events : int | None             None until known
    t_first_us, t_last_us : int|None  first and last time stamp [us]; None until streamed, but the last is
                                      known at once where the source can look at its end
    time_unit, time_unit_reason : str unit of the stored stamps, and how it is known
    warnings : list[str]              what was odd; grows while streaming
    """

    def __init__(
        self,
        source: Source,
        *,
        path: str,
        sensor: tuple[int, int] | None,
        time_unit: TimeUnit | None,
        chunk_events: int,
    ) -> None:
        self._source = source
        self._chunk_events = chunk_events
        self.path = path
        self.format = source.format
        self.n_events = source.n_events
        self.t_first_us: int | None = None
        self.t_last_us: int | None = None
        self.warnings: list[str] = []

        # The first chunk of a vendor file may hold nothing but trigger words.
        with closing(source.raw_chunks(SAMPLE_EVENTS)) as raw_chunks:
            first = next((raw for raw in raw_chunks if len(raw.t)), None)
        if first is None:
            raise RecordingError(f"{source.name}: the recording is empty: {source.format} with 0 events")
        self.width, self.height = check_sensor(sensor or source.sensor, source.name)
        if sensor is not None and source.sensor not in (None, sensor):
            told = f"{source.sensor[0]}x{source.sensor[1]}"
            self.warnings.append(
                f"the file says the sensor is {told}; {self.width}x{self.height} was asked for"
            )
        check_times(first.t, source.name)
        unit = self._unit(first, time_unit)
        self.time_unit: TimeUnit = unit.unit
        self.time_unit_reason = unit.reason
        if first.t.dtype == np.float32:
            step_us = float(np.spacing(first.t.max())) * 1e6 / PER_SECOND[self.time_unit]
            if step_us > 1:
                self.warnings.append(
                    f"times are stored as float32, which tells no less than {step_us:.2g} us apart"
                )

        tail = source.raw_tail(SAMPLE_EVENTS)
        if tail is not None:
            checker = self._checker(seen=(self.n_events or 0) - len(tail.t))
            self.t_last_us = int(checker(tail).t.max())

    def _checker(self, *, seen: int = 0) -> ColumnChecker:
        source = self._source
        sensor = self.width, self.height
        return ColumnChecker(source.name, sensor, self.time_unit, source.t_offset_us, seen=seen)

    def _unit(self, first: RawColumns, asked: TimeUnit | None) -> DeclaredUnit:
        declared = self._source.unit
        if asked is not None:
            if declared is not None and declared.unit != asked:
                self.warnings.append(f"times are taken as {asked} as asked, though {declared.reason}")
            return DeclaredUnit(asked, "as asked")
        if declared is not None:
            return declared
        return decide_time_unit(first.t, (self.width, self.height), self._source.name)

    def chunks(self) -> Iterator[EventArray]:
        """Yield all events, ascending in time also across chunks, about ``chunk_events`` at a time.

        Memory is bounded by the chunk and by what the sensor fires within `ordering.MAX_DISORDER_US`.  Can be
        called again for another pass.

        Raises
        ------
        RecordingError   at the first event that is wrong
        """
        name, checker, disorder = self._source.name, self._checker(), Disorder()
        last = None
        with closing(self._source.raw_chunks(self._chunk_events)) as raw_chunks:
            checked = (checker(raw) for raw in raw_chunks if len(raw.t))
            for chunk in in_order(checked, self._chunk_events, disorder, name):
                if last is None:
                    self.t_first_us = int(chunk.t[0])
                last = int(chunk.t[-1])
                yield chunk
        self.n_events = checker.seen
        self.t_last_us = last
        if disorder.late_events:
            self._warn_once(
                f"{disorder.late_events:,} events out of order by up to {disorder.worst_us:,} us were sorted"
            )

    def _warn_once(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)

    def read(self) -> EventArray:
        """All events at once."""
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
