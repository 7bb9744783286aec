"""Which codes of a stream are one: a code that is lost and found again keeps its number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evqr.config import SchedulerConfig
from evqr.fit.detection import Target
from evqr.geometry import inverse
from evqr.symbol.payload import Payload


@dataclass(eq=False)
class _Known:
    """A code that was read: its number, what it says, and where it was when it was seen last."""

    code: int
    payload: Payload
    target: Target


class KnownCodes:
    """Codes of a stream that were read and may be found again.

    Two readings are of one code when they say the same, byte by byte, and the later one is where the earlier
    one must be by then, its motion held, to a part of its size: two codes cannot overlap.  A code whose way
    has taken it out of the image cannot be found again and is forgotten.
    """

    def __init__(self, cfg: SchedulerConfig, width: int, height: int) -> None:
        self._cfg = cfg
        self._size = np.array([width, height])
        self._known: list[_Known] = []
        self._next = 0

    def merge_with_earlier(self, payload: Payload, target: Target) -> tuple[int, bool]:
        """Give the number of a code that has just been read, and whether it was read before."""
        for known in self._known:
            if known.payload.same_content(payload) and self._are_one(known.target, target):
                known.target = target
                return known.code, True
        self._known.append(_Known(self._next, payload, target))
        self._next += 1
        del self._known[: -self._cfg.remembered_codes]
        return self._next - 1, False

    def _are_one(self, earlier: Target, later: Target) -> bool:
        """Whether a code is where an earlier one must be by now."""
        column, row = earlier.at(later.time_us).centre.tolist()
        x, y, z = (a * column + b * row + c for a, b, c in inverse(later.pose).tolist())
        space = earlier.space
        off = np.hypot(x / z - space.columns / 2.0, y / z - space.rows / 2.0)
        return bool(off < self._cfg.same_place * space.size)

    def moved(self, code: int, target: Target) -> None:
        """Say where a code is now."""
        for known in self._known:
            if known.code == code:
                known.target = target

    def forget(self, time_us: float) -> None:
        """Let go of the codes that are out of the image at a time: they go on."""
        self._known = [known for known in self._known if self._may_return(known.target.at(time_us))]

    def _may_return(self, target: Target) -> bool:
        reach = self._cfg.same_place * np.hypot(*(target.outline()[2] - target.outline()[0]))
        return bool((np.abs(target.centre - self._size / 2.0) < self._size / 2.0 + reach).all())
