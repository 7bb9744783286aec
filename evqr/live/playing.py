"""A recording, played as if a camera sent it."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace

from evqr.events.array import EventArray
from evqr.live.pieces import Events, Piece, Sensor, TimePasses, TriggerSeen
from evqr.recording import Recording
from evqr.recording.source import RawColumns
from evqr.recording.triggers import TriggerKind

PIECE_US = 5_000
"""Events that come together, where nothing says how fast [us]."""

LIVE_PIECE_US = 1_000
"""The same where a speed is asked for: a camera's packets [us]."""


PAUSE_US = 20_000
"""Between a recording and the same again [us]."""


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
    repeat : bool
        Play it again and again, with times that go on.
    triggers : bool
        Give the triggers that are in the recording, too, each before the events of its time.
    """

    def __init__(
        self,
        recording: Recording,
        name: str,
        *,
        speed: float | None = None,
        repeat: bool = False,
        triggers: bool = False,
    ) -> None:
        self.name = name
        self._recording = recording
        self._speed = speed
        self._repeat = repeat
        self._triggers = triggers
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
        edges = self._recording.triggers() if self._triggers else []
        yield Sensor(self._recording.width, self._recording.height)
        began, first_us, shift_us = time.monotonic(), None, 0
        while not self._stopped.is_set():
            waiting = deque[tuple[int, TriggerKind]]((t_us + shift_us, kind) for t_us, kind in edges)
            last_us = 0
            for chunk in self._recording.chunks():
                first_us = int(chunk.t[0]) if first_us is None else first_us
                last_us = int(chunk.t[-1]) + shift_us
                yield from self._chunk(later(chunk, shift_us), waiting, began, first_us)
            yield from _due(waiting, math.inf)
            if not self._repeat or first_us is None:
                return
            shift_us = last_us + PAUSE_US - first_us
            yield TimePasses(last_us + PAUSE_US)

    def _chunk(
        self, chunk: EventArray, edges: deque[tuple[int, TriggerKind]], began: float, first_us: int
    ) -> Iterator[Piece]:
        """Give some events, no sooner than is asked for."""
        length_us = PIECE_US if self._speed is None else LIVE_PIECE_US
        start_us, end_us = int(chunk.t[0]), int(chunk.t[-1])
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


def later(events: EventArray, by_us: int) -> EventArray:
    """Give events at later times."""
    return replace(events, t=events.t + by_us) if by_us else events


def _due(edges: deque[tuple[int, TriggerKind]], before_us: float) -> Iterator[TriggerSeen]:
    """Take the triggers before a time."""
    while edges and edges[0][0] < before_us:
        yield TriggerSeen(*edges.popleft())


def columns_of(events: EventArray) -> RawColumns:
    """Give events as a source does."""
    return RawColumns(events.t, events.x, events.y, events.p)
