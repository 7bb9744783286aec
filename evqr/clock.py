"""Milliseconds by stage, measured where a stage runs and handed on with its result."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

Asked = TypeVar("Asked")
Answer = TypeVar("Answer")
T = TypeVar("T")


class StageClock:
    """Milliseconds by stage.

    Attributes
    ----------
    ms : dict of str to float [ms]
        What each stage took so far.
    """

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time a stage; times of the same stage add up."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.ms[stage] = self.ms.get(stage, 0.0) + 1e3 * (time.perf_counter() - start)

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
