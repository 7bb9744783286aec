"""What a page and its metrics tell of a line, kept up to date from records; any thread may look."""

from __future__ import annotations

import base64
import math
import threading
import time
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from evqr.events.array import EventArray
from evqr.sinks.outlet import OutletStatus

EDGES_MS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0)
"""Upper ends of the bins of histograms [ms]; one more bin is open."""

SLOT_S, SLOTS = 60, 120
"""Length [s] and number of the steps of the history."""

SHOWN = 50
"""Parts, and NO READs, that are shown."""

RECENT = 100
"""Parts that the read rate is of."""

VIEW_EVENTS, VIEW_SIDE = 20_000, 320
"""Events that are shown, and the longer side of their picture at most."""


CODE_TRAVEL_PX, CODE_SPAN_US = 4.0, (200.0, 20_000.0)
"""How far a code moves while its events are shown, and the shortest and longest time that takes."""


class Histogram:
    """Counts of times, in bins that grow."""

    def __init__(self) -> None:
        self.counts = [0] * (len(EDGES_MS) + 1)
        self.sum_ms = 0.0

    def add(self, ms: float) -> None:
        """Count a time."""
        self.counts[bisect_left(EDGES_MS, ms)] += 1
        self.sum_ms += ms


class LineState:
    """What has become of a line so far.

    Parameters
    ----------
    line : str
        Its name.
    clock : callable
        Gives the time [s], as ``time.time``.
    """

    def __init__(self, line: str = "", *, clock: Callable[[], float] = time.time) -> None:
        self._lock = threading.Lock()
        self._clock = clock
        self._line = line
        self._started = clock()
        self._counts: Counter[str] = Counter()
        self._reasons: Counter[str] = Counter()
        self._recent: deque[bool] = deque(maxlen=RECENT)
        self._history: deque[list[int]] = deque(maxlen=SLOTS)  # slot, read, not read
        self._parts: deque[dict[str, Any]] = deque(maxlen=SHOWN)
        self._no_reads: deque[dict[str, Any]] = deque(maxlen=SHOWN)
        self._latency, self._compute = Histogram(), Histogram()
        self._last: dict[str, Any] | None = None
        self._view: deque[EventArray] = deque()
        self._of_code: list[EventArray] = []
        self._rate: deque[tuple[float, int]] = deque()
        self._events = 0
        self._behind_ms = 0.0
        self._source, self._source_error = "", "not connected yet"
        self._problems: dict[str, str] = {}
        self._sinks: Callable[[], Sequence[tuple[str, OutletStatus]]] = tuple
        self._job, self._jobs = "", ()

    # ---- what happens

    def uses(self, job: str, jobs: Sequence[str]) -> None:
        """Say which of which jobs is in use."""
        with self._lock:
            self._job, self._jobs = job, tuple(jobs)

    def watch_sinks(self, sinks: Callable[[], Sequence[tuple[str, OutletStatus]]]) -> None:
        """Ask for sinks in this way, by name, whenever somebody looks."""
        self._sinks = sinks

    def connected(self, source: str, error: str = "") -> None:
        """Say that the source is there, or why it is not."""
        with self._lock:
            self._source, self._source_error = source, error
            self._counts["interruptions"] += bool(error)

    def problem(self, of: str, text: str) -> None:
        """Say what is wrong with something, or with an empty text that nothing is any more."""
        with self._lock:
            self._problems[of] = text

    def take(
        self, record: Mapping[str, Any], *, file: str | None = None, modules: Sequence[str] = ()
    ) -> None:
        """Take a record.

        Parameters
        ----------
        record : mapping
            Plain values.
        file : str, optional
            Name of the file with the events of a part that was not read.
        modules : sequence of str
            Of a code that was read: rows of "0" and "1", 1 dark.
        """
        kind = record["record"]
        with self._lock:
            self._counts[kind] += 1
            if kind == "read":
                keys = ("text", "symbology", "version", "corners_px", "t_read_us", "t_utc")
                self._last = {**{key: record.get(key) for key in keys}, "modules": list(modules)}
                self._compute.add(float(record.get("compute_ms", {}).get("total", 0.0)))
                self._keep_code(record)
            elif kind == "part":
                self._take_part(record, file)
            elif kind == "overload":
                self._behind_ms = max(self._behind_ms, float(record.get("behind_ms", 0.0)))

    def _keep_code(self, record: Mapping[str, Any]) -> None:
        """Keep the events of a code that was just read, while it moved by a few pixels."""
        read_us, (u, v) = int(record.get("t_read_us") or 0), record.get("motion_px_per_s") or (0.0, 0.0)
        span_us = 1e6 * CODE_TRAVEL_PX / max(math.hypot(u, v), 1.0)
        first_us = read_us - int(min(max(span_us, CODE_SPAN_US[0]), CODE_SPAN_US[1]))
        parts = [part.between(first_us, read_us + 1) for part in self._view]
        self._of_code = [part for part in parts if len(part)]

    def _take_part(self, record: Mapping[str, Any], file: str | None) -> None:
        read = bool(record.get("texts")) and record.get("matches") is not False
        self._counts["parts_read" if read else "parts_not_read"] += 1
        self._recent.append(read)
        self._latency.add(float(record.get("latency_ms") or 0.0))
        slot = int(self._clock() // SLOT_S)
        if not self._history or self._history[-1][0] != slot:
            self._history.append([slot, 0, 0])
        self._history[-1][1 if read else 2] += 1
        keys = (
            "part", "trigger", "texts", "matches", "reason", "reason_code", "t_utc", "latency_ms", "job",
            "camera",
        )  # fmt: skip
        shown = {**{key: record.get(key) for key in keys}, "read": read, "file": file}
        self._parts.append(shown)
        if not read:
            self._no_reads.append(shown)
            self._reasons[str(record.get("reason_code"))] += 1

    def saw(self, events: EventArray, behind_ms: float = 0.0) -> None:
        """Take events that came, for the rate and the picture.

        Parameters
        ----------
        events : EventArray
            In order of time.
        behind_ms : float [ms]
            How far behind them reading is.
        """
        now = self._clock()
        with self._lock:
            self._events += len(events)
            self._behind_ms = behind_ms
            self._rate.append((now, len(events)))
            while self._rate and self._rate[0][0] < now - 10.0:
                self._rate.popleft()
            if len(events):
                self._view.append(events.cut(max(0, len(events) - VIEW_EVENTS), len(events)))
                while sum(map(len, self._view)) - len(self._view[0]) >= VIEW_EVENTS:
                    self._view.popleft()

    # ---- what is told

    @property
    def problems(self) -> list[str]:
        """What is not as it should be, in words; none where the line is ready."""
        with self._lock:
            found = [f"{self._source or 'source'}: {self._source_error}"] if self._source_error else []
            found += [text for text in self._problems.values() if text]
        return found + [f"{name}: {status.error}" for name, status in self._sinks() if not status.up]

    @property
    def sums_s(self) -> dict[str, float]:
        """Sums of what the histograms count [s]."""
        with self._lock:
            return {"latency_ms": self._latency.sum_ms / 1e3, "compute_ms": self._compute.sum_ms / 1e3}

    def snapshot(self) -> dict[str, Any]:
        """Tell all of it, as JSON has it."""
        sinks = [{"name": name, **vars(status)} for name, status in self._sinks()]
        problems = self.problems
        with self._lock:
            now = self._clock()
            recent = len(self._recent)
            return {
                "line": self._line,
                "job": self._job,
                "jobs": self._jobs,
                "source": self._source,
                "uptime_s": now - self._started,
                "problems": problems,
                "counts": dict(self._counts),
                "reasons": dict(self._reasons.most_common()),
                "read_rate": sum(self._recent) / recent if recent else None,
                "read_rate_of": recent,
                "history": {"slot_s": SLOT_S, "now": int(now // SLOT_S), "slots": list(self._history)},
                "latency_ms": self._latency.counts,
                "compute_ms": self._compute.counts,
                "edges_ms": EDGES_MS,
                "events": self._events,
                "events_per_s": self._events_per_s(now),
                "behind_ms": self._behind_ms,
                "parts": list(self._parts)[::-1],
                "no_reads": list(self._no_reads)[::-1],
                "last": self._last,
                "sinks": sinks,
            }

    def _events_per_s(self, now: float) -> float:
        if not self._rate:
            return 0.0
        return sum(count for _, count in self._rate) / max(1.0, now - self._rate[0][0])

    def view(self) -> dict[str, Any] | None:
        """Draw the last code's events, or without any the newest; None before any came.

        Returns
        -------
        view : dict
            ``width`` and ``height`` of the sensor [px], ``columns`` and ``rows`` of cells, and ``cells``:
            brighter less darker events, int8 by rows in base64; ``of_code``: whether they are a code's.
        """
        with self._lock:
            parts = self._of_code or list(self._view)
            of_code = bool(self._of_code)
        if not parts:
            return None
        width, height = parts[-1].width, parts[-1].height
        step = -(-max(width, height) // VIEW_SIDE)
        columns, rows = -(-width // step), -(-height // step)
        sums = np.zeros(rows * columns, np.int32)
        for part in parts:
            np.add.at(sums, (part.y // step).astype(np.int64) * columns + part.x // step, part.p)
        cells = np.clip(sums, -127, 127).astype(np.int8)
        return {
            "width": width, "height": height, "columns": columns, "rows": rows, "of_code": of_code,
            "cells": base64.b64encode(cells.tobytes()).decode("ascii"),
        }  # fmt: skip
