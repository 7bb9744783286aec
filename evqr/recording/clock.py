"""What the clock of a recording did: stamps that stand alone, and clocks that were reset.

Consecutive stamps that differ by more than `MAX_DISORDER_US` break a recording into runs.  A run that goes on
where the last left off is trusted.  One that lies elsewhere waits: when the clock comes back to where it was,
those were stray stamps, which are left out; when it does not for as long as `MAX_DISORDER_US` and
`FEW_EVENTS`, a run behind is a clock that was reset, and a run ahead follows a silence.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from evqr.events.array import EventArray

from .faults import Faults

MAX_DISORDER_US = 50_000
"""How far the clock may jump back within a recording's ordinary disorder, which is sorted."""

FEW_EVENTS = 16
"""Fewer than this are stray, and no clock of their own."""

EPOCH_GAP_US = 2 * MAX_DISORDER_US
"""What is put between a clock's last stamp and the first after its reset; the true time is not known."""


class ClockWatch:
    """Passes events on in the order of arrival, less those with stray stamps; reset clocks go on rising.

    What waits is bounded by what a sensor fires within `MAX_DISORDER_US`.
    """

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._newest: int | None = None  # of the trusted events
        self._shift_us = 0
        self._arrived = 0
        self._waiting: list[EventArray] = []
        self._waiting_events = self._waiting_from = 0
        self._waiting_newest = -1

    def push(self, events: EventArray) -> list[EventArray]:
        """Take the next events of the file, not empty; return those that can be trusted by now."""
        if self._shift_us:
            events = _shifted(events, self._shift_us)
        t = events.t
        steps = np.diff(t)
        even = not steps.size or (steps.max() <= MAX_DISORDER_US and steps.min() >= -MAX_DISORDER_US)
        if even and not self._waiting and self._goes_on(int(t[0])):
            self._newest = max(int(t.max()), self._newest or 0)
            self._arrived += len(t)
            return [events]
        ready: list[EventArray] = []
        edges = [0, *(np.flatnonzero(np.abs(steps) > MAX_DISORDER_US) + 1).tolist(), len(t)]
        shift_us = self._shift_us
        for first, last in pairwise(edges):
            # a reset may have been found among the runs before
            self._take(_shifted(events.cut(first, last), self._shift_us - shift_us), ready)
        return ready

    def finish(self) -> list[EventArray]:
        """Return what still waits at the end of the file."""
        ready: list[EventArray] = []
        if self._waiting and (self._ahead() or self._waiting_events >= FEW_EVENTS):
            self._trust_waiting(ready)
        elif self._waiting:
            self._drop_waiting()
        return ready

    def _goes_on(self, stamp: int) -> bool:
        return self._newest is not None and abs(stamp - self._newest) <= MAX_DISORDER_US

    def _take(self, run: EventArray, ready: list[EventArray]) -> None:
        shift_us = self._shift_us
        if self._waiting:
            self._settle_waiting(int(run.t[0]), ready)
            run = _shifted(run, self._shift_us - shift_us)
        if not self._waiting and self._goes_on(int(run.t[0])):
            self._newest = max(int(run.t.max()), self._newest or 0)
            ready.append(run)
        else:
            self._wait(run, ready)
        self._arrived += len(run)

    def _settle_waiting(self, stamp: int, ready: list[EventArray]) -> None:
        """Decide on what waits, if the next stamp tells."""
        back = stamp < self._waiting_newest - MAX_DISORDER_US
        home = self._newest is None or stamp >= self._newest - MAX_DISORDER_US
        many = self._waiting_events >= FEW_EVENTS
        if home and (back or not self._ahead()):
            # The clock is where it was.  With nothing before, the few first events were stray.
            if self._newest is None and many:
                self._trust_waiting(ready)
            else:
                self._drop_waiting()
        elif back and many:
            self._trust_waiting(ready)
        elif back:
            self._drop_waiting()

    def _wait(self, run: EventArray, ready: list[EventArray]) -> None:
        if not self._waiting:
            behind = self._newest is not None and run.t[0] < self._newest
            if behind and self._faults.strict:
                self._faults.leave_out(len(run), self._jump_to(int(run.t[0]), self._arrived), _ADVICE)
            self._waiting_from, self._waiting_events, self._waiting_newest = self._arrived, 0, -1
        self._waiting.append(run)
        self._waiting_events += len(run)
        self._waiting_newest = max(self._waiting_newest, int(run.t.max()))
        lasted_us = self._waiting_newest - int(self._waiting[0].t[0])
        if self._waiting_events >= FEW_EVENTS and lasted_us > MAX_DISORDER_US:
            self._trust_waiting(ready)

    def _ahead(self) -> bool:
        return self._newest is None or int(self._waiting[0].t[0]) > self._newest

    def _trust_waiting(self, ready: list[EventArray]) -> None:
        parts, self._waiting = self._waiting, []
        stamp = int(parts[0].t[0])
        if self._newest is not None and stamp < self._newest:
            shift_us = self._newest + EPOCH_GAP_US - min(int(part.t.min()) for part in parts)
            before, after = self._newest - self._shift_us, stamp - self._shift_us
            self._shift_us += shift_us
            problem = f"from {before} us to {after} us at event {self._waiting_from:,}"
            self._faults.new_epoch(problem, self._shift_us)
            parts = [_shifted(part, shift_us) for part in parts]
        self._newest = max(self._newest or 0, *(int(part.t.max()) for part in parts))
        ready.extend(parts)

    def _drop_waiting(self) -> None:
        parts, self._waiting = self._waiting, []
        stamp, event = int(parts[0].t[0]), self._waiting_from
        ahead = self._newest is None or stamp > self._newest
        problem = f"time {stamp} us of event {event:,} is far ahead of those around it"
        self._faults.leave_out(
            self._waiting_events, problem if ahead else self._jump_to(stamp, event), _ADVICE
        )

    def _jump_to(self, stamp: int, event: int) -> str:
        return f"times jump back by {(self._newest or 0) - stamp:,} us to {stamp} us at event {event:,}"


_ADVICE = f"up to {MAX_DISORDER_US:,} us are sorted, more is refused: cut the recording there"


def _shifted(events: EventArray, shift_us: int) -> EventArray:
    if not shift_us:
        return events
    return EventArray(events.t + shift_us, events.x, events.y, events.p, events.width, events.height)
