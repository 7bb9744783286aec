"""Which codes of a stream are one: a code that is lost and found again keeps its number."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from evqr.config import SchedulerConfig
from evqr.fit.detection import Target
from evqr.stream.identity import distance_as_one, may_stop, turn_between
from evqr.symbol.payload import Payload

TURNED_OVER = 8
"""Sightings over which it is measured how fast a code turns."""


@dataclass(eq=False)
class _Known:
    """A code that was read: its number, what it says, until when it may return, and where it was lately."""

    code: int
    payload: Payload
    until_us: float = math.inf
    seen: deque[Target] = field(default_factory=lambda: deque(maxlen=TURNED_OVER))

    @property
    def target(self) -> Target:
        """Where it was seen last."""
        return self.seen[-1]

    @property
    def turning(self) -> float:
        """How fast it was seen to turn [rad/s]."""
        first, last = self.seen[0], self.seen[-1]
        seconds = (last.time_us - first.time_us) * 1e-6
        return turn_between(first, last) / seconds if seconds > 0.0 else 0.0


class KnownCodes:
    """Codes of a stream that were read and may be found again.

    Two readings are of one code when they say the same, byte by byte, and one thing may have been in both
    places (`evqr.stream.identity`); of several that it may be, it is the nearest to where it must be.  A code
    whose way has taken it out of the image cannot be found again and is forgotten, unless it may have
    stopped.
    """

    def __init__(self, cfg: SchedulerConfig, width: int, height: int) -> None:
        self._cfg = cfg
        self._size = width, height
        self._known: list[_Known] = []
        self._next = 0

    def merge_with_earlier(self, payload: Payload, target: Target) -> tuple[int, bool]:
        """Give the number of a code that has just been read, and whether it was read before."""
        nearest, least = None, math.inf
        for known in self._known:
            if known.payload.same_content(payload):
                distance = distance_as_one(known.target, target, known.turning, self._cfg)
                if distance < least:
                    nearest, least = known, distance
        again = nearest is not None
        if nearest is None:
            nearest = _Known(self._next, payload)
            self._known.append(nearest)
            self._next += 1
            del self._known[: -self._cfg.remembered_codes]
        self._see(nearest, target)
        return nearest.code, again

    def moved(self, code: int, target: Target) -> None:
        """Say where a code is now."""
        for known in self._known:
            if known.code == code:
                self._see(known, target)

    def _see(self, known: _Known, target: Target) -> None:
        known.seen.append(target)
        known.until_us = self._until_us(target)

    def forget(self, time_us: float) -> None:
        """Let go of the codes that are out of the image at a time: they go on."""
        self._known = [known for known in self._known if known.until_us > time_us]

    def _until_us(self, target: Target) -> float:
        """Give the time until which a code may be found again [us]."""
        if may_stop(target, self._cfg):
            return math.inf
        corners = target.outline()
        reach = self._cfg.same_place * math.hypot(*(corners[2] - corners[0]).tolist())
        centre = target.centre
        stay_s = math.inf
        for at, speed, end in zip(
            centre.tolist(), target.motion.velocity_at(centre).tolist(), self._size, strict=True
        ):
            if speed:
                stay_s = min(stay_s, ((end + reach if speed > 0.0 else -reach) - at) / speed)
        return target.time_us + 1e6 * stay_s
