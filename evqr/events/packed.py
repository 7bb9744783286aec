"""Events of eight bytes, as kernels take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray

STAMPS = 1 << 31
"""Stamps go round after so many microseconds."""


@dataclass(frozen=True, eq=False)
class PackedEvents:
    """Columns of events, eight bytes each.

    Attributes
    ----------
    x, y : (E,) uint16 [px]
        Column and row.
    stamp : (E,) uint32
        Twice the time [us], modulo 2^32, plus 1 where it became brighter.
    origin : (object, int), optional
        The stream that all of them were cut from, side by side, and the number of the first of them there;
        None: unknown, or of several.
    """

    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    stamp: NDArray[np.uint32]
    origin: tuple[object, int] | None = None

    def __len__(self) -> int:
        return len(self.stamp)

    @classmethod
    def joined(cls, parts: Sequence[PackedEvents]) -> PackedEvents:
        """Put the events of parts one behind the other.

        Parameters
        ----------
        parts : sequence of PackedEvents
            Any number; one part alone is given as it is.

        Returns
        -------
        joined : PackedEvents
            Of no known stream, unless of one part.
        """
        if len(parts) == 1:
            return parts[0]
        return cls(
            np.concatenate([np.zeros(0, np.uint16), *(part.x for part in parts)]),
            np.concatenate([np.zeros(0, np.uint16), *(part.y for part in parts)]),
            np.concatenate([np.zeros(0, np.uint32), *(part.stamp for part in parts)]),
        )

    def after(self, count: int) -> PackedEvents:
        """Leave out the first events.

        Parameters
        ----------
        count : int
            How many.

        Returns
        -------
        rest : PackedEvents
            Views.
        """
        if not count:
            return self
        return PackedEvents(self.x[count:], self.y[count:], self.stamp[count:])

    def begin(self, others: PackedEvents) -> bool:
        """Tell whether these are the first of others, or all of them.

        Parameters
        ----------
        others : PackedEvents
            Of any stream.

        Returns
        -------
        alike : bool
            False where it is not known.
        """
        if self.origin is None or len(self) > len(others):
            return self is others
        return self.origin == others.origin


def write_stamps(events: EventArray, out: NDArray[np.uint32]) -> None:
    """Write times and polarities as kernels take them.

    Parameters
    ----------
    events : EventArray
        E events.
    out : (E,) uint32
        Overwritten: twice the time [us], modulo 2^32, plus 1 where it became brighter.
    """
    np.copyto(out, events.t, casting="unsafe")  # modulo 2^32
    np.add(out, out, out=out)
    np.add(out, events.p > 0, out=out)


def unpacked(
    events: PackedEvents, near_us: int
) -> tuple[NDArray[np.int64], NDArray[np.uint16], NDArray[np.uint16], NDArray[np.int8]]:
    """Give packed events as columns, with whole times: those nearest to a time.

    Parameters
    ----------
    events : PackedEvents
        N of them.
    near_us : int [us]
        By the clock of the events.

    Returns
    -------
    t, x, y, p : (N,) int64 [us], uint16 [px], uint16 [px], int8
        Polarity is 1 or -1.
    """
    off = ((events.stamp >> 1).astype(np.int64) - near_us) % STAMPS
    back = (off >= STAMPS // 2) & (off - STAMPS + near_us >= 0)
    p = np.where(events.stamp & 1, np.int8(1), np.int8(-1))
    return near_us + np.where(back, off - STAMPS, off), events.x, events.y, p
