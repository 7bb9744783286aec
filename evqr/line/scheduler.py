"""What a reader of a line does, with the work left to who runs it: for one line, or for many at once.

A shell around the scheduler that `read_codes` uses: what is read is the same, and does not depend on how the
stream is cut.  Memory is bounded by what the settings ask for: events of the longest window and of the bound
on disorder, what was seen since the oldest gate that waits, or since a trigger may still come, and a fixed
number of codes that may return.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from evqr.config import JobConfig, TriggerConfig
from evqr.errors import RecordingError
from evqr.events.array import EventArray
from evqr.events.packed import PackedEvents, unpacked
from evqr.line.gates import Trigger
from evqr.line.history import Skipped
from evqr.line.hot_pixels import HotPixels
from evqr.line.match import Rule
from evqr.line.pace import Pace
from evqr.line.parts import Part, parts_for
from evqr.line.records import (
    ClockRecord,
    GapRecord,
    LineRecord,
    OverloadRecord,
    PartRecord,
    ReadRecord,
)
from evqr.reason import Reason
from evqr.recording import TimeUnit
from evqr.recording.arrays import open_arrays
from evqr.recording.clock import MAX_DISORDER_US, Reset
from evqr.recording.declared import DeclaredUnit
from evqr.recording.live import Incoming, LiveIntake
from evqr.recording.options import Asked
from evqr.recording.source import RawColumns
from evqr.results import CodeReading
from evqr.seen import Statistics
from evqr.solver import Solver
from evqr.stream.records import CodeRead, StreamRecord
from evqr.stream.scheduler import StreamScheduler
from evqr.symbol.messages import Message, join_messages
from evqr.work import Working

NAME = "events"
"""What messages call a source that has no name."""

APPENDED = 64
"""Parts of messages that are kept in mind: a message has 16 at most."""


class LineScheduler:
    """Makes records of a stream that comes bit by bit; calls, but for `trigger`, are those of one thread.

    Parameters
    ----------
    solver : Solver
        Whose settings count.
    size : (int, int) [px]
        Width and height of the sensor.
    triggers : TriggerConfig or None
        Of which times triggers ask.
    jobs, time_unit, line, camera, sequence : as of `Reader`
        The same.

    Attributes
    ----------
    arrived_s : (float, float), optional [s]
        When what comes next was here, by `time.monotonic` and `time.time`. Default: when it is given.
    """

    def __init__(
        self,
        solver: Solver,
        size: tuple[int, int],
        triggers: TriggerConfig | None,
        *,
        jobs: Mapping[str, JobConfig] | None,
        time_unit: TimeUnit,
        line: str,
        camera: str,
        sequence: int,
    ) -> None:
        self.arrived_s: tuple[float, float] | None = None
        self._size = size
        self._unit: TimeUnit = time_unit
        self._rules = {name: Rule(cfg) for name, cfg in (jobs or {}).items()}
        self._solver = solver
        self._config = solver.config
        self._parts = parts_for(triggers, self._config, size)
        self._identity = {"line": line, "camera": camera}
        self._sequence, self._part, self._epoch = sequence, 0, 0
        self._codes = self._codes_before = 0
        self._job = ""
        self._lateness_us = 0 if triggers is None else triggers.lateness_us
        self._triggers: deque[tuple[Trigger, str]] = deque()
        self._odd: list[tuple[Trigger, str, int]] = []
        least_hz = self._config.line.hot_pixel_hz
        self._hot = None if least_hz is None else HotPixels(*size, least_hz)
        self._pace = Pace()
        self._records: list[LineRecord] = []
        self._before = Statistics()
        self._appended: deque[CodeReading] = deque(maxlen=APPENDED)
        self._skipped: Skip | None = None
        self._intake = LiveIntake(
            camera or NAME, size, unit=time_unit, disorder_us=self._config.line.disorder_us
        )
        self._begin()

    def _begin(self) -> None:
        """Begin with a clock of the source."""
        self._stream = StreamScheduler([self._solver], *self._size)
        self._newest_us: int | None = None

    # ---- what comes in: as of `Reader`

    def pushing(self, events: Any) -> Working[list[LineRecord]]:
        """Take the next events."""
        self._enter()
        dropped = self._intake.faults.left_out
        raw = self._columns(events)
        if len(raw.t):
            for incoming in self._intake.push(raw):
                yield from self._take(incoming)
        self._tell_dropped(self._intake.faults.left_out - dropped)
        return (yield from self._go_on())

    def advancing(self, t_us: int) -> Working[list[LineRecord]]:
        """Let time pass."""
        self._enter()
        for incoming in self._intake.advance(t_us):
            yield from self._take(incoming)
        if self._newest_us is not None:
            self._newest_us = max(self._newest_us, t_us)
        return (yield from self._go_on())

    def closing(self) -> Working[list[LineRecord]]:
        """Take the stream as ended."""
        self._enter()
        for incoming in self._intake.finish():
            yield from self._take(incoming)
        self._take_odd()
        yield from self._advance()
        yield from self._end_clock(goes_on=False)
        return self._given()

    def interrupt(self, reason: str) -> list[LineRecord]:
        """Say that the source was lost."""
        self._enter()
        now_us = self._intake.known_us or 0
        self._tell(
            GapRecord, needed_us=math.inf, t_from_us=now_us, t_to_us=now_us,
            reason=Reason.INTERRUPTED.explained(reason), reason_code=Reason.INTERRUPTED,
        )  # fmt: skip
        return self._given()

    def trigger(self, trigger: Trigger) -> None:
        """Take a trigger."""
        self._parts.check(trigger)
        self._triggers.append((trigger, self._job))

    def use(self, job: str) -> None:
        """Change what is expected."""
        if job and job not in self._rules:
            raise ValueError(f"job must be one of {', '.join(self._rules) or 'none'}, got {job!r}")
        self._job = job

    @property
    def known_us(self) -> int:
        """Time up to which all events are here [us]."""
        return self._intake.known_us or 0

    @property
    def hot_pixels(self) -> list[tuple[int, int]]:
        """Column and row of the pixels whose events are left out, since they fire all the time [px]."""
        return [] if self._hot is None else self._hot.pixels

    @property
    def statistics(self) -> Statistics:
        """What has been done so far, over all clocks of the source."""
        now = self._stream.statistics
        return Statistics(**{name: count + now[name] for name, count in self._before.items()})

    # ---- one after another

    def _enter(self) -> None:
        self._pace.came(self.arrived_s)
        known_us = self._intake.known_us
        while self._triggers:
            trigger, job = self._triggers.popleft()
            if known_us is not None and trigger.t_us < known_us - self._lateness_us:
                # it may be of a clock that was reset, which the events have not shown yet
                self._odd.append((trigger, job, known_us + 2 * MAX_DISORDER_US))
            else:
                self._parts.trigger(trigger, job)
        self._take_odd(known_us)

    def _take_odd(self, known_us: int | None = None) -> None:
        """Take triggers that seemed to be too late, once they have waited, or all of them."""
        waiting = self._odd
        self._odd = [] if known_us is None else [each for each in waiting if each[2] > known_us]
        for trigger, job, until_us in waiting:
            if known_us is None or until_us <= known_us:
                self._parts.trigger(trigger, job)

    def _columns(self, events: Any) -> RawColumns:
        """Give events of any kind as columns, in the unit that the intake expects."""
        if isinstance(events, PackedEvents):
            return RawColumns(*unpacked(events, self._intake.known_us or 0))
        self._intake.unit = "us"
        if isinstance(events, EventArray):
            if (events.width, events.height) != self._size:
                size = "{}x{}".format(*self._size)
                raise RecordingError(f"events must be of a sensor {size}, got {events.width}x{events.height}")
            return RawColumns(events.t, events.x, events.y, events.p)
        if isinstance(events, RawColumns):
            return events
        source = open_arrays(events, Asked(sensor=self._size))
        declared = source.unit
        self._intake.unit = declared.unit if isinstance(declared, DeclaredUnit) else self._unit
        return next(source.raw_chunks(max(1, source.n_events or 0), self._intake.faults), NOTHING)

    def _take(self, incoming: Incoming) -> Working[None]:
        if isinstance(incoming, Reset):
            yield from self._change_clock(incoming)
            return
        for silence_us, events in self._between_silences(incoming):
            if silence_us:
                yield from self._advance()
                first_us = int(events.t[0])
                self._tell(
                    GapRecord, needed_us=first_us, t_from_us=first_us - silence_us, t_to_us=first_us,
                    reason=Reason.SILENCE.explained(),
                )  # fmt: skip
            if len(events):
                for kept in [events] if self._hot is None else self._hot.without(events):
                    self._stream.push(kept)
                self._newest_us = int(events.t[-1])

    def _between_silences(self, events: EventArray) -> Iterator[tuple[int, EventArray]]:
        """Give events up to each long silence, and how long that before them was, 0 for none [us]."""
        silence_us, first, before_us = self._config.line.silence_us, 0, 0
        newest_us = int(events.t[0]) if self._newest_us is None else self._newest_us
        if int(events.t[-1]) - newest_us > silence_us:
            steps = np.diff(events.t, prepend=newest_us)
            for at in np.flatnonzero(steps > silence_us).tolist():
                yield before_us, events.cut(first, at)
                first, before_us = at, int(steps[at])
        yield before_us, events.cut(first, len(events))

    def _tell_dropped(self, dropped: int) -> None:
        if dropped:
            now_us = self._newest_us or 0
            self._tell(
                GapRecord, needed_us=now_us, t_from_us=now_us, t_to_us=now_us, dropped=dropped,
                reason=Reason.EVENTS_DROPPED.explained(), reason_code=Reason.EVENTS_DROPPED,
            )  # fmt: skip

    def _go_on(self) -> Working[list[LineRecord]]:
        """Read what can be, and give what has become certain."""
        known_us = self._intake.known_us
        if known_us is not None:
            self._pace.reach(known_us)
            self._skip(known_us)
            yield from self._advance(known_us)
        return self._given()

    def _given(self) -> list[LineRecord]:
        records, self._records = self._records, []
        return records

    def _advance(self, until_us: int | None = None) -> Working[None]:
        """Read up to a time, and tell the parts that are due on the way; default: of the newest event."""
        until_us = self._newest_us if until_us is None else until_us
        if until_us is None:
            return
        while (check_us := self._parts.check_us) <= until_us:
            yield from self._step(math.ceil(check_us))
            stream = self._stream
            for part in self._parts.decide(check_us, stream.settled_us, stream.unread):
                self._tell_part(part)
        yield from self._step(until_us)

    def _step(self, until_us: int) -> Working[None]:
        for record in (yield from self._stream.stepping(until_us)):
            self._note(record)

    def _note(self, record: StreamRecord) -> None:
        """Tell what a record of the stream says."""
        if isinstance(record, CodeRead):
            self._codes = self._codes_before + record.code + 1
            reading = record.reading
            self._tell(
                ReadRecord, needed_us=reading.t_read_us, code=self._codes - 1, reading=reading,
                message=self._message_of(reading),
            )  # fmt: skip
        for part in self._parts.take(record, self._job):
            self._tell_part(part)

    def _message_of(self, reading: CodeReading) -> Message | None:
        """Put the message together that a code is a part of."""
        if reading.structured_append is None:
            return None
        self._appended.append(reading)
        messages = join_messages(self._appended)
        return next(
            (each for each in messages if any(part.same_content(reading) for part in each.parts)), None
        )

    def _end_clock(self, *, goes_on: bool) -> Working[None]:
        """Do what is left to do of an epoch, and tell the parts that are."""
        for record in (yield from self._stream.closing()):
            self._note(record)
        end_us = self._intake_end_us()
        for part in self._parts.finish(end_us, goes_on=goes_on):
            self._tell_part(part)
        self._end_skipping(end_us)

    def _intake_end_us(self) -> int:
        return max(self._newest_us or 0, self._intake.known_us or 0)

    def _change_clock(self, reset: Reset) -> Working[None]:
        """Begin a new epoch."""
        yield from self._advance()
        yield from self._end_clock(goes_on=True)
        self._before = self.statistics
        self._codes_before = self._codes
        self._begin()
        self._pace.begin()
        self._epoch += 1
        self._take_odd()
        self._tell(ClockRecord, needed_us=math.inf, t_before_us=reset.before_us, t_after_us=reset.after_us)

    # ---- too much to do

    def _skip(self, known_us: int) -> None:
        """Search nothing while reading is too far behind the events, until half of that is made up for."""
        most_us = self._config.line.behind_us
        if most_us is None:
            return
        behind_us = self._pace.behind_us()
        if self._skipped is None and behind_us > most_us:
            self._skipped = Skip(known_us, 0, behind_us)
        if self._skipped is None:
            return
        if behind_us <= most_us / 2.0:
            self._end_skipping(known_us)
            return
        first_us, windows, worst_us = self._skipped
        windows += self._stream.skip(known_us)
        self._skipped = Skip(first_us, windows, max(worst_us, behind_us))
        self._parts.history.skipped.append(Skipped(first_us, known_us))

    def _end_skipping(self, until_us: int) -> None:
        skipped, self._skipped = self._skipped, None
        if skipped is not None:
            self._tell(
                OverloadRecord, needed_us=until_us, t_from_us=skipped.first_us, t_to_us=until_us,
                windows=skipped.windows, behind_ms=1e-3 * skipped.worst_us,
            )  # fmt: skip

    # ---- records

    def _tell(self, kind: type[LineRecord], *, needed_us: float, **fields: Any) -> None:
        """Make a record."""
        t_utc, latency_ms = self._pace.since(needed_us)
        record = kind(
            sequence=self._sequence, epoch=self._epoch, t_utc=t_utc, latency_ms=latency_ms,
            **self._identity, **fields,
        )  # fmt: skip
        self._sequence += 1
        self._records.append(record)

    def _tell_part(self, part: Part) -> None:
        """Make the record of a part."""
        fields = part.fields()
        rule = self._rules.get(part.job)
        if rule is not None:
            mismatch = rule.mismatch(part.readings)
            fields["matches"] = not mismatch
            if mismatch and part.readings:
                fields.update(reason=Reason.NO_MATCH.explained(mismatch), reason_code=Reason.NO_MATCH)
        self._tell(PartRecord, needed_us=part.needed_us, part=self._part, **fields)
        self._part += 1


class Skip(NamedTuple):
    """A time in which searches are skipped, that has not ended.

    Attributes
    ----------
    first_us : int [us]
        When it began.
    windows : int
        Searches that were skipped.
    worst_us : float [us]
        How far behind reading was at most.
    """

    first_us: int
    windows: int
    worst_us: float


NOTHING = RawColumns(*(np.empty(0, np.int64) for _ in range(4)))
"""No events."""
