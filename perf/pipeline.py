"""The ways to read one window that are timed beside each other, each from the same events.

cold        nothing known: motion, search, stage one, lags, stage two, decoding
tracked     the code was seen in the window before: stage one, stage two, decoding
integrate   rival (a): the same motion from cold, an image by integration, an ordinary decoder
integrate4  the same over a window twice as long, which it reads more of
descent     rival (b): the paper's gradient descent, from the motion and the pose that stage one starts from

`against.py` runs this file as it is at other commits: `Recording`, `prepare`, `can_run`, `RUN` and a job's
``start_us`` keep their names and arguments.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from evqr.clock import StageClock
from evqr.events.array import EventArray
from evqr.events.batch import EventBatch
from evqr.events.buffer import EventBuffer
from evqr.events.window import Window
from evqr.fit.detection import Detection, NotFound
from evqr.fit.modules import NormalEquations
from evqr.geometry import outline
from evqr.motion import Motion
from evqr.paper.methods import descent, integrate
from evqr.search.finder import find_patterns
from evqr.search.motion_estimate import MotionEstimate
from evqr.search.triples import codes_of_triples
from evqr.solver import Solver
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded

METHODS = ("cold", "tracked", "integrate", "integrate4", "descent")


@dataclass(frozen=True, eq=False)
class Recording:
    """Events with what a right reader gets out of them."""

    case: str
    events: EventArray
    texts: frozenset[str]
    starts_us: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Job:
    """One window, and what each method may know beforehand.

    Attributes
    ----------
    window_us   length of the window, as the solver chooses it; 0 where nothing moves
    before      the code as seen one window earlier, for "tracked"; None where it was not found
    start       first guess of motion, pose and version, for "descent"; None where the search found none
    """

    recording: Recording
    buffer: EventBuffer
    start_us: int
    window_us: int
    before: Detection | None
    start: tuple[Motion, np.ndarray, int] | None


@dataclass(frozen=True)
class Timing:
    """One method on one window, once: milliseconds by stage and in all, and whether the text was right."""

    case: str
    job: int
    method: str
    ms: dict[str, float]
    total: float
    verdict: str


def prepare(recording: Recording, solver: Solver) -> list[Job]:
    """Find out, untimed, what "tracked" and "descent" start from."""
    buffer = EventBuffer.of(recording.events)
    jobs = []
    for start_us in recording.starts_us:
        moving = buffer.answer(solver.motion_at(start_us))
        if isinstance(moving, NotFound):
            if not recording.texts:  # what it costs to see that nothing moves
                jobs.append(Job(recording, buffer, start_us, 0, None, None))
            continue
        motion = moving.motion
        length = solver.window_us(motion)
        before = start = None
        earlier = buffer.window(start_us - length, start_us)
        (seen,) = solver.find(EventBatch.of([earlier]), [motion])
        if not isinstance(seen, NotFound):
            before = seen[0]
            window = buffer.window(start_us, start_us + length)
            start = _search(window, motion, before, solver)
        jobs.append(Job(recording, buffer, start_us, length, before, start))
    return jobs


def _search(
    window: Window, motion: Motion, seen: Detection, solver: Solver
) -> tuple[Motion, np.ndarray, int] | None:
    """Return what the search finds of a code whose place is known: the pose before any refinement."""
    cfg = solver.config.finder
    (found,), _ = find_patterns(EventBatch.of([window]), [motion], cfg, workspace=solver.workspace)
    true = seen.at(window.middle_us).outline()
    made = codes_of_triples(found.peaks.table, found.triples, cfg)
    poses = [made.pose[k] for k in range(len(made)) if made.space(k) == seen.space]
    if not poses:
        return None
    shape = seen.space.shape
    best = min(poses, key=lambda pose: np.abs(outline(pose, shape) - true).max())
    assert isinstance(seen.space.version, int)
    return motion, best, seen.space.version


def run_cold(job: Job, solver: Solver, clock: StageClock | None = None) -> str | None:
    clock = clock or StageClock()
    motion = _motion(job, solver, clock)
    if motion is None:
        return None
    length = solver.window_us(motion)
    window = job.buffer.window(job.start_us, job.start_us + length)
    (found,) = solver.find(EventBatch.of([window]), [motion])
    return _finish(found if isinstance(found, NotFound) else found[0], solver, clock)


def run_tracked(job: Job, solver: Solver, clock: StageClock | None = None) -> str | None:
    assert job.before is not None
    window = job.buffer.window(job.start_us, job.start_us + job.window_us)
    nothing = NormalEquations.nothing(job.before.space)
    (found,) = solver.follow(EventBatch.of([window]), [job.before], [nothing])
    return _finish(found, solver, clock or StageClock())


def _motion(job: Job, solver: Solver, clock: StageClock) -> Motion | None:
    moving = job.buffer.answer(solver.motion_at(job.start_us))
    clock.add(moving.timings_ms)
    return moving.motion if isinstance(moving, MotionEstimate) else None


def _finish(found: Detection | NotFound, solver: Solver, clock: StageClock) -> str | None:
    clock.add(found.timings_ms)
    if isinstance(found, NotFound):
        return None
    if found.fused is None:
        with clock("stage_two"):
            (estimate,) = solver.solve([found])
    else:
        estimate = found.fused.estimate
    with clock("decode"):
        outcome = decode_grid(estimate.q, found.space)
    return outcome.text if isinstance(outcome, Decoded) else None


def _run_integrate(job: Job, solver: Solver, clock: StageClock, travel_px: float) -> str | None:
    motion = _motion(job, solver, clock)
    if motion is None:
        return None
    length = round(solver.window_us(motion) * travel_px / solver.config.travel_px)
    window = job.buffer.window(job.start_us, job.start_us + length)
    reading = integrate.read_window(window, workspace=solver.workspace, motion=motion)
    _add(clock, reading.compute_ms)
    return reading.text


def run_integrate(job: Job, solver: Solver, clock: StageClock | None = None) -> str | None:
    return _run_integrate(job, solver, clock or StageClock(), solver.config.travel_px)


def run_integrate4(job: Job, solver: Solver, clock: StageClock | None = None) -> str | None:
    return _run_integrate(job, solver, clock or StageClock(), 2.0 * solver.config.travel_px)


def run_descent(job: Job, solver: Solver, clock: StageClock | None = None) -> str | None:
    assert job.start is not None
    window = job.buffer.window(job.start_us, job.start_us + job.window_us)
    reading = descent.read_window(window, *job.start, workspace=solver.workspace)
    _add(clock or StageClock(), reading.compute_ms)
    return reading.text


def _add(clock: StageClock, ms) -> None:
    clock.add({stage: value for stage, value in ms.items() if stage != "total"})


RUN: dict[str, Callable[..., str | None]] = {
    "cold": run_cold,
    "tracked": run_tracked,
    "integrate": run_integrate,
    "integrate4": run_integrate4,
    "descent": run_descent,
}


def can_run(method: str, job: Job) -> bool:
    """Whether the method has what it starts from."""
    needs = {"tracked": job.before, "descent": job.start}
    return needs.get(method, job) is not None


def run_interleaved(jobs: list[Job], solver: Solver, rounds: int) -> Iterator[Timing]:
    """Time every method on every window, one method after the other, so that a slow moment slows all alike.

    The order is another one on every window: a method finds the caches as the one before has left them.  The
    first round is not reported: buffers are made in it.
    """
    rng = random.Random(0)
    for round_ in range(rounds + 1):
        for index, job in enumerate(jobs):
            for method in rng.sample(METHODS, len(METHODS)):
                if not can_run(method, job):
                    continue
                clock = StageClock()
                begin = time.perf_counter()
                text = RUN[method](job, solver, clock)
                total = 1e3 * (time.perf_counter() - begin)
                verdict = "missed" if text is None else "read" if text in job.recording.texts else "FALSE"
                ms = {**clock.ms, "rest": total - sum(clock.ms.values())}
                if round_ > 0:
                    yield Timing(job.recording.case, index, method, ms, total, verdict)
