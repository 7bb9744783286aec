"""The events of the last seconds, in a ring; those of parts that were not read go to files."""

from __future__ import annotations

import logging
import re
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from os import PathLike
from pathlib import Path

import numpy as np

from evqr.errors import EvqrError, UsageError
from evqr.events.array import EventArray
from evqr.recording.writing import save_recording

_LOG = logging.getLogger(__name__)

MOST_UNWRITTEN = 4
"""Recordings that wait for the disk; the line does not wait for it, so more are left out."""

SUFFIX = ".h5"


class FlightRecorder:
    """Keeps events of the last seconds; writes those of some time to files that `evqr read` opens.

    Memory is bounded by ``most_events``, 13 bytes each; the disk by ``quota_bytes``: the oldest files go.

    Parameters
    ----------
    folder : path
        Where files go; made where it is not there.
    seconds : float [s]
        How long events are kept.
    most_events : int
        Events that are kept at once; of a busier stream, fewer seconds.
    quota_bytes : int
        Of all files that it has written there.

    Attributes
    ----------
    left_out : int
        Recordings that were not written: the disk was slow, full or gone, or their events had gone already.

    Raises
    ------
    UsageError
        The folder cannot be made.
    """

    def __init__(
        self,
        folder: str | PathLike[str],
        *,
        seconds: float = 10.0,
        most_events: int = 50_000_000,
        quota_bytes: int = 1 << 30,
    ) -> None:
        self.folder = Path(folder)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"{folder}: cannot be made ({error.strerror}); name another folder") from error
        self.left_out = 0
        self._span_us, self._most_events, self._quota_bytes = round(1e6 * seconds), most_events, quota_bytes
        self._ring: deque[EventArray] = deque()
        self._count = 0
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="evqr flight recorder")
        self._writing: deque[Future[bool]] = deque()

    def push(self, events: EventArray) -> None:
        """Keep events, and let old ones go.

        Parameters
        ----------
        events : EventArray
            In order of time; ones before the newest begin anew, as those of a clock that was reset.
        """
        if not len(events):
            return
        if self._ring and events.t[0] < self._ring[-1].t[-1]:
            self._ring.clear()
            self._count = 0
        self._ring.append(events)
        self._count += len(events)
        oldest = int(events.t[-1]) - self._span_us
        while len(self._ring) > 1 and (self._ring[0].t[-1] < oldest or self._count > self._most_events):
            self._count -= len(self._ring.popleft())

    def keep(self, name: str, start_us: int, end_us: int) -> Path | None:
        """Write the events of some time to a file, soon.

        Parameters
        ----------
        name : str
            Of the file, without suffix; what names of files may not have is replaced.
        start_us, end_us : int [us]
            Events with ``start_us <= t < end_us``.

        Returns
        -------
        path : Path or None
            Where they will be; None where there are none any more, or too many files wait already.
        """
        while self._writing and self._writing[0].done():
            self.left_out += not self._writing.popleft().result()
        parts = [part for each in self._ring if len(part := each.between(start_us, end_us))]
        if not parts or len(self._writing) >= MOST_UNWRITTEN:
            self.left_out += 1
            return None
        path = self.folder / f"{re.sub(r'[^A-Za-z0-9._-]+', '_', name)}{SUFFIX}"
        self._writing.append(self._writer.submit(self._write, path, parts))
        return path

    def close(self) -> None:
        """Wait until all is written."""
        self._writer.shutdown()
        while self._writing:
            self.left_out += not self._writing.popleft().result()

    def _write(self, path: Path, parts: list[EventArray]) -> bool:
        """Write a file, and let the oldest go; False where the disk does not take it."""
        t, x, y, p = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("t", "x", "y", "p")
        )
        try:
            save_recording(path, EventArray(t, x, y, p, parts[0].width, parts[0].height))
            self._prune(path)
        except (EvqrError, OSError) as error:
            _LOG.warning("events of a part are not kept: %s", error)
            return False
        return True

    def _prune(self, newest: Path) -> None:
        files = sorted(
            ((file.stat().st_mtime_ns, file.stat().st_size, file) for file in self.folder.glob(f"*{SUFFIX}")),
            key=lambda each: each[:1],
        )
        total = sum(size for _, size, _ in files)
        for _, size, file in files:
            if total <= self._quota_bytes or file == newest:
                break
            file.unlink(missing_ok=True)
            total -= size
