"""Times of several contestants, one after the other in random order: a slow moment slows all alike."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

LEAST_SECONDS = 2e-3
"""A measurement repeats a call until it takes so long."""

TRIES = 3
"""A measurement is the best of so many: on a shared machine the others were interrupted."""


def repeats(run: Callable[[], object], least: float = LEAST_SECONDS) -> int:
    """Give how many calls take so long; the first call, with what it has to make, does not count."""
    run()
    count = 1
    while (taken := seconds(run, count)) < least:
        count = max(2 * count, min(int(1.2 * count * least / max(taken, 1e-9)), 100 * count))
    return count


def seconds(run: Callable[[], object], count: int) -> float:
    """Time of ``count`` calls."""
    begin = time.perf_counter()
    for _ in range(count):
        run()
    return time.perf_counter() - begin


def interleaved(
    contestants: Mapping[str, Callable[[], float]], rounds: int, seed: int = 0
) -> dict[str, list[float]]:
    """Let each measure itself once a round, in another order every round.

    Parameters
    ----------
    contestants
        each measures, and gives seconds a call
    """
    rng = random.Random(seed)
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name in rng.sample(list(contestants), len(contestants)):
            times[name].append(contestants[name]())
    return times


def measured(
    run: Callable[[], object], wait: Callable[[], None] = lambda: None, least: float = LEAST_SECONDS
) -> Callable[[], float]:
    """Make what measures a call; ``wait`` is for what has been launched."""

    def launch_and_wait() -> None:
        run()
        wait()

    count = repeats(launch_and_wait, least)

    def once() -> float:
        begin = time.perf_counter()
        for _ in range(count):
            run()
        wait()
        return (time.perf_counter() - begin) / count

    return lambda: min(once() for _ in range(TRIES))


def measured_together(runs: list[Callable[[], object]], pool: ThreadPoolExecutor) -> Callable[[], float]:
    """Make what measures calls in a thread each, until the last has ended: seconds for one call of each."""
    count = 4 * repeats(runs[0])  # that one starts or ends before another must not matter
    gate = Barrier(len(runs))

    def work(run: Callable[[], object]) -> tuple[float, float]:
        gate.wait()
        begin = time.perf_counter()
        for _ in range(count):
            run()
        return begin, time.perf_counter()

    def once() -> float:
        begins, ends = zip(*pool.map(work, runs), strict=True)
        return (max(ends) - min(begins)) / count

    return lambda: min(once() for _ in range(TRIES))
