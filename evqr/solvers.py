"""Solvers for those who read recordings: new ones, or such as were kept from one recording to the next.

What a solver makes once, buffers, tables and recorded launches, takes as long as reading a short recording.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from evqr.config import ReadConfig
from evqr.solver import Solver


class KeptSolvers:
    """Keeps the solvers of the last recording for the next one that is read in the same way."""

    def __init__(self) -> None:
        self._key: Any = None
        self._solvers: list[Solver] = []

    @contextmanager
    def used(self) -> Iterator[None]:
        """Let `solvers_for` take them, in this thread, and give them back."""
        before, _this_thread.kept = _this_thread.kept, self
        try:
            yield
        finally:
            _this_thread.kept = before

    def take(self, key: Any) -> list[Solver]:
        """Give what was kept for a key, which is kept no longer."""
        solvers, self._solvers = self._solvers, []
        return solvers if self._key == key else []

    def keep(self, key: Any, solvers: list[Solver]) -> None:
        """Keep solvers until they are asked for, or others are kept."""
        self._key, self._solvers = key, solvers

    @classmethod
    def of_this_thread(cls) -> KeptSolvers:
        """Give those that live as long as the thread does."""
        if _this_thread.own is None:
            _this_thread.own = cls()
        return _this_thread.own


class _ThisThread(threading.local):
    """What is used at the moment, and what is kept as long as the thread lives."""

    kept: KeptSolvers | None = None
    own: KeptSolvers | None = None


_this_thread = _ThisThread()


@contextmanager
def solvers_for(
    count: int, config: ReadConfig | None, *, backend: str, device: str
) -> Iterator[list[Solver]]:
    """Give solvers to read a recording with.

    Parameters
    ----------
    count : int
        How many.
    config, backend, device : as for `Solver`
        The same for all.

    Yields
    ------
    solvers : list of Solver
        For one user at a time; kept for the next where that is asked for, unless there was an exception.
    """
    kept = _this_thread.kept
    key = count, ReadConfig.of(config), backend, device
    solvers = [] if kept is None else kept.take(key)
    solvers = solvers or [Solver(config, backend=backend, device=device) for _ in range(count)]
    yield solvers
    if kept is not None:
        kept.keep(key, solvers)
