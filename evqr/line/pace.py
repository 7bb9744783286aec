"""How far reading is behind the events, and when they came: wall time against the time of events."""

from __future__ import annotations

import math
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from evqr.clock import utc_text

MOST_ARRIVALS = 1 << 12
"""Chunks whose arrival is kept in mind."""


@dataclass(frozen=True)
class Clocks:
    """Where wall time is taken from.

    Attributes
    ----------
    monotonic : callable
        Gives seconds since anything.
    utc : callable
        Gives seconds since 1970.
    """

    monotonic: Callable[[], float] = time.monotonic
    utc: Callable[[], float] = time.time


class Pace:
    """When the events came.

    Parameters
    ----------
    clocks : Clocks, optional
        Default: those of the machine.
    """

    def __init__(self, clocks: Clocks | None = None) -> None:
        self._clocks = clocks or Clocks()
        self._known_us: deque[float] = deque(maxlen=MOST_ARRIVALS)
        self._arrivals: deque[tuple[float, float]] = deque(maxlen=MOST_ARRIVALS)
        self._least_s = math.inf
        self._here = self._now()

    def _now(self) -> tuple[float, float]:
        return self._clocks.monotonic(), self._clocks.utc()

    def came(self, at_s: tuple[float, float] | None = None) -> None:
        """Say that a chunk is here, since a time by both clocks, default now: it is about to be worked on."""
        self._here = self._now() if at_s is None else at_s

    def reach(self, time_us: float) -> None:
        """Say that with the chunk that is here all events up to a time are [us]."""
        if not self._known_us or time_us > self._known_us[-1]:
            self._known_us.append(time_us)
            self._arrivals.append(self._here)
            self._least_s = min(self._least_s, self._here[0] - time_us * 1e-6)

    def begin(self) -> None:
        """Say that the events' clock was reset."""
        self._known_us.clear()
        self._arrivals.clear()
        self._least_s = math.inf

    def behind_us(self) -> float:
        """Give how much later it is, by the events' clock, than the newest of them; 0 at best [us]."""
        if not self._known_us:
            return 0.0
        return 1e6 * (self._clocks.monotonic() - self._least_s) - self._known_us[-1]

    def since(self, time_us: float) -> tuple[str, float]:
        """Tell when the events up to a time were here.

        Parameters
        ----------
        time_us : float [us]
            Of events.

        Returns
        -------
        t_utc : str
            When, in UTC.
        latency_ms : float [ms]
            How long ago that is.
        """
        at = bisect_left(self._known_us, time_us)
        monotonic, utc = self._arrivals[at] if at < len(self._arrivals) else self._here
        return utc_text(utc), max(0.0, 1e3 * (self._clocks.monotonic() - monotonic))
