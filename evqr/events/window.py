"""Windows of events, with times relative to a reference."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray
from evqr.events.packed import PackedEvents, write_stamps


class Window:
    """Events of one window, with times relative to its middle.

    The middle is the reference: an error of the motion then blurs the window, but does not move the code.

    Attributes
    ----------
    events : EventArray
        As recorded, in order of time.
    start_us, end_us : int [us]
        Bounds, the end not included.
    origin : (object, int), optional
        The stream that the events were cut from, and the number of the first of them there: windows that
        share it share their first events. None: unknown.
    stamps : (E,) uint32, optional
        What `write_stamps` makes of the events; None: made when they are packed.
    """

    def __init__(
        self,
        events: EventArray,
        start_us: int,
        end_us: int,
        *,
        origin: tuple[object, int] | None = None,
        stamps: NDArray[np.uint32] | None = None,
    ) -> None:
        self.events = events
        self.start_us = start_us
        self.end_us = end_us
        self.origin = origin
        self._stamps = stamps
        self._n_events = len(events)  # asked for again and again

    def __len__(self) -> int:
        return self._n_events

    @property
    def width(self) -> int:
        """Of the sensor [px]."""
        return self.events.width

    @property
    def height(self) -> int:
        """Of the sensor [px]."""
        return self.events.height

    @property
    def seconds(self) -> float:
        """Length of the window [s]."""
        return (self.end_us - self.start_us) * 1e-6

    @property
    def middle_us(self) -> int:
        """Reference time of the window: its middle, to the microsecond [us]."""
        return (self.start_us + self.end_us) // 2

    @cached_property
    def packed(self) -> PackedEvents:
        """Its events, eight bytes each; views of what the stream holds where they come from one."""
        stamps = self._stamps
        if stamps is None:
            stamps = np.empty(len(self), np.uint32)
            write_stamps(self.events, stamps)
        return PackedEvents(self.events.x, self.events.y, stamps, self.origin)

    @cached_property
    def x(self) -> NDArray[np.float32]:
        """Columns (E,) [px]."""
        return self.events.x.astype(np.float32)

    @cached_property
    def y(self) -> NDArray[np.float32]:
        """Rows (E,) [px]."""
        return self.events.y.astype(np.float32)

    @cached_property
    def t(self) -> NDArray[np.float32]:
        """Times (E,), ascending [s]."""
        return (self.events.t - self.middle_us).astype(np.float32) * np.float32(1e-6)

    @cached_property
    def p(self) -> NDArray[np.float32]:
        """Polarities (E,), -1 or +1."""
        return self.events.p.astype(np.float32)

    def thinned(self, step: int) -> Window:
        """Give the window with every n-th of its events.

        Parameters
        ----------
        step : int
            1 for all of them.

        Returns
        -------
        window : Window
            Of the same bounds; its events are views.
        """
        if step == 1:
            return self
        e, packed = self.events, self.packed
        some = EventArray(e.t[::step], e.x[::step], e.y[::step], e.p[::step], e.width, e.height)
        return Window(some, self.start_us, self.end_us, stamps=packed.stamp[::step])

    def keep(self, mask: NDArray[np.bool_]) -> Window:
        """Give the window with only some of its events.

        Parameters
        ----------
        mask : (E,) bool
            Which are kept.

        Returns
        -------
        window : Window
            Of the same bounds; its events are copies.
        """
        e, places = self.events, np.flatnonzero(mask)  # found once: masks cost as much for each column
        kept = EventArray(e.t[places], e.x[places], e.y[places], e.p[places], e.width, e.height)
        return Window(kept, self.start_us, self.end_us, stamps=self.packed.stamp[places])


def make_window(events: EventArray, start_us: int, end_us: int) -> Window:
    """Cut a window out of events in order of time."""
    return Window(events.between(start_us, end_us), start_us, end_us)
