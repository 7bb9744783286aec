"""Whether events are spread as those of noise: then nothing is searched in them.

What moves has more of its events, of one sign, in some cells than in others, in the time that it takes to
cross a cell.  Noise has not: the squares of the counts of all cells add up to what chance says.
"""

from __future__ import annotations

import math

import numpy as np

from evqr.config import MotionConfig
from evqr.events.buffer import EventBuffer
from evqr.events.window import Window

NOISE_SPREAD = 3.0
"""Standard deviations within which counts in cells are as those of noise: they are not correlated then."""

LEAST_CELL_PX = 3
"""Cells from which counts tell noise from what moves: a pixel that has fired may not fire again so soon."""

MOST_SLICES = 128
"""Times of which counts are kept."""

MOST_BETWEEN = 8
"""Slices between two windows that are counted, too: a longer window will ask for them."""

MOST_AT_ONCE = 4
"""Events that are counted for a window at most, in those that are looked at otherwise: where things have
moved a longer one has them all still to be counted."""


def noise_squares(count: int, on: int, cells: float) -> tuple[float, float]:
    """Give between what the squares of the counts of cells sum up to where events are noise.

    Of a Poisson number of events, l in the mean, with signs whose mean is s, the sum has the square
    l + (l s)^2 in the mean, with a variance of 2 l^2 + 4 l (l s)^2 where the events of all cells are counted.

    Parameters
    ----------
    count, on : int [events]
        In all cells, and those of them that became brighter.
    cells : float
        Their number.

    Returns
    -------
    least, most : float [events^2]
        Bounds.
    """
    mean, imbalance = count / cells, ((2 * on - count) / cells) ** 2
    middle = cells * (mean + imbalance)
    spread = NOISE_SPREAD * math.sqrt(cells * (2.0 * mean**2 + 4.0 * mean * imbalance))
    return middle - spread, middle + spread


class NoiseCounts:
    """Counts of a stream's events in coarse cells, in slices of time, each made when it is first asked for.

    Every event is counted once, however many windows it is in.  Counts are kept as sums over all slices since
    one, modulo 2^16, so those of a window of any length are one difference.

    Parameters
    ----------
    events : EventBuffer
        The stream.
    width, height : int [px]
        Of the sensor.
    cfg : MotionConfig
        Of the windows that are asked about.
    """

    def __init__(self, events: EventBuffer, width: int, height: int, cfg: MotionConfig) -> None:
        self._events, self._cfg = events, cfg
        self._rows, self._columns = -(-height // cfg.reduction), -(-width // cfg.reduction)
        self._slice_us = max(1, cfg.probe_us // 2)
        self._first = self._end = 0
        """Slices that are counted, without a gap."""
        self._sums = np.zeros((0, self._rows * self._columns), np.int16)
        self._of_all = [(0, 0)] * (MOST_SLICES + 1)
        self._half = np.empty(self._rows * self._columns, np.int16)

    def are_noise(self, start_us: int, end_us: int) -> bool:
        """Tell whether the events of a window are spread as those of noise, in both of its halves.

        Parameters
        ----------
        start_us, end_us : int [us]
            Its bounds, which are rounded down to slices; all events before its end are here.

        Returns
        -------
        are_noise : bool
            False also where there are few, or it is not known.
        """
        cfg, first, last = self._cfg, start_us // self._slice_us, end_us // self._slice_us
        if cfg.reduction < LEAST_CELL_PX or not 2 <= last - first <= MOST_SLICES:
            return False
        if not self._count(first, last):
            return False
        middle = (first + last) // 2
        halves = [self._squares(*bounds) for bounds in ((first, middle), (middle, last))]
        if sum(count for _, count, _ in halves) < cfg.fewest_events:
            return False
        cells = float(self._rows * self._columns)
        bounds = [noise_squares(count, on, cells) for _, count, on in halves]
        found = sum(squares for squares, _, _ in halves)
        spread = math.hypot(*((most - least) / 2.0 for least, most in bounds))
        return abs(found - sum((least + most) / 2.0 for least, most in bounds)) <= spread

    def _count(self, first: int, last: int) -> bool:
        """Count the events of slices that are not counted yet, unless they are many."""
        if not max(self._first, self._end - MOST_SLICES) <= first <= self._end + MOST_BETWEEN:
            self._first = self._end = first
        if last <= self._end:
            return True
        start_us = max(self._end * self._slice_us, self._events.first_us or 0)
        window = self._events.window(start_us, last * self._slice_us)
        if len(window) > MOST_AT_ONCE * self._cfg.most_events:
            return False
        if not len(self._sums):
            self._sums = np.zeros((MOST_SLICES + 1, self._rows * self._columns), np.int16)
        for number in range(self._end, last):
            self._count_slice(number, window)
        self._end = last
        return True

    def _count_slice(self, number: int, window: Window) -> None:
        events = window.events.between(number * self._slice_us, (number + 1) * self._slice_us)
        before, after = (each % (MOST_SLICES + 1) for each in (number, number + 1))
        sums = self._sums[after]
        sums[:] = self._sums[before]
        cell = (events.y // self._cfg.reduction).astype(np.intp)
        cell *= self._columns
        cell += events.x // self._cfg.reduction
        sign = events.p.astype(np.int16)
        np.add.at(sums, cell, sign)
        count, ons = self._of_all[before]
        self._of_all[after] = count + len(events), ons + (len(events) + int(sign.sum())) // 2

    def _squares(self, first: int, last: int) -> tuple[float, int, int]:
        """Give the squares of all cells of some slices, and how many events and ON events they have."""
        before, after = (each % (MOST_SLICES + 1) for each in (first, last))
        np.subtract(self._sums[after], self._sums[before], out=self._half)
        as_float = self._half.astype(np.float32)
        squares = float(np.einsum("i,i->", as_float, as_float))
        (count, ons), (count_before, ons_before) = self._of_all[after], self._of_all[before]
        return squares, count - count_before, ons - ons_before
