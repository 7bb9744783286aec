"""A recording, played as if a camera sent it."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Iterator

from evqr.events.array import EventArray
from evqr.live.pieces import Events, Piece, Sensor, TimePasses, TriggerSeen
from evqr.recording import Recording
from evqr.recording.source import RawColumns
from evqr.recording.triggers import TriggerKind

PIECE_US = 5_000
"""Events that come together, where nothing says how fast [us]."""

LIVE_PIECE_US = 1_000
"""The same where a speed is asked for: a camera's packets [us]."""


class Playing:
    """A stream of events from a recording.

    Parameters
    ----------
    recording : Recording
        Open.
    name : str
        What it is called.
    speed : float, optional
        Time of the recording over time: 1 as it was. Default: as fast as it is read.
    triggers : bool
        Give the triggers that are in the recording, too, each before the events of its time.
    """

    def __init__(
        self, recording: Recording, name: str, *, speed: float | None = None, triggers: bool = False
    ) -> None:
        self.name = name
        self._triggers = triggers
        self._recording = recording
        self._speed = speed
        self._stopped = threading.Event()

    def stop(self) -> None:
        """End `pieces` soon; any thread, and the handler of a signal, may say so."""
        self._stopped.set()

    def pieces(self) -> Iterator[Piece]:
        """Give its events, until its end or until it is stopped.

        Yields
        ------
        piece : Piece
            The size of the sensor first.

        Raises
        ------
        RecordingError
            The recording is wrong, from here on; or no triggers are read from such files.
        """
        edges = deque(self._recording.triggers() if self._triggers else ())
        yield Sensor(self._recording.width, self._recording.height)
        length_us = PIECE_US if self._speed is None else LIVE_PIECE_US
        began, first_us = time.monotonic(), None
        for chunk in self._recording.chunks():
            start_us, end_us = int(chunk.t[0]), int(chunk.t[-1])
            first_us = start_us if first_us is None else first_us
            while start_us <= end_us:
                piece = chunk.between(start_us, start_us + length_us)
                if self._speed is not None:
                    due_s = 1e-6 * (start_us + length_us - first_us) / self._speed
                    self._stopped.wait(max(0.0, began + due_s - time.monotonic()))
                if self._stopped.is_set():
                    return
                yield from _due(edges, start_us + length_us)
                if len(piece):
                    yield Events(columns_of(piece))
                    start_us += length_us
                else:  # nothing for a while
                    next_us = int(chunk.t[chunk.first_at(start_us)])
                    start_us = next_us if self._speed is None else min(start_us + length_us, next_us)
                    yield TimePasses(start_us)
        yield from _due(edges, math.inf)


def _due(edges: deque[tuple[int, TriggerKind]], before_us: float) -> Iterator[TriggerSeen]:
    """Take the triggers before a time."""
    while edges and edges[0][0] < before_us:
        yield TriggerSeen(*edges.popleft())


def columns_of(events: EventArray) -> RawColumns:
    """Give events as a source does."""
    return RawColumns(events.t, events.x, events.y, events.p)
