"""Events in order of time, one column a field."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class EventArray:
    """Events in order of time, one column a field.

    Attributes
    ----------
    t : (E,) int64 [us]
        Ascending.
    x, y : (E,) uint16 [px]
        Column and row, inside the sensor.
    p : (E,) int8
        -1 darker, +1 brighter.
    width, height : int [px]
        Sensor size.
    """

    t: NDArray[np.int64]
    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    p: NDArray[np.int8]
    width: int
    height: int

    def __len__(self) -> int:
        return len(self.t)

    def first_at(self, time_us: int) -> int:
        """Find the first event at a time or later.

        Parameters
        ----------
        time_us : int [us]
            The time.

        Returns
        -------
        index : int
            Of the event; the number of events where all are earlier.
        """
        # a microsecond; NumPy's own search lets other threads have the GIL and may wait to get it back
        return bisect_left(self.t, time_us)

    def cut(self, first: int, last: int) -> EventArray:
        """Cut out some events.

        Parameters
        ----------
        first, last : int
            Index of the first event, and of the one behind the last.

        Returns
        -------
        events : EventArray
            Views of these.
        """
        s = slice(first, last)
        return EventArray(self.t[s], self.x[s], self.y[s], self.p[s], self.width, self.height)

    def between(self, start_us: int, end_us: int) -> EventArray:
        """Cut out the events of some time.

        Parameters
        ----------
        start_us, end_us : int [us]
            Events with ``start_us <= t < end_us``.

        Returns
        -------
        events : EventArray
            Views of these.
        """
        return self.cut(self.first_at(start_us), self.first_at(end_us))
