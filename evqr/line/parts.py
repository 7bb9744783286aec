"""From what was seen to parts: one a gate, or, without triggers, one a code that passes.

Parts are told where records of the stream say so, or at times of events that the triggers set, so however the
stream was cut when it came, they are the same.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from evqr.clock import StageClock
from evqr.config import ReadConfig, TriggerConfig
from evqr.line.gates import Gate, Gates, Trigger
from evqr.line.history import History, Place, Sight
from evqr.line.verdict import Verdict, verdict_on
from evqr.reason import Reason
from evqr.results import CodeReading
from evqr.stream.records import CodeAgain, CodeLeft, CodeRead, CodeUnread, Searched, StreamRecord

CHECKED_US = 1_000
"""Time between two checks whether all of a gate that has closed is read [us]."""

READ_LATER_US = 20_000
"""How much later a code may be read that was followed in vain: without triggers a NO READ is told when so
much more has been searched [us]."""

KEPT_US = 200_000
"""Without triggers nothing is asked for that was longer ago [us]."""

GIVEN_PLACES = 16
"""NO READs that are kept in mind, so that a code that is followed in vain twice is told once."""


@dataclass(frozen=True)
class Part:
    """A part, before it gets its numbers.

    Attributes
    ----------
    needed_us : float [us]
        Time of the last event that it needed.
    job : str
        That it was read for.
    readings : tuple of CodeReading
        Its codes.
    gate : Gate, optional
        Of its trigger.
    verdict : Verdict, optional
        Why there are none.
    """

    needed_us: float
    job: str = ""
    readings: tuple[CodeReading, ...] = ()
    gate: Gate | None = None
    verdict: Verdict | None = None

    def fields(self) -> dict[str, Any]:
        """Return what a record says of it."""
        fields: dict[str, Any] = {"job": self.job}
        gate, readings = self.gate, self.readings
        if gate is not None:
            fields.update(trigger=gate.index, ticks=gate.ticks)
            if math.isfinite(gate.start_us):
                fields.update(t_start_us=math.floor(gate.start_us), t_end_us=math.floor(gate.closed_us))
        if readings:
            first = readings[0]
            return {
                **fields,
                "texts": tuple(reading.text for reading in readings),
                "readings": readings,
                "t_first_us": min(reading.t_first_us for reading in readings),
                "t_last_us": max(reading.t_last_us for reading in readings),
                "t_read_us": first.t_read_us,
                "windows": first.windows,
                "motion_px_per_s": first.motion_px_per_s,
                "corners_px": first.corners_px,
                "confidence": min(reading.confidence for reading in readings),
                "compute_ms": _added(readings),
            }
        assert self.verdict is not None
        fields.update(reason=str(self.verdict), reason_code=self.verdict.reason)
        if self.verdict.motion is not None:
            fields["motion_px_per_s"] = self.verdict.motion.velocity
        nearest = self.verdict.nearest
        if nearest is not None:
            fields.update(
                t_first_us=nearest.t_first_us,
                t_last_us=nearest.t_last_us,
                windows=nearest.windows,
                corners_px=nearest.target.outline(),
            )
        return fields


def _added(readings: Sequence[CodeReading]) -> dict[str, float]:
    """Give what readings took together, by stage [ms]."""
    clock = StageClock()
    for reading in readings:
        clock.add(reading.compute_ms)
    return clock.ms


class Parts(Protocol):
    """Makes parts of what becomes certain.

    Attributes
    ----------
    check_us : float [us]
        Time up to which the stream must be read before `decide` can say more.
    history : History
        What was seen lately.
    """

    history: History

    @property
    def check_us(self) -> float:
        """Time up to which the stream must be read before `decide` can say more [us]."""
        ...

    def check(self, trigger: Trigger) -> None:
        """Refuse a trigger that cannot be taken."""
        ...

    def trigger(self, trigger: Trigger, job: str) -> None:
        """Take a trigger."""
        ...

    def take(self, record: StreamRecord, job: str) -> list[Part]:
        """Take what has become certain; give the parts that are told by that."""
        ...

    def decide(self, time_us: float, settled_us: float, following: Sequence[CodeUnread]) -> list[Part]:
        """Give the parts that can be told at a time up to which all is read that can be."""
        ...

    def finish(self, end_us: float, *, goes_on: bool) -> list[Part]:
        """Give all parts that are left where the stream, or its clock, ends."""
        ...


class FreeRunning:
    """A part a code that passes: those that are read, and those that were seen clearly and are not.

    Parameters
    ----------
    cfg : ReadConfig
        What it is read with.
    size : (int, int) [px]
        Width and height of the sensor.
    """

    def __init__(self, cfg: ReadConfig, size: tuple[int, int]) -> None:
        self.history = History()
        self._cfg, self._size = cfg, size
        self._held: list[tuple[CodeUnread, str]] = []
        self._given: deque[Place] = deque(maxlen=GIVEN_PLACES)

    @property
    def check_us(self) -> float:
        """Never: records of the stream say when parts have passed [us]."""
        return math.inf

    def check(self, trigger: Trigger) -> None:
        """Refuse a trigger.

        Raises
        ------
        ValueError
            There are none here.
        """
        raise ValueError(f"triggers must be set where there are any, got a {trigger.kind.value} trigger")

    def trigger(self, trigger: Trigger, job: str) -> None:
        """Do nothing: none was let through."""

    def take(self, record: StreamRecord, job: str) -> list[Part]:
        """Take what has become certain; give the parts that are told by that."""
        sight = self.history.take(record)
        if isinstance(record, CodeAgain) and sight is not None:
            sight.given = True  # it was, when it left
        elif isinstance(record, CodeLeft) and sight is not None and not sight.given:
            sight.given = True
            return [Part(record.t_last_us, job, (sight.until(record.t_last_us),))]
        elif isinstance(record, CodeUnread) and record.agrees(self._cfg.align.good_score):
            self._hold(record, job)
        elif isinstance(record, Searched):
            return self._passed(record.start_us)
        return []

    def _hold(self, unread: CodeUnread, job: str) -> None:
        """Keep a code that may be read yet, once."""
        place = Place.of(unread)
        self._held = [one for one in self._held if not Place.of(one[0]).is_at(place)]
        self._held.append((unread, job))

    def _passed(self, searched_us: float) -> list[Part]:
        """Give those that were held and will not be read any more, now that a later time is searched."""
        due = [one for one in self._held if one[0].t_last_us + READ_LATER_US <= searched_us]
        self._held = [one for one in self._held if one not in due]
        parts = [part for unread, job in due for part in self._given_once(unread, job)]
        first_us = min((one.t_first_us for one, _ in self._held), default=searched_us)
        self.history.forget(first_us - KEPT_US, self._cfg.scheduler.remembered_codes)
        return parts

    def decide(self, time_us: float, settled_us: float, following: Sequence[CodeUnread]) -> list[Part]:
        """Give nothing: all was said when records of the stream came."""
        return []

    def _given_once(self, unread: CodeUnread, job: str) -> list[Part]:
        place = Place.of(unread)
        read = [Place.of(sight.reading) for sight in self.history.sights]
        if any(place.is_at(other) for other in (*read, *self._given)):
            return []
        self._given.append(place)
        return [Part(unread.t_last_us, job, verdict=verdict_on([unread], [], self._size, self._cfg))]

    def finish(self, end_us: float, *, goes_on: bool) -> list[Part]:
        """Give all parts that are left where the stream, or its clock, ends."""
        held, self._held = self._held, []
        parts = [part for unread, of in held for part in self._given_once(unread, of)]
        self.history = History()
        self._given.clear()
        return parts


class Triggered:
    """A part a trigger, whatever passes.

    Parameters
    ----------
    triggers : TriggerConfig
        Of which times triggers ask.
    cfg : ReadConfig
        What it is read with.
    size : (int, int) [px]
        Width and height of the sensor.
    """

    def __init__(self, triggers: TriggerConfig, cfg: ReadConfig, size: tuple[int, int]) -> None:
        self.history = History()
        self._triggers, self._cfg, self._size = triggers, cfg, size
        self._gates = Gates(triggers)

    @property
    def check_us(self) -> float:
        """Time up to which the stream must be read before `decide` can say more [us]."""
        return min((gate.check_us for gate in self._gates.waiting), default=math.inf)

    def check(self, trigger: Trigger) -> None:
        """Refuse a trigger that cannot be taken."""
        self._gates.check(trigger)

    def trigger(self, trigger: Trigger, job: str) -> None:
        """Take a trigger."""
        self._gates.take(trigger, job)

    def take(self, record: StreamRecord, job: str) -> list[Part]:
        """Take what has become certain; give the parts that are told by that."""
        self.history.take(record)
        if isinstance(record, Searched):
            self._forget(record.start_us)
        most = self._triggers.until_codes
        if most is None or not isinstance(record, CodeRead):
            return []
        now_us = record.reading.t_read_us
        full = [
            gate
            for gate in self._gates.waiting
            if len({sight.code for sight in self._sights_of(gate, now_us)}) >= most
        ]
        return [self._part_of(gate, now_us, now_us, ()) for gate in full]

    def decide(self, time_us: float, settled_us: float, following: Sequence[CodeUnread]) -> list[Part]:
        """Give the parts that can be told at a time up to which all is read that can be."""
        parts = []
        for gate in [gate for gate in self._gates.waiting if gate.check_us <= time_us]:
            late_us = gate.closed_us + self._triggers.deadline_us
            if settled_us >= gate.closed_us or time_us >= late_us:
                parts.append(self._part_of(gate, time_us, settled_us, following))
            else:
                gate.check_us = min(time_us + CHECKED_US, late_us)
        return parts

    def _forget(self, searched_us: float) -> None:
        """Keep what gates ask for, and those of triggers that may still come."""
        late_us = searched_us - self._triggers.lateness_us - self._triggers.before_us
        asked_us = [min(gate.trigger_us, gate.opened_us) for gate in self._gates.waiting]
        self.history.forget(min([late_us, *asked_us]), self._cfg.scheduler.remembered_codes)

    def finish(self, end_us: float, *, goes_on: bool) -> list[Part]:
        """Give all parts that are left where the stream ends, or its clock; then what is ahead stays."""
        last_us = end_us + self._triggers.lateness_us if goes_on else math.inf
        ended = [gate for gate in self._gates.waiting if gate.trigger_us <= last_us]
        parts = [self._part_of(gate, end_us, math.inf, ()) for gate in ended]
        self.history = History()
        return parts

    def _part_of(
        self, gate: Gate, time_us: float, settled_us: float, following: Sequence[CodeUnread]
    ) -> Part:
        """Tell a gate's part."""
        sights = self._sights_of(gate, time_us)
        self._gates.waiting.remove(gate)
        for sight in sights:
            sight.given, sight.gate = True, gate
        readings = _each_once(sights, min(time_us, gate.closed_us))
        if readings:
            return Part(time_us, gate.job, readings, gate)
        return Part(time_us, gate.job, (), gate, self._verdict(gate, time_us, settled_us, following))

    def _sights_of(self, gate: Gate, now_us: float) -> list[Sight]:
        """Give the codes of a gate: those that were seen in it, and nearer to its middle than to others'."""

        def off_us(other: Gate, first_us: float, last_us: float) -> float:
            if other.shared_us(first_us, last_us) <= 0.0:
                return math.inf
            return abs(other.opened_us + min(other.closed_us, now_us) - first_us - last_us)

        found = []
        for sight in self.history.sights:
            first_us, last_us = sight.first_us, max(min(sight.last_us, now_us), sight.first_us + 1)
            if not sight.given and sight.reading.t_read_us <= now_us:
                nearest = min(self._gates.waiting, key=lambda each: off_us(each, first_us, last_us))
                if nearest is gate and math.isfinite(off_us(gate, first_us, last_us)):
                    found.append(sight)
        return found

    def _verdict(
        self, gate: Gate, time_us: float, settled_us: float, following: Sequence[CodeUnread]
    ) -> Verdict:
        """Tell why nothing was read in a gate."""
        history, start_us, end_us = self.history, gate.opened_us, gate.closed_us
        if time_us <= start_us and math.isinf(settled_us):
            return Verdict(Reason.RECORDING_ENDS, f"at {time_us:.0f} us, before the gate opens")
        searches = history.searches_in(start_us, end_us)
        unread = history.unread_in(start_us, end_us, following)
        verdict = verdict_on(unread, searches, self._size, self._cfg)
        if verdict.nearest is not None and verdict.nearest.agrees(self._cfg.align.good_score):
            return verdict
        if start_us < history.forgotten_us:
            late = f"{history.forgotten_us - start_us:.0f} us later than lateness_us allows"
            return Verdict(Reason.TRIGGER_LATE, late, verdict.nearest, verdict.motion)
        others = [
            sight.gate
            for sight in history.sights
            if sight.gate is not None and gate.shared_us(sight.first_us, min(sight.last_us, time_us)) > 0.0
        ]
        if others:
            detail = f"that of trigger {others[-1].index}"
            return Verdict(Reason.OTHER_PART, detail, verdict.nearest, verdict.motion)
        if history.skipped_in(start_us, end_us):
            return Verdict(Reason.OVERLOAD, "searches were skipped", verdict.nearest, verdict.motion)
        if settled_us < end_us and math.isfinite(settled_us):
            detail = f"searched up to {settled_us:.0f} us, the gate closed at {end_us:.0f} us"
            return Verdict(Reason.DEADLINE, detail, verdict.nearest, verdict.motion)
        return verdict


def _each_once(sights: Sequence[Sight], until_us: float) -> tuple[CodeReading, ...]:
    """Give the codes that were seen, each once, though it was lost from sight and came again."""
    readings: dict[int, CodeReading] = {}
    for sight in sights:
        reading = sight.until(until_us)
        before = readings.get(sight.code)
        readings[sight.code] = (
            reading if before is None else replace(before, t_last_us=max(before.t_last_us, reading.t_last_us))
        )
    return tuple(readings.values())


def parts_for(triggers: TriggerConfig | None, cfg: ReadConfig, size: tuple[int, int]) -> Parts:
    """Give what makes parts: by triggers where there are any.

    Parameters
    ----------
    triggers : TriggerConfig or None
        Of which times triggers ask.
    cfg, size : as of `Triggered`
        The same.

    Returns
    -------
    parts : Parts
        New ones.
    """
    return FreeRunning(cfg, size) if triggers is None else Triggered(triggers, cfg, size)
