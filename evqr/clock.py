"""Milliseconds by stage, measured where a stage runs and handed on with its result; and times in UTC."""

from __future__ import annotations

import threading
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime, timezone
from typing import Any, TypeVar

Asked = TypeVar("Asked")
Answer = TypeVar("Answer")
T = TypeVar("T")


def utc_text(seconds: float | None = None) -> str:
    """Write a time as all records and logs have it.

    Parameters
    ----------
    seconds : float, optional [s]
        Since 1970. Default: now.

    Returns
    -------
    text : str
        In UTC, to the millisecond, such as ``2026-11-30T08:15:02.125Z``.
    """
    at = datetime.fromtimestamp(time.time() if seconds is None else seconds, timezone.utc)
    return at.isoformat(timespec="milliseconds").replace("+00:00", "Z")


ONE_TIME = "one_time"
"""The stage of what is done once and then kept: loading kernels, making tables, recording launches."""


class _OneTime(threading.local):
    """Of each thread: how deep it is in work that is done once, and what of that no stage has yet [ms]."""

    depth = 0
    ms = 0.0


_one_time = _OneTime()


@contextmanager
def one_time() -> Iterator[None]:
    """Time work that is done once: it is no part of the stage in which it happens to be done first."""
    _one_time.depth += 1
    start = time.perf_counter()
    try:
        yield
    finally:
        _one_time.depth -= 1
        if not _one_time.depth:
            _one_time.ms += 1e3 * (time.perf_counter() - start)


class _Timed:
    """Adds what is done under it to the times of a stage."""

    # no generator: a window has a dozen of them
    __slots__ = ("_before", "_ms", "_name", "_start")

    def __init__(self, ms: dict[str, float], stage: str) -> None:
        self._ms, self._name = ms, stage

    def __enter__(self) -> None:
        self._before = _one_time.ms
        self._start = time.perf_counter()

    def __exit__(self, *raised: object) -> None:
        elapsed, ms = 1e3 * (time.perf_counter() - self._start), self._ms
        once = _one_time.ms - self._before
        if once:
            _one_time.ms = self._before
            ms[ONE_TIME] = ms.get(ONE_TIME, 0.0) + once
        ms[self._name] = ms.get(self._name, 0.0) + max(elapsed - once, 0.0)


class StageClock:
    """Milliseconds by stage.

    Attributes
    ----------
    ms : dict of str to float [ms]
        What each stage took so far.
    """

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}

    def __call__(self, stage: str) -> _Timed:
        """Time a stage; times of the same stage add up.  What is done once in it is a stage of its own."""
        return _Timed(self.ms, stage)

    def pausing(self, stage: str, asking: Generator[Asked, Answer, T]) -> Generator[Asked, Answer, T]:
        """Time work that pauses to ask for something: until it is answered, no time is counted."""
        answer: Any = None
        while True:
            try:
                with self(stage):
                    asked = asking.send(answer)
            except StopIteration as end:
                return end.value
            answer = yield asked

    def add(self, timings_ms: Mapping[str, float]) -> None:
        """Add what others measured."""
        for stage, ms in timings_ms.items():
            self.ms[stage] = self.ms.get(stage, 0.0) + ms

    def total(self) -> dict[str, float]:
        """Give the stages and their sum, "total"."""
        return {**self.ms, "total": sum(self.ms.values())}
