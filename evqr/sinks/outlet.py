"""One sink with the records that wait for it, and a thread that delivers them: no sink holds up a line."""

from __future__ import annotations

import contextlib
import logging
import math
import threading
import time
from dataclasses import dataclass
from enum import Enum
from os import PathLike

from evqr.sinks.sink import JsonRecord, Sink
from evqr.sinks.waiting import InMemory, Spool, Waiting

_LOG = logging.getLogger(__name__)

AT_ONCE = 100
"""Records that are delivered together at most."""


class WhenFull(str, Enum):
    """What becomes of a record for which there is no room.

    With BLOCK the line waits until there is; with DROP the record is left out and counted, and a record
    "lost" says so once there is room.
    """

    BLOCK = "block"
    DROP = "drop"


@dataclass(frozen=True)
class OutletStatus:
    """How a sink is doing.

    Attributes
    ----------
    up : bool
        Whether the last delivery succeeded.
    waiting : int
        Records that are not delivered yet.
    delivered, lost, refused : int
        Records since the start: delivered, left out for want of room, and refused by the sink.
    failures : int
        Deliveries that failed, and were tried again.
    error : str
        Of the last one that failed; "" while all is well.
    """

    up: bool
    waiting: int
    delivered: int
    lost: int
    refused: int
    failures: int
    error: str


class Outlet:
    """Delivers records to a sink from a thread of its own; a context manager.

    A sink that is away is tried again, at growing intervals, and gets the same records again: each arrives at
    least once as long as there was room for it, with a spool also over an end of the program.

    Parameters
    ----------
    sink : Sink
        Where records go.
    room : int
        Records that may wait in memory, without a spool.
    spool : path, optional
        A file for the records that wait, instead of memory.
    spool_bytes : int
        Room in it.
    when_full : WhenFull
        What becomes of a record for which there is no room.
    retry_s : (float, float) [s]
        First and longest time between two tries.
    at_once : bool
        Open the sink before there is a record: it listens.

    Raises
    ------
    UsageError
        The spool cannot be used.
    """

    def __init__(
        self,
        sink: Sink,
        *,
        room: int = 10_000,
        spool: str | PathLike[str] | None = None,
        spool_bytes: int = 1 << 30,
        when_full: WhenFull = WhenFull.DROP,
        retry_s: tuple[float, float] = (0.2, 30.0),
        at_once: bool = False,
    ) -> None:
        self._sink, self._at_once = sink, at_once
        self._waiting: Waiting = InMemory(room) if spool is None else Spool(spool, spool_bytes)
        self._when_full, self._retry_s = WhenFull(when_full), retry_s
        self._changed = threading.Condition()  # of all below
        self._closing = threading.Event()
        self._ends_at = math.inf
        self._is_open = False
        self._delivered = self._lost = self._refused = self._failures = 0
        self._missing: list[int] = []  # sequence numbers of records lost since the last "lost" record
        self._error = ""
        self._thread = threading.Thread(target=self._run, name=f"evqr {sink.name}", daemon=True)
        self._thread.start()

    def __enter__(self) -> Outlet:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    @property
    def status(self) -> OutletStatus:
        """How the sink is doing."""
        with self._changed:
            return OutletStatus(
                up=not self._error,
                waiting=len(self._waiting),
                delivered=self._delivered,
                lost=self._lost,
                refused=self._refused,
                failures=self._failures,
                error=self._error,
            )

    def put(self, record: JsonRecord) -> None:
        """Take a record.

        Parameters
        ----------
        record : mapping
            Plain values; its ``sequence``, where it has one, is told if it is lost.

        Raises
        ------
        ValueError
            After `close`.
        """
        with self._changed:
            if self._closing.is_set():
                raise ValueError(f"{self._sink.name} is closed")
            taken = self._take(record)
            while not taken and self._when_full is WhenFull.BLOCK and not self._closing.is_set():
                self._changed.wait()
                taken = self._take(record)
            if not taken:
                self._lost += 1
                self._missing.append(int(record.get("sequence", -1)))
            self._changed.notify_all()

    def close(self, timeout_s: float = 10.0) -> OutletStatus:
        """Deliver what waits, as far as the time allows; what is in a spool then stays there.

        Parameters
        ----------
        timeout_s : float [s]
            Most time to wait.

        Returns
        -------
        status : OutletStatus
            The last one; ``waiting`` records were not delivered.
        """
        with self._changed:
            if not self._closing.is_set() and self._missing and self._put(_lost_record(self._missing)):
                self._missing = []
            self._ends_at = time.monotonic() + timeout_s
            self._closing.set()
            self._changed.notify_all()
        self._thread.join(timeout_s)
        status = self.status
        with self._changed:
            self._waiting.close()
        return status

    def _take(self, record: JsonRecord) -> bool:
        """Let a record wait, behind one that tells of those that were lost before it; False without room."""
        if self._missing:
            if not self._put(_lost_record(self._missing)):
                return False
            self._missing = []
        return self._put(record)

    def _put(self, record: JsonRecord) -> bool:
        try:
            return self._waiting.put(record)
        except Exception as error:  # the disk of the spool is full, or gone: the line goes on
            self._failed(error)
            return False

    def _run(self) -> None:
        """Deliver, until there is nothing left and nothing will come."""
        pause_s, longest_s = self._retry_s
        if self._at_once:
            try:
                self._open()
            except Exception as error:  # the first record tries again
                with self._changed:
                    self._failed(error)
        while records := self._next():
            try:
                refused = self._deliver(records)
            except Exception as error:  # whatever a sink's library raises, it is tried again
                with self._changed:
                    self._failed(error)
                self._let_go()
                self._closing.wait(pause_s)
                if self._closing.is_set():
                    time.sleep(max(0.0, min(pause_s, self._ends_at - time.monotonic())))
                pause_s = min(2.0 * pause_s, longest_s)
                continue
            pause_s = self._retry_s[0]
            with self._changed:
                self._done(records, refused)
        self._let_go()

    def _next(self) -> list[JsonRecord]:
        """Wait for records; none when it is over."""
        with self._changed:
            while not len(self._waiting) and not self._closing.is_set():
                self._changed.wait()
            over = self._closing.is_set() and time.monotonic() >= self._ends_at
            return [] if over else self._waiting.first(AT_ONCE)

    def _deliver(self, records: list[JsonRecord]) -> str:
        self._open()
        return self._sink.write(records)

    def _open(self) -> None:
        if not self._is_open:
            self._sink.open()
            self._is_open = True

    def _done(self, records: list[JsonRecord], refused: str) -> None:
        self._waiting.done(len(records))
        if refused:
            _LOG.error("%s: %d records are refused (%s)", self._sink.name, len(records), refused)
            self._refused += len(records)
        else:
            self._delivered += len(records)
            if self._error:
                _LOG.warning("%s: is back", self._sink.name)
            self._error = ""
        self._changed.notify_all()

    def _failed(self, error: Exception) -> None:
        said = " ".join(str(error).split()) or type(error).__name__
        if not self._error:
            _LOG.warning("%s: %s; trying again", self._sink.name, said)
        self._failures += 1
        self._error = said

    def _let_go(self) -> None:
        if self._is_open:
            self._is_open = False
            with contextlib.suppress(Exception):  # it was lost already
                self._sink.close()


def _lost_record(sequence: list[int]) -> JsonRecord:
    """Tell of records that were left out."""
    return {"record": "lost", "records": len(sequence), "first": min(sequence), "last": max(sequence)}
