"""What was wrong with a recording: a little is left out and counted, more than a little is refused.

One broken event must not cost a recording, and a recording that is wrong throughout must not be read as if it
were right.  Up to `MAX_LEFT_OUT_SHARE` of the events are left out; with ``strict`` none is.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import RecordingError

MAX_LEFT_OUT_SHARE = 0.01
"""Of all events, and of the first `JUDGED_EVENTS`, so that a wrong option is noticed early."""

JUDGED_EVENTS = 1 << 16


@dataclass(frozen=True, kw_only=True)
class EventCounts:
    """What happened to the events of a recording on their way.

    Attributes
    ----------
    left_out : int
        Events that were wrong and left out.
    late : int
        Events that were out of order, and sorted.
    worst_us : int [us]
        By how much at most.
    epochs : int
        Stretches with a clock of their own; 1 unless the clock was reset.
    """

    left_out: int = 0
    late: int = 0
    worst_us: int = 0
    epochs: int = 1


class Faults:
    """Keeps count of what is wrong on one way through a recording.

    Parameters
    ----------
    name : str
        The recording, for messages.
    strict : bool
        Refuse at the first fault.
    """

    def __init__(self, name: str, *, strict: bool = False) -> None:
        self.name = name
        self.strict = strict
        self.met = 0
        self.left_out = 0
        self.late = 0
        self.worst_us = 0
        self.epochs = 1
        self._first = ("", "")
        self._notes: list[str] = []

    def leave_out(self, count: int, problem: str, advice: str) -> None:
        """Count events that are left out; ``problem`` tells of the first of them."""
        if self.strict:
            raise RecordingError(f"{self.name}: {problem}; {advice}")
        if not self.left_out:
            self._first = problem, advice
        self.left_out += count
        self.judge()

    def judge(self, *, finished: bool = False) -> None:
        """Raise `RecordingError` when too large a share of the events is wrong."""
        if self.left_out > MAX_LEFT_OUT_SHARE * (self.met if finished else max(self.met, JUDGED_EVENTS)):
            problem, advice = self._first
            share = f"{self.left_out:,} of {max(self.met, self.left_out):,} events are wrong"
            raise RecordingError(
                f"{self.name}: {problem}; {advice} ({share}; up to {MAX_LEFT_OUT_SHARE:.0%} are left out)"
            )

    def cut(self, problem: str) -> None:
        """Note that the file ends too early, after the last whole event."""
        if self.strict:
            raise RecordingError(f"{self.name}: truncated: {problem}; copy the file again")
        self.note(f"the file is cut short: {problem}; read up to there")

    def new_epoch(self, problem: str, shift_us: int) -> None:
        """Note that the clock was reset, and how much later the following times are put."""
        self.epochs += 1
        self.note(f"the clock was reset: {problem}; times from there on are put {shift_us:,} us later")

    def note(self, text: str) -> None:
        """Keep a line for the user, once."""
        if text not in self._notes:
            self._notes.append(text)

    @property
    def counts(self) -> EventCounts:
        """Counts so far."""
        return EventCounts(left_out=self.left_out, late=self.late, worst_us=self.worst_us, epochs=self.epochs)

    @property
    def notes(self) -> tuple[str, ...]:
        """What there is to tell so far, each in one line."""
        notes = list(self._notes)
        if self.late:
            notes.append(f"{self.late:,} events out of order by up to {self.worst_us:,} us were sorted")
        if self.left_out:
            events = "1 event was" if self.left_out == 1 else f"{self.left_out:,} events were"
            notes.append(f"{events} wrong and left out, the first: {self._first[0]}")
        return tuple(notes)
