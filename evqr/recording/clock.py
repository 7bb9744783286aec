"""What the clock of a recording did: stamps that stand alone, and clocks that were reset.

A stamp within `MAX_DISORDER_US` of the newest before it goes on where the recording is.  Others wait: when
the clock comes back to where it was, they were stray, and are left out; when it stays where they are for
`MAX_DISORDER_US` and `FEW_EVENTS`, then those behind are of a clock that was reset, and those ahead follow a
silence.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray

from .faults import Faults

MAX_DISORDER_US = 50_000
"""How far the clock may jump back within a recording's ordinary disorder, which is sorted."""

FEW_EVENTS = 16
"""Fewer than this are stray, and no clock of their own."""

EPOCH_GAP_US = 2 * MAX_DISORDER_US
"""What is put between a clock's last stamp and the first after its reset; the true time is not known."""

_NEVER = int(np.iinfo(np.int64).max)


class Reset(NamedTuple):
    """A clock that was reset.

    Attributes
    ----------
    before_us, after_us : int [us]
        The clock's last time before it, and its first one after it.
    shift_us : int [us]
        How much later times from there on are put.
    """

    before_us: int
    after_us: int
    shift_us: int


class ClockWatch:
    """Passes events on in the order of arrival, less those with stray stamps; reset clocks go on rising.

    What waits is bounded by what a sensor fires within `MAX_DISORDER_US`.

    Parameters
    ----------
    faults : Faults
        Is told of stray stamps and of resets.
    ahead_us : int [us]
        How long what follows a silence must last before it is trusted; of live events, which should not wait,
        that they are `FEW_EVENTS` is enough.

    Attributes
    ----------
    resets : list of Reset
        So far, in order; who works on them may clear it.
    """

    def __init__(self, faults: Faults, *, ahead_us: int = MAX_DISORDER_US) -> None:
        self.resets: list[Reset] = []
        self._faults = faults
        self._ahead_us = ahead_us
        self._newest: int | None = None  # of the trusted events
        self._shift_us = 0
        self._arrived = 0
        self._waiting: list[EventArray] = []
        self._waiting_events = self._waiting_from = 0
        self._waiting_newest = -1
        self._home_us = _NEVER  # from when on the clock is back where it was, if what waits is behind

    def push(self, events: EventArray) -> list[EventArray]:
        """Take the next events of the file, not empty; return those that can be trusted by now."""
        ready: list[EventArray] = []
        shift_us = 0
        while len(events):
            # A clock that was reset is put later: also what comes after in the same chunk.
            events, shift_us = _shifted(events, self._shift_us - shift_us), self._shift_us
            stamp = int(events.t[0])
            if self._waiting and not self._near(stamp):
                self._settle_waiting(stamp, ready)
                if self._shift_us != shift_us:
                    continue
            if self._waiting or not self._near(stamp):
                count = self._wait(events, ready)
            else:
                assert self._newest is not None
                count = _even(events.t, self._newest)
                self._newest = max(self._newest, int(events.t[:count].max()))
                ready.append(events.cut(0, count))
            self._arrived += count
            events = events.cut(count, len(events))
        return ready

    def finish(self) -> list[EventArray]:
        """Return what still waits at the end of the file."""
        ready: list[EventArray] = []
        if self._waiting and (self._ahead() or self._waiting_events >= FEW_EVENTS):
            self._trust_waiting(ready)
        elif self._waiting:
            self._drop_waiting()
        return ready

    def _near(self, stamp: int) -> bool:
        """Whether a stamp goes on with what waits, or else with what is trusted."""
        if self._waiting:
            return abs(stamp - self._waiting_newest) <= MAX_DISORDER_US and stamp < self._home_us
        return self._newest is not None and abs(stamp - self._newest) <= MAX_DISORDER_US

    def _settle_waiting(self, stamp: int, ready: list[EventArray]) -> None:
        """Decide on what waits, if the next stamp, which does not go on with it, tells."""
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

    def _wait(self, events: EventArray, ready: list[EventArray]) -> int:
        """Let the first of some events wait; return how many."""
        stamp = int(events.t[0])
        if not self._waiting:
            if self._faults.strict and self._newest is not None and stamp < self._newest:
                self._faults.leave_out(1, self._jump_to(stamp, self._arrived), _ADVICE)
            self._waiting_from, self._waiting_events, self._waiting_newest = self._arrived, 0, stamp
            behind = self._newest is not None and stamp < self._newest
            self._home_us = (self._newest or 0) - MAX_DISORDER_US if behind else _NEVER
        count = _even(events.t, max(self._waiting_newest, stamp), self._home_us)
        self._waiting.append(events.cut(0, count))
        self._waiting_events += count
        self._waiting_newest = max(self._waiting_newest, int(events.t[:count].max()))
        lasted_us = self._waiting_newest - int(self._waiting[0].t[0])
        enough_us = self._ahead_us if self._ahead() else MAX_DISORDER_US
        if self._waiting_events >= FEW_EVENTS and lasted_us > enough_us:
            self._trust_waiting(ready)
        return count

    def follows(self, first_us: int, last_us: int, count: int) -> bool:
        """Take note of events in order of time that go on where the clock is; False where they do not."""
        if self._waiting or self._newest is None:
            return False
        first_us, last_us = first_us + self._shift_us, last_us + self._shift_us
        if first_us < self._newest or last_us - self._newest > MAX_DISORDER_US:
            return False
        self._newest = last_us
        self._arrived += count
        return True

    def reached(self, time_us: int) -> list[EventArray]:
        """Take it from elsewhere that the clock has reached a time; return what can be trusted by that."""
        ready: list[EventArray] = []
        if self._waiting and self._ahead() and self._waiting_newest <= time_us:
            self._trust_waiting(ready)
        if self._newest is not None:
            self._newest = max(self._newest, time_us)
        return ready

    def _ahead(self) -> bool:
        return self._newest is None or int(self._waiting[0].t[0]) > self._newest

    def _trust_waiting(self, ready: list[EventArray]) -> None:
        parts, self._waiting = self._waiting, []
        stamp = int(parts[0].t[0])
        if self._newest is not None and stamp < self._newest:
            shift_us = self._newest + EPOCH_GAP_US - stamp
            before, after = self._newest - self._shift_us, stamp - self._shift_us
            self._shift_us += shift_us
            problem = f"from {before} us to {after} us at event {self._waiting_from:,}"
            self._faults.new_epoch(problem, self._shift_us)
            self.resets.append(Reset(before, after, self._shift_us))
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


def _even(t: NDArray[np.int64], newest: int, until: int = _NEVER) -> int:
    """How many stamps, at least one, are within `MAX_DISORDER_US` of the newest before, below ``until``."""
    first = int(t[0])
    if first >= newest and int(t[-1]) < until:  # usual, and quick: sorted, without a silence
        steps = np.diff(t)
        if not len(steps) or (steps.min() >= 0 and steps.max() <= MAX_DISORDER_US):
            return len(t)
    done, size = 0, 1024
    while done < len(t):
        part = t[done : done + size]
        before = np.maximum.accumulate(np.concatenate([[newest], part[:-1]]))
        odd = (np.abs(part - before) > MAX_DISORDER_US) | (part >= until)
        if np.any(odd):
            return max(done + int(np.argmax(odd)), 1)
        newest = max(int(before[-1]), int(part[-1]))
        done, size = done + len(part), 4 * size
    return len(t)


def _shifted(events: EventArray, shift_us: int) -> EventArray:
    if not shift_us:
        return events
    return EventArray(events.t + shift_us, events.x, events.y, events.p, events.width, events.height)
