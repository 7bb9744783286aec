"""The part of a stream that windows are still cut from."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np

from evqr.events.array import EventArray
from evqr.events.window import Window


class EventBuffer:
    """The part of a stream that windows are still cut from.

    Holds whole chunks, from the oldest one that is still wanted to the newest one that was asked for;
    `forget` lets go of the old ones, so the memory is bounded by the longest window and one chunk.  Several
    threads may cut windows at once.
    """

    def __init__(self, chunks: Iterator[EventArray]) -> None:
        self._chunks = chunks
        self._held: list[EventArray] = []
        self._ended = False
        self._lock = threading.RLock()
        self.first_us: int | None = None
        self.seen = 0
        self._load()

    def _load(self) -> None:
        for chunk in self._chunks:
            if len(chunk):
                if self.first_us is None:
                    self.first_us = int(chunk.t[0])
                self.seen += len(chunk)
                self._held.append(chunk)
                return
        self._ended = True

    @property
    def last_us(self) -> int:
        """Time of the newest event held [us]."""
        return int(self._held[-1].t[-1])

    def reaches(self, time_us: float) -> bool:
        """Load the stream up to a time; False when it ends before."""
        with self._lock:
            while not self._ended and (not self._held or self.last_us < time_us):
                self._load()
            return bool(self._held) and self.last_us >= time_us

    def forget(self, before_us: float) -> None:
        """Let go of chunks that end before a time."""
        with self._lock:
            while len(self._held) > 1 and self._held[0].t[-1] < before_us:
                self._held.pop(0)

    def window(self, start_us: int, end_us: int) -> Window:
        """Cut a window, loading what it needs."""
        with self._lock:
            self.reaches(end_us)
            held = list(self._held)
        chunks = [chunk for chunk in held if chunk.t[-1] >= start_us and chunk.t[0] < end_us]
        if len(chunks) == 1:
            first, last = chunks[0].first_at(start_us), chunks[0].first_at(end_us)
            return Window(chunks[0].cut(first, last), start_us, end_us, origin=(chunks[0], first))
        parts = [chunk.between(start_us, end_us) for chunk in chunks] or [held[-1].cut(0, 0)]
        joined = EventArray(
            np.concatenate([part.t for part in parts]),
            np.concatenate([part.x for part in parts]),
            np.concatenate([part.y for part in parts]),
            np.concatenate([part.p for part in parts]),
            parts[0].width,
            parts[0].height,
        )
        return Window(joined, start_us, end_us)
