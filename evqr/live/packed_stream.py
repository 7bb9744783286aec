"""A stream of packed events, for cameras' programs to write and a line to read.

A head, then frames, all numbers little-endian:

| what | bytes |
|---|---|
| head | ``EVQRPKT1``, width u16, height u16, 0 u32 |
| frame | kind u32, count u32, then |
| events (1) | time of reference i64 [us], then ``count`` times x u16, y u16, stamp u32 |
| trigger (2), count 1 | time i64 [us], kind u32, 0 u32, index i64 (-1: none), ticks f64 (NaN: none) |
| time (3), count 1 | time i64 [us]: all events before it are there |

A stamp is twice the time since the reference, below 2^31 us, plus the polarity: 1 brighter, 0 darker.  Kinds
of triggers: 0 pulse, 1 start, 2 end.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from typing import IO

import numpy as np
from numpy.typing import ArrayLike

from evqr.errors import RecordingError
from evqr.live.pieces import Events, Piece, Sensor, TimePasses, TriggerSeen
from evqr.recording.source import RawColumns
from evqr.recording.triggers import TriggerKind

MAGIC = b"EVQRPKT1"
HEAD = struct.Struct("<8sHHI")
FRAME = struct.Struct("<II")
REFERENCE = struct.Struct("<q")
TRIGGER = struct.Struct("<qIIqd")
EVENT = np.dtype([("x", "<u2"), ("y", "<u2"), ("stamp", "<u4")])

EVENTS, TRIGGER_AT, TIME = 1, 2, 3
KINDS: tuple[TriggerKind, ...] = ("pulse", "start", "end")

MOST_EVENTS = 1 << 20
"""Events of one frame: what a reader must hold."""

SPAN_US = 1 << 31


class PackedDecoder:
    """Decodes a stream as its bytes come.

    Parameters
    ----------
    name : str
        The source, for messages.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._rest = b""
        self._begun = False

    def feed(self, data: bytes) -> Iterator[Piece]:
        """Take bytes; give what is whole.

        Raises
        ------
        RecordingError
            They are not such a stream: what follows cannot be read either.
        """
        data = self._rest + data
        at = 0
        if not self._begun:
            if len(data) < HEAD.size:
                self._rest = data
                return
            magic, width, height, _ = HEAD.unpack_from(data)
            if magic != MAGIC or not width or not height:
                raise self._damaged(f"begins with {data[: HEAD.size]!r}")
            self._begun, at = True, HEAD.size
            yield Sensor(width, height)
        while len(data) - at >= FRAME.size:
            kind, count = FRAME.unpack_from(data, at)
            end = at + FRAME.size + self._size(kind, count)
            if end > len(data):
                break
            yield self._piece(kind, count, data, at + FRAME.size)
            at = end
        self._rest = data[at:]

    def _size(self, kind: int, count: int) -> int:
        if kind == EVENTS and count <= MOST_EVENTS:
            return REFERENCE.size + count * EVENT.itemsize
        if kind == TRIGGER_AT and count == 1:
            return TRIGGER.size
        if kind == TIME and count == 1:
            return REFERENCE.size
        raise self._damaged(f"has a frame of kind {kind} with {count} entries")

    def _piece(self, kind: int, count: int, data: bytes, at: int) -> Piece:
        if kind == TIME:
            return TimePasses(*REFERENCE.unpack_from(data, at))
        if kind == TRIGGER_AT:
            t_us, what, _, index, ticks = TRIGGER.unpack_from(data, at)
            if what >= len(KINDS):
                raise self._damaged(f"has a trigger of kind {what}")
            return TriggerSeen(
                t_us, KINDS[what], None if index < 0 else index, None if math.isnan(ticks) else ticks
            )
        (reference_us,) = REFERENCE.unpack_from(data, at)
        events = np.frombuffer(data, EVENT, count, at + REFERENCE.size)
        stamp = events["stamp"]
        t = np.int64(reference_us) + (stamp >> np.uint32(1)).astype(np.int64)
        polarity = (stamp & np.uint32(1)).astype(np.uint8)
        return Events(RawColumns(t, events["x"], events["y"], polarity))

    def _damaged(self, what: str) -> RecordingError:
        return RecordingError(f"{self._name}: {what}, which packed streams do not; see what writes them")


class PackedWriter:
    """Writes such a stream to a socket's file or any other that is binary.

    Parameters
    ----------
    file : binary file
        As of ``socket.makefile("wb")``.
    sensor : (int, int) [px]
        Width and height.
    """

    def __init__(self, file: IO[bytes], sensor: tuple[int, int]) -> None:
        self._file = file
        file.write(HEAD.pack(MAGIC, *sensor, 0))

    def events(self, t: ArrayLike, x: ArrayLike, y: ArrayLike, p: ArrayLike) -> None:
        """Write events.

        Parameters
        ----------
        t, x, y, p : (E,) array-like
            Times [us], columns, rows; positive polarities are brighter.

        Raises
        ------
        ValueError
            A column or row is not of 16 bits.
        """
        t = np.asarray(t, np.int64)
        columns = [np.asarray(each) for each in (x, y)]
        for name, each in zip("xy", columns, strict=True):
            if each.size and not (0 <= each.min() and each.max() < 1 << 16):
                raise ValueError(f"{name} must be 0 to 65535, got {each.min()} to {each.max()}")
        brighter = np.asarray(p) > 0
        first = 0
        while first < len(t):
            last = min(first + MOST_EVENTS, len(t))
            part = t[first:last]
            spans = np.maximum.accumulate(part) - np.minimum.accumulate(part)
            last = first + int(np.searchsorted(spans, SPAN_US))
            reference_us = int(t[first:last].min())
            events = np.empty(last - first, EVENT)
            events["x"], events["y"] = (each[first:last] for each in columns)
            events["stamp"] = 2 * (t[first:last] - reference_us) + brighter[first:last]
            self._file.write(
                FRAME.pack(EVENTS, len(events)) + REFERENCE.pack(reference_us) + events.tobytes()
            )
            first = last

    def trigger(
        self, t_us: int, kind: TriggerKind = "pulse", *, index: int | None = None, ticks: float | None = None
    ) -> None:
        """Write a trigger.

        Parameters
        ----------
        t_us : int [us]
            By the clock of the events.
        kind : "pulse", "start" or "end"
            What it means.
        index : int, optional
            Its number.
        ticks : float, optional
            Of an encoder.
        """
        given = (
            t_us,
            KINDS.index(kind),
            0,
            -1 if index is None else index,
            math.nan if ticks is None else ticks,
        )
        self._file.write(FRAME.pack(TRIGGER_AT, 1) + TRIGGER.pack(*given))

    def time(self, t_us: int) -> None:
        """Say that all events before a time are written.

        Parameters
        ----------
        t_us : int [us]
            By the clock of the events.
        """
        self._file.write(FRAME.pack(TIME, 1) + REFERENCE.pack(t_us))

    def flush(self) -> None:
        """Send what is written."""
        self._file.flush()
