"""What was seen lately, with its times: the parts of triggers that come late are told from it, too."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from evqr.line.gates import Gate
from evqr.results import CodeReading
from evqr.stream.records import CodeAgain, CodeLeft, CodeRead, CodeUnread, Searched, StreamRecord

MOST_KEPT = 1 << 14
"""Searches, and things followed in vain, that are kept at most, whatever the times that are asked for."""


class Place(NamedTuple):
    """Where something was, and how it went on.

    Attributes
    ----------
    time_us : float [us]
        When.
    centre : complex [px]
        Column, and row as the imaginary part.
    velocity : complex [px/s]
        The same.
    reach_px : float [px]
        Half of its diagonal.
    """

    time_us: float
    centre: complex
    velocity: complex
    reach_px: float

    @classmethod
    def of(cls, what: CodeReading | CodeUnread) -> Place:
        """Give the place of a code that was read, or that was followed in vain."""
        if isinstance(what, CodeReading):
            corners, velocity, time_us = what.corners_px, what.motion_px_per_s, what.t_read_us
        else:
            target = what.target
            corners, velocity, time_us = target.outline(), target.motion.velocity, target.time_us
        points = [complex(*corner) for corner in corners.tolist()]
        return cls(time_us, sum(points) / 4.0, complex(*velocity.tolist()), abs(points[2] - points[0]) / 2.0)

    def is_at(self, other: Place) -> bool:
        """Whether two things are one, their motions held: codes cannot overlap."""
        early, late = sorted((self, other), key=lambda place: place.time_us)
        went = early.velocity * (late.time_us - early.time_us) * 1e-6
        return abs(early.centre + went - late.centre) < late.reach_px


@dataclass(eq=False)
class Sight:
    """A code from when it was first seen to when it was seen no more.

    Attributes
    ----------
    code : int
        Its number in the stream.
    reading : CodeReading
        What it says.
    first_us, last_us : float [us]
        From when to when; infinite while it is in view.
    gate : Gate, optional
        Whose part it was given to.
    given : bool
        Whether it was given to a part.
    """

    code: int
    reading: CodeReading
    first_us: float
    last_us: float = math.inf
    gate: Gate | None = None
    given: bool = False

    def until(self, time_us: float) -> CodeReading:
        """Give the reading with what is known at a time of when it was seen."""
        reading = self.reading
        last_us = min(self.last_us, max(reading.t_read_us, time_us))
        return replace(reading, t_first_us=round(self.first_us), t_last_us=round(last_us))


class Skipped(NamedTuple):
    """A time in which nothing was searched for.

    Attributes
    ----------
    start_us, end_us : float [us]
        Its bounds.
    """

    start_us: float
    end_us: float


class History:
    """Codes that were seen, what was searched and what was followed in vain, as far back as may be asked for.

    Attributes
    ----------
    sights : list of Sight
        In order of the times at which their codes were read.
    searches : deque of Searched
        In order.
    unread : deque of CodeUnread
        In order of their ends.
    skipped : deque of Skipped
        In order.
    forgotten_us : float [us]
        Nothing is known any more of what was before.
    """

    def __init__(self) -> None:
        self.sights: list[Sight] = []
        self.searches: deque[Searched] = deque(maxlen=MOST_KEPT)
        self.unread: deque[CodeUnread] = deque(maxlen=MOST_KEPT)
        self.skipped: deque[Skipped] = deque(maxlen=MOST_KEPT)
        self.forgotten_us = -math.inf
        self._readings: dict[int, CodeReading] = {}

    def take(self, record: StreamRecord) -> Sight | None:
        """Add what has become certain; give the code that has come, or left, if it says so."""
        if isinstance(record, CodeRead):
            self._readings[record.code] = record.reading
            return self._see(record.code, record.reading.t_first_us)
        if isinstance(record, CodeAgain):
            return self._see(record.code, record.t_first_us)
        if isinstance(record, CodeLeft):
            for sight in reversed(self.sights):
                if sight.code == record.code:
                    sight.last_us = record.t_last_us
                    return sight
        elif isinstance(record, Searched):
            self.searches.append(record)
        elif isinstance(record, CodeUnread):
            self.unread.append(record)
        return None

    def _see(self, code: int, first_us: int) -> Sight | None:
        reading = self._readings.get(code)
        if reading is None:
            return None
        sight = Sight(code, reading, first_us)
        self.sights.append(sight)
        return sight

    def forget(self, before_us: float, most_readings: int) -> None:
        """Let go of what was before a time, and of the oldest texts of codes that may come again."""
        if before_us <= self.forgotten_us:
            return
        self.forgotten_us = before_us
        self.sights = [sight for sight in self.sights if sight.last_us >= before_us]
        for ended, end_of in (
            (self.searches, lambda each: each.end_us),
            (self.unread, lambda each: each.t_last_us),
            (self.skipped, lambda each: each.end_us),
        ):
            while ended and end_of(ended[0]) < before_us:
                ended.popleft()
        for code in list(self._readings)[: max(0, len(self._readings) - most_readings)]:
            del self._readings[code]

    def searches_in(self, start_us: float, end_us: float) -> list[Searched]:
        """Give the searches of windows that began in a time."""
        return [each for each in self.searches if start_us <= each.start_us < end_us]

    def unread_in(
        self, start_us: float, end_us: float, others: Iterable[CodeUnread] = ()
    ) -> list[CodeUnread]:
        """Give what was followed in vain in a time, with others that still are; no codes that were read."""
        read = [Place.of(sight.reading) for sight in self.sights]
        return [
            each
            for each in (*self.unread, *others)
            if each.t_first_us < end_us and each.t_last_us > start_us and not _is_one_of(each, read)
        ]

    def skipped_in(self, start_us: float, end_us: float) -> bool:
        """Tell whether searches were skipped in a time."""
        return any(each.start_us < end_us and each.end_us > start_us for each in self.skipped)


def _is_one_of(unread: CodeUnread, places: Sequence[Place]) -> bool:
    place = Place.of(unread)
    return any(place.is_at(other) for other in places)
