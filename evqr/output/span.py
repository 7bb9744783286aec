"""The events of a short time, and how many there are over a long one, of whatever holds events."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray
from evqr.recording import Recording, open_recording

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from evqr.recording import RecordingOptions

MOST_BINS = 100
"""Of the events over time."""


def events_between(source: Any, span_us: tuple[int, int], **opening: Unpack[RecordingOptions]) -> EventArray:
    """Give the events of a time ``[start, end)`` [us], of a file in bounded memory.

    Raises
    ------
    RecordingError, MissingExtra, UsageError, TypeError
        As `open_recording`.
    """
    start_us, end_us = span_us
    if isinstance(source, EventArray):
        return source.between(start_us, end_us)
    if not isinstance(source, Recording):
        with open_recording(source, **opening) as recording:
            return events_between(recording, span_us)
    parts = []
    for chunk in source.chunks():
        if chunk.t[0] >= end_us:
            break
        parts.append(chunk.between(start_us, end_us))
    t, x, y, p = (np.concatenate([getattr(part, name) for part in parts]) for name in "txyp")
    return EventArray(t, x, y, p, source.width, source.height)


class Timeline:
    """How many events there are over time, counted chunk by chunk, in bins that widen as it gets longer.

    Attributes
    ----------
    start_us : int [us]
        Of the first bin.
    bin_us : int [us]
        Length of a bin.
    """

    def __init__(self) -> None:
        self.start_us: int | None = None
        self.bin_us = 1
        self._counts = np.zeros(2 * MOST_BINS, np.int64)

    def add(self, chunk: EventArray) -> None:
        """Count a chunk; times rise from chunk to chunk."""
        if not len(chunk):
            return
        if self.start_us is None:
            self.start_us = int(chunk.t[0])
        while (int(chunk.t[-1]) - self.start_us) // self.bin_us >= len(self._counts):
            self._counts[:MOST_BINS] = self._counts.reshape(-1, 2).sum(axis=1)
            self._counts[MOST_BINS:] = 0
            self.bin_us *= 2
        bins = (chunk.t - self.start_us) // self.bin_us
        self._counts += np.bincount(bins, minlength=len(self._counts))

    @property
    def per_ms(self) -> NDArray[np.float64]:
        """Events a millisecond in each bin, up to the last with any."""
        last = int(np.flatnonzero(self._counts)[-1]) + 1 if self._counts.any() else 1
        return self._counts[:last].astype(np.float64) * (1000.0 / self.bin_us)

    @property
    def busiest_us(self) -> int:
        """Middle of the bin with the most events [us]."""
        return (self.start_us or 0) + int(np.argmax(self._counts)) * self.bin_us + self.bin_us // 2


def timeline_of(source: Any, **opening: Unpack[RecordingOptions]) -> Timeline:
    """Count the events of a source over time."""
    timeline = Timeline()
    if isinstance(source, EventArray):
        timeline.add(source)
        return timeline
    if not isinstance(source, Recording):
        with open_recording(source, **opening) as recording:
            return timeline_of(recording)
    for chunk in source.chunks():
        timeline.add(chunk)
    return timeline
