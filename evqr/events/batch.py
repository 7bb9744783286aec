"""Windows side by side, of one stream or of many: what the stages work on.

Events go to the device once, however many windows show them, eight bytes each: column and row, and the time
with the polarity in its last bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.events.window import Window

LONGEST_US = (1 << 31) - 1
"""Longest stretch of one stream whose times fit their 31 bits [us]."""


@dataclass(frozen=True, eq=False)
class PackedEvents:
    """Columns of events, eight bytes each.

    Attributes
    ----------
    x, y : (E,) uint16 [px]
        Column and row.
    stamp : (E,) uint32
        Twice the time since a reference of the stretch of a stream that the event is of [us], plus 1 where it
        became brighter.
    """

    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    stamp: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.stamp)


@dataclass(frozen=True, eq=False)
class EventBatch:
    """Windows of events, side by side.

    Attributes
    ----------
    windows : tuple of Window
        Where each comes from; they may overlap, and may be of different sensors.
    events : PackedEvents
        The events of all; those that several windows of a stream share are there once.
    window_ptr : (B, 2) int32
        First event of each window, and the one behind its last.
    t_ref_us : (B,) int32 [us]
        The middle of each window, since the reference that the stamps of its events have.
    """

    windows: tuple[Window, ...]
    events: PackedEvents
    window_ptr: NDArray[np.int32]
    t_ref_us: NDArray[np.int32]

    @classmethod
    def of(cls, windows: Sequence[Window]) -> EventBatch:
        """Pack the events of windows.

        Parameters
        ----------
        windows : sequence of Window
            Any number, in any order.

        Returns
        -------
        batch : EventBatch
            Of them, in their order.

        Raises
        ------
        ValueError
            If windows that share events together last longer than 31 bits of microseconds.
        """
        stretches = _stretches(windows)
        total = sum(stretch.count for stretch in stretches)
        x, y = np.empty((2, total), np.uint16)
        stamp = np.empty(total, np.uint32)
        window_ptr, t_ref_us = np.empty((len(windows), 2), np.int32), np.empty(len(windows), np.int32)
        begin = 0
        for stretch in stretches:
            reference_us = min(windows[k].start_us for k in stretch.members)
            if max(windows[k].end_us for k in stretch.members) - reference_us > LONGEST_US:
                raise ValueError(f"windows that share events must last at most {LONGEST_US} us together")
            copied = begin
            for k in stretch.members:
                window, first = windows[k], begin + stretch.offsets[k]
                last = first + len(window)
                window_ptr[k] = first, last
                t_ref_us[k] = window.middle_us - reference_us
                if last > copied:  # the first of these may be there, from the window before
                    events, new, skip = window.events, slice(copied, last), copied - first
                    x[new], y[new] = events.x[skip:], events.y[skip:]
                    _write_stamps(events.t[skip:], events.p[skip:], reference_us, stamp[new])
                    copied = last
            begin += stretch.count
        return cls(tuple(windows), PackedEvents(x, y, stamp), window_ptr, t_ref_us)

    def __len__(self) -> int:
        return len(self.windows)

    def pick(self, which: Sequence[int]) -> EventBatch:
        """Give some of the windows, any of them any number of times, over the same events.

        Parameters
        ----------
        which : sequence of int
            Their places.

        Returns
        -------
        batch : EventBatch
            Of these, in this order.
        """
        places = list(which)
        return EventBatch(
            tuple(self.windows[k] for k in places),
            self.events,
            self.window_ptr[places],
            self.t_ref_us[places],
        )


def _write_stamps(
    t: NDArray[np.int64], p: NDArray[np.int8], reference_us: int, out: NDArray[np.uint32]
) -> None:
    """Pack times [us] and polarities."""
    np.subtract(t, reference_us, out=out, casting="unsafe")
    np.left_shift(out, 1, out=out)
    np.bitwise_or(out, p > 0, out=out)


class _Stretch:
    """Events of one stream without a gap, and the windows that lie in it."""

    def __init__(self, first: int) -> None:
        self.first = first
        self.count = 0
        self.members: list[int] = []
        self.offsets: dict[int, int] = {}

    def add(self, k: int, first: int, count: int) -> None:
        self.members.append(k)
        self.offsets[k] = first - self.first
        self.count = max(self.count, first - self.first + count)


def _stretches(windows: Sequence[Window]) -> list[_Stretch]:
    """Put windows together whose events touch; in each the windows are in order of their first event."""
    found: list[_Stretch] = []
    streams: dict[int, list[tuple[int, int]]] = {}
    for k, window in enumerate(windows):
        if window.origin is None:
            found.append(_Stretch(0))
            found[-1].add(k, 0, len(window))
        else:
            stream, first = window.origin
            streams.setdefault(id(stream), []).append((first, k))
    for members in streams.values():
        stretch: _Stretch | None = None
        for first, k in sorted(members):
            if stretch is None or first > stretch.first + stretch.count:
                stretch = _Stretch(first)
                found.append(stretch)
            stretch.add(k, first, len(windows[k]))
    return found
