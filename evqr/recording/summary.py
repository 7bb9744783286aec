"""What a recording holds, in figures, and what looks wrong with it: `evqr info`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from evqr.events.array import EventArray

from .opening import open_recording
from .options import RecordingOptions
from .stream import Recording
from .writing import Progress

if TYPE_CHECKING:
    from typing_extensions import Unpack

PEAK_BIN_US = 1_000

# What counts as suspicious.
ONE_SIDED = 0.01  # a polarity with a smaller share of the events than this
GAP_US, GAP_SHARE = 10_000, 0.2  # silence of this length and this share of the recording
HOT_SHARE, HOT_RATIO = (
    1e-3,
    50,
)  # a pixel with this share of all events and so often the mean of the active ones
UNUSED_SHARE = 0.5  # events in less than this share of columns or rows
MANY_EVENTS = 1_000  # the shares above mean nothing for fewer events


@dataclass(frozen=True, kw_only=True)
class RecordingInfo:
    """Figures of one recording.

    Attributes
    ----------
    path : str
        "" for arrays.
    format : str
        In words.
    stream, streams : str, tuple of str
        The event stream that is told of, and all there are; "" and none where a format holds but one.
    width, height : int [px]
        Sensor size.
    events, on, off : int
        Counts.
    t_first_us, t_last_us : int [us]
        First and last time stamp.
    mean_rate, peak_rate : float [1/s]
        Events a second: over all, and in the busiest millisecond of the clock.
    time_unit, time_unit_reason : str
        Unit of the stored stamps, and how it is known.
    left_out, late, epochs : int
        Events that were wrong and left out, events out of order that were sorted, and stretches with a clock
        of their own (1 unless the clock was reset).
    notes : tuple of str
        What was odd or decided in reading it, each in one line.
    suspicious : tuple of str
        What looks wrong with it, each in one line.
    """

    path: str
    format: str
    stream: str
    streams: tuple[str, ...]
    width: int
    height: int
    events: int
    on: int
    off: int
    t_first_us: int
    t_last_us: int
    mean_rate: float
    peak_rate: float
    time_unit: str
    time_unit_reason: str
    left_out: int
    late: int
    epochs: int
    notes: tuple[str, ...]
    suspicious: tuple[str, ...]

    @property
    def duration_us(self) -> int:
        """Time from the first to the last event [us]."""
        return self.t_last_us - self.t_first_us


def summarise(
    recording: Any, *, progress: Progress | None = None, **opening: Unpack[RecordingOptions]
) -> RecordingInfo:
    """Stream through a recording once and count.

    Parameters
    ----------
    recording : Recording, path or arrays
        As `open_recording` gives it, or what it takes.
    progress : callable, optional
        Called with the event time done and the whole duration, None while unknown [us].
    **opening : as for `open_recording`
        Such as ``sensor`` and ``time_unit``, for what is not open yet.

    Returns
    -------
    info : RecordingInfo
        What it holds, and what is odd in it.

    Raises
    ------
    RecordingError, MissingExtra, UsageError
        Where `open_recording` and streaming do.
    TypeError
        It is nothing that can be opened, or is open already and there is something to open it with.
    """
    if not isinstance(recording, Recording):
        with open_recording(recording, **opening) as opened:
            return summarise(opened, progress=progress)
    if opening:
        raise TypeError(f"a Recording is open already: pass {', '.join(opening)} to open_recording")
    counts = _Counts(recording.width, recording.height)
    for chunk in recording.chunks():
        counts.add(chunk)
        if progress is not None:
            last = recording.t_last_us
            progress(counts.t_last - counts.t_first, None if last is None else last - counts.t_first)
    return RecordingInfo(
        path=recording.path,
        format=recording.format,
        stream=recording.stream,
        streams=recording.streams,
        width=recording.width,
        height=recording.height,
        events=counts.events,
        on=counts.on,
        off=counts.events - counts.on,
        t_first_us=counts.t_first,
        t_last_us=counts.t_last,
        # A recording of one instant is taken to last a microsecond.
        mean_rate=counts.events * 1e6 / max(counts.t_last - counts.t_first, 1),
        peak_rate=counts.peak * 1e6 / PEAK_BIN_US,
        time_unit=recording.time_unit,
        time_unit_reason=recording.time_unit_reason,
        left_out=recording.counts.left_out,
        late=recording.counts.late,
        epochs=recording.counts.epochs,
        notes=recording.notes,
        suspicious=tuple(counts.suspicions()),
    )


class _Counts:
    """Counts that grow chunk by chunk."""

    def __init__(self, width: int, height: int) -> None:
        self.per_pixel = np.zeros((height, width), np.int64)
        self.events = self.on = 0
        self.t_first = self.t_last = 0
        self.gap_us = self.gap_from = 0
        self.peak = 0
        self._bin, self._in_bin = (
            -1,
            0,
        )  # the millisecond that may go on in the next chunk, and its events so far

    def add(self, chunk: EventArray) -> None:
        if self.events == 0:
            self.t_first = self.t_last = int(chunk.t[0])
        before = np.concatenate([[self.t_last], chunk.t[:-1]])
        widest = int(np.argmax(chunk.t - before))
        if chunk.t[widest] - before[widest] > self.gap_us:
            self.gap_us, self.gap_from = int(chunk.t[widest] - before[widest]), int(before[widest])

        bins, counts = np.unique(chunk.t // PEAK_BIN_US, return_counts=True)
        if bins[0] == self._bin:
            counts[0] += self._in_bin
        self.peak = max(self.peak, int(counts.max()))
        self._bin, self._in_bin = int(bins[-1]), int(counts[-1])

        np.add.at(self.per_pixel, (chunk.y, chunk.x), 1)
        self.events += len(chunk)
        self.on += int(np.count_nonzero(chunk.p > 0))
        self.t_last = int(chunk.t[-1])

    def suspicions(self) -> Iterator[str]:
        for name, count in (("brighter", self.on), ("darker", self.events - self.on)):
            if count == 0:
                yield f"no event says {name}: the polarity may have been lost in a conversion"
            elif count < ONE_SIDED * self.events:
                yield f"only {count:,} of {self.events:,} events say {name}"

        duration = self.t_last - self.t_first
        if self.gap_us >= max(GAP_US, GAP_SHARE * duration):
            yield f"no event for {self.gap_us:,} us of {duration:,} us, from {self.gap_from} us on"

        if self.events < MANY_EVENTS:
            return
        hot = self.per_pixel > max(
            HOT_SHARE * self.events, HOT_RATIO * self.events / np.count_nonzero(self.per_pixel)
        )
        if np.any(hot):
            y, x = np.unravel_index(int(np.argmax(self.per_pixel)), self.per_pixel.shape)
            share = self.per_pixel[hot].sum() / self.events
            yield f"{np.count_nonzero(hot)} hot pixels make {share:.1%} of all events, worst at x {x}, y {y}"

        height, width = self.per_pixel.shape
        columns, rows = np.any(self.per_pixel, axis=0), np.any(self.per_pixel, axis=1)
        last_x, last_y = int(np.flatnonzero(columns)[-1]), int(np.flatnonzero(rows)[-1])
        if last_x < UNUSED_SHARE * width or last_y < UNUSED_SHARE * height:
            yield f"no event beyond x {last_x}, y {last_y}: is the sensor really {width}x{height}?"
