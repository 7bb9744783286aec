"""A buffer that pulls what it lacks out of the chunks of a recording."""

from __future__ import annotations

import threading

from evqr.events.buffer import EventBuffer
from evqr.events.window import Window
from evqr.recording import Recording


class Feed(EventBuffer):
    """A buffer that pulls what it lacks out of the chunks of a recording."""

    def __init__(self, recording: Recording) -> None:
        super().__init__(recording.width, recording.height)
        self._chunks = recording.chunks()
        self._lock = threading.Lock()
        self.reaches(float("-inf"))

    def reaches(self, time_us: float) -> bool:
        """Load the stream up to a time; False when it ends before."""
        with self._lock:
            while not self.closed and (self.last_us is None or self.last_us < time_us):
                chunk = next(self._chunks, None)
                if chunk is None:
                    self.close()
                else:
                    self.push(chunk)
        return super().reaches(time_us)

    def window(self, start_us: int, end_us: int) -> Window:
        """Cut a window, loading what it needs."""
        self.reaches(end_us)
        return super().window(start_us, end_us)
