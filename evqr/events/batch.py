"""Windows side by side, of one stream or of many: what the stages work on.

Events go to the device once, however many windows show them, eight bytes each: column and row, and the time
with the polarity in its last bit.  Times are modulo 2^31 us there and so need no reference of their own:
windows of all streams, and of any time, lie side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from evqr.events.packed import PackedEvents
from evqr.events.window import Window

LONGEST_US = (1 << 31) - 1
"""Longest window: stamps tell times up to 2^30 us from its middle [us]."""


@dataclass(frozen=True, eq=False)
class EventBatch:
    """Windows of events, side by side.

    Attributes
    ----------
    windows : tuple of Window
        Where each comes from; they may overlap, and may be of different sensors.
    parts : tuple of PackedEvents
        The events of all, one part behind the other; those that several windows of a stream share are there
        once.
    window_ptr : (B, 2) int32
        First event of each window, and the one behind its last.
    t_ref_us : (B,) int32 [us]
        The middle of each window, modulo 2^31.
    """

    windows: tuple[Window, ...]
    parts: tuple[PackedEvents, ...]
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
            If a window lasts longer than 31 bits of microseconds.
        """
        for window in windows:
            if window.end_us - window.start_us > LONGEST_US:
                bounds = f"{window.start_us} us to {window.end_us} us"
                raise ValueError(f"a window must last at most {LONGEST_US} us, got {bounds}")
        t_ref_us = np.array([window.middle_us % (1 << 31) for window in windows], np.int32)
        if len(windows) == 1:  # most often, and then this is a share of a followed window's time
            events = windows[0].packed
            return cls(tuple(windows), (events,), np.array([(0, len(events))], np.int32), t_ref_us)
        parts: list[PackedEvents] = []
        pointers = [(0, 0)] * len(windows)
        begin = 0
        for k, window in enumerate(windows):
            if window.origin is None:
                pointers[k] = begin, begin + len(window)
                begin += len(window)
                parts.append(window.packed)
        for count, members in _stretches(windows):
            for k, offset in members:
                pointers[k] = begin + offset, begin + offset + len(windows[k])
            begin += count
            parts += _parts(count, members, windows)
        window_ptr = np.array(pointers, np.int32).reshape(-1, 2)
        return cls(tuple(windows), tuple(parts), window_ptr, t_ref_us)

    def __len__(self) -> int:
        return len(self.windows)

    @cached_property
    def n_events(self) -> int:
        """How many events there are."""
        return sum(map(len, self.parts))

    @property
    def events(self) -> PackedEvents:
        """All of them in columns; copies, where there are several parts."""
        return PackedEvents.joined(self.parts)

    def pick(self, which: Sequence[int]) -> EventBatch:
        """Give some of the windows, any of them any number of times, over the same events.

        Parameters
        ----------
        which : sequence of int
            Their places.

        Returns
        -------
        batch : EventBatch
            Of these, in this order; itself where they are all of them.
        """
        places = list(which)
        if places == list(range(len(self.windows))):
            return self
        return EventBatch(
            tuple(self.windows[k] for k in places),
            self.parts,
            self.window_ptr[places],
            self.t_ref_us[places],
        )


def _stretches(windows: Sequence[Window]) -> list[tuple[int, list[tuple[int, int]]]]:
    """Put windows of streams together whose events touch: how many, and each window with its first one there.

    In each they are in order of their first event.
    """
    found: list[tuple[int, list[tuple[int, int]]]] = []
    streams: dict[int, list[tuple[int, int]]] = {}
    for k, window in enumerate(windows):
        if window.origin is not None:
            stream, number = window.origin
            streams.setdefault(id(stream), []).append((number, k))
    for members in streams.values():
        members.sort()
        begin = end = members[0][0]
        together: list[tuple[int, int]] = []
        for number, k in members:
            if number > end:
                found.append((end - begin, together))
                begin, together = number, []
            together.append((k, number - begin))
            end = max(end, number + len(windows[k]))
        found.append((end - begin, together))
    return found


def _parts(count: int, members: list[tuple[int, int]], windows: Sequence[Window]) -> list[PackedEvents]:
    """Give the events of a stretch, those of a window without what the ones before it have."""
    for k, _ in members:
        if len(windows[k]) == count:
            return [windows[k].packed]  # as they are: they say where they come from
    parts: list[PackedEvents] = []
    copied = 0
    for k, offset in members:
        packed, skip = windows[k].packed, copied - offset
        if len(packed) > skip:
            parts.append(packed.after(skip))
            copied = offset + len(packed)
    return parts
