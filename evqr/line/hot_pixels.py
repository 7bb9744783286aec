"""Pixels that fire all the time, whatever is in view: found, and left out.

A pixel is hot where it fires often, far more often than those around it, in several spans one after another.
What moves, flickers or floods the view does not do that: an edge passes neighbours alike.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray

SPAN_US = 100_000
"""Time over which pixels are compared [us]."""

SPANS = 3
"""Spans in a row in which a pixel must stand out to be left out; so many without, and it is let in again."""

EACH = 8
"""One event in so many is counted: pixels that matter have many."""

FEWEST = 4
"""Counted events of a span below which a pixel is not looked at."""

TIMES_NEIGHBOURS = 8.0
"""How much more often than the mean of its eight neighbours a hot pixel fires."""


class HotPixels:
    """Leaves out the events of hot pixels, once they are known.

    Decisions are made between spans of the events' time, so how the events were cut does not matter.

    Parameters
    ----------
    width, height : int [px]
        Size of the sensor.
    least_hz : float [1/s]
        What fires less is not hot.
    """

    def __init__(self, width: int, height: int, least_hz: float) -> None:
        self._width, self._height = width, height
        self._fewest = max(FEWEST, least_hz * SPAN_US * 1e-6 / EACH)
        self._span: int | None = None
        self._seen = 0
        self._sampled: list[NDArray[np.int32]] = []
        self._streak: dict[int, int] = {}
        self._hot: NDArray[np.bool_] | None = None

    @property
    def pixels(self) -> list[tuple[int, int]]:
        """Column and row of those that are left out."""
        if self._hot is None:
            return []
        return [(int(at % self._width), int(at // self._width)) for at in np.flatnonzero(self._hot)]

    def without(self, events: EventArray) -> Iterator[EventArray]:
        """Give events without those of hot pixels.

        Parameters
        ----------
        events : EventArray
            The next of a stream, in order of time.

        Yields
        ------
        events : EventArray
            Those that are left, up to the end of each span.
        """
        while len(events):
            span = int(events.t[0]) // SPAN_US
            if span != self._span:
                self._judge(span)
            last = len(events)
            if int(events.t[-1]) // SPAN_US != span:
                last = events.first_at((span + 1) * SPAN_US)
            yield self._kept(events.cut(0, last))
            events = events.cut(last, len(events))

    def _kept(self, events: EventArray) -> EventArray:
        """Count some of the events, and give those that are left."""
        first = -self._seen % EACH
        self._seen += len(events)
        sample = slice(first, None, EACH)
        self._sampled.append(events.y[sample].astype(np.int32) * self._width + events.x[sample])
        if self._hot is None:
            return events
        keep = ~self._hot[events.y.astype(np.int32) * self._width + events.x]
        return EventArray(
            events.t[keep], events.x[keep], events.y[keep], events.p[keep], events.width, events.height
        )

    def _judge(self, span: int) -> None:
        """Decide with what was counted in the span that is over."""
        sampled, self._sampled = self._sampled, []
        before, self._span = self._span, span
        if before is None:
            return
        standing_out = self._standing_out(np.concatenate(sampled) if sampled else np.empty(0, np.int32))
        self._streak = {
            at: streak
            for at in {*standing_out, *self._streak}
            if (streak := self._streak_of(at, at in standing_out)) > 0
        }
        hot = [at for at, streak in self._streak.items() if streak >= SPANS]
        self._hot = None
        if hot:
            self._hot = np.zeros(self._width * self._height, np.bool_)
            self._hot[hot] = True

    def _streak_of(self, at: int, stands_out: bool) -> int:
        """Count up where a pixel stands out, else down; once it is hot, up so far that it stays so."""
        streak = self._streak.get(at, 0)
        if not stands_out:
            return streak - 1
        return 2 * SPANS - 1 if streak + 1 >= SPANS else streak + 1

    def _standing_out(self, sampled: NDArray[np.int32]) -> set[int]:
        """Give the pixels that fire often, and far more often than those around them."""
        counts = np.bincount(sampled, minlength=self._width * self._height)
        often = np.flatnonzero(counts >= self._fewest)
        if not len(often):
            return set()
        padded = np.pad(counts.reshape(self._height, self._width), 1)
        rows, columns = often // self._width, often % self._width
        around = sum(
            padded[rows + dy, columns + dx] for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1)
        )
        return set(often[counts[often] > TIMES_NEIGHBOURS * np.maximum(around, 1) / 8.0].tolist())
