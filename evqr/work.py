"""What readers ask the solver and the decoder for, so that those who read side by side are served together.

Who reads is a generator.  It yields the bounds of a window whose events it needs, or a list of works of one
kind; it is sent the window, or what the works came to.  `together` makes one of many: it waits until none of
them can go on without being answered, and hands on what is asked for of the earliest stage, of all of them at
once, so that those that are ahead wait for those that are behind and later stages have full batches as well.
Answers do not depend on what they are computed beside, so neither does what anybody reads.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import Executor, Future
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from evqr.clock import StageClock
from evqr.config import DecodeConfig
from evqr.events.batch import EventBatch
from evqr.events.buffer import EventBuffer
from evqr.events.window import Window
from evqr.fit.detection import Detection, NotFound
from evqr.fit.modules import NormalEquations
from evqr.motion import Motion
from evqr.search.motion_estimate import MotionEstimate, Probe, QuietSpells, motion_probes
from evqr.solver import Solver, timed
from evqr.symbol.decode import are_valid, decode_grid
from evqr.symbol.decoded import Decoded, DecodeFailure, Effort
from evqr.symbol.space import CodeSpace
from evqr.symbology import Symbology

T = TypeVar("T")

Decoding: TypeAlias = "Future[tuple[Decoded | DecodeFailure, Mapping[str, float]]]"
"""What a grid says and what it took by stage [ms]: worked out on another thread, or there already."""


class Estimate(NamedTuple):
    """Ask for the motion in a window: MotionEstimate or NotFound, with its timings.

    Attributes
    ----------
    window : Window
        Whose.
    probe : Probe, optional
        How; None: from the window alone, whose length was given.
    """

    window: Window
    probe: Probe | None = None


class Find(NamedTuple):
    """Ask for all codes of a window: tuple of Detection, or NotFound, with its timings.

    Attributes
    ----------
    window : Window
        Where.
    motion : Motion
        Of the codes.
    tau_us : (float, float), optional [us]
        As of `Solver.find`.
    symbologies : tuple of Symbology, optional
        As of `Solver.find`.
    thorough : bool
        As of `Solver.find`.
    """

    window: Window
    motion: Motion
    tau_us: tuple[float, float] | None = None
    symbologies: tuple[Symbology, ...] | None = None
    thorough: bool = True


class Follow(NamedTuple):
    """Ask for a code that an earlier window showed: Detection or NotFound, with its timings.

    Attributes
    ----------
    window : Window
        Where.
    detection : Detection
        The code.
    before : NormalEquations, optional
        As of `Solver.follow`.
    """

    window: Window
    detection: Detection
    before: NormalEquations | None = None


class FindTurning(NamedTuple):
    """Ask for codes that turn: tuple of Detection.

    Attributes
    ----------
    window : Window
        Where.
    motion : Motion
        As of `Solver.find_turning`.
    found : tuple of Detection
        As of `Solver.find_turning`.
    """

    window: Window
    motion: Motion
    found: tuple[Detection, ...] = ()


class Solve(NamedTuple):
    """Ask for the modules of a code: CodeEstimate.

    Attributes
    ----------
    equations : Detection or NormalEquations
        As of `Solver.solve`.
    clock : StageClock
        To which the time is added, as "stage_two".
    """

    equations: Detection | NormalEquations
    clock: StageClock


class Decode(NamedTuple):
    """Ask for decoding a grid to begin: what an `Await` takes; `decoded` asks for both.

    Attributes
    ----------
    q : (V, U) float
        The grid.
    space : CodeSpace
        Kind and size of the symbol.
    config : DecodeConfig
        How hard to try, and how sure to be.
    effort : {"quick", "full"}
        As of `decode_grid`.
    clock : StageClock
        To which the time is added, as "decode".
    """

    q: NDArray[np.floating]
    space: CodeSpace
    config: DecodeConfig
    effort: Effort
    clock: StageClock


class Await(NamedTuple):
    """Ask for what a grid says: Decoded or DecodeFailure.

    Attributes
    ----------
    decoding : Decoding
        What a `Decode` was answered with.
    clock : StageClock
        To which the time is added, as "decode".
    """

    decoding: Decoding
    clock: StageClock


Work: TypeAlias = Estimate | Find | FindTurning | Follow | Solve | Decode | Await

KINDS = (Estimate, Find, FindTurning, Follow, Solve, Decode, Await)
"""Kinds of work, in the order of the stages: nobody waits for a grid while there is anything else to do."""

Working: TypeAlias = Generator["list[Work]", "list[Any]", T]
"""Reading whose events are all here: it yields works of one kind and is sent their answers."""

Activity: TypeAlias = "Generator[tuple[int, int] | list[Work], Any, T]"
"""Reading that also yields the bounds of windows [us], and is sent the windows once their events are here."""


def moving_at(
    start_us: int, solver: Solver, *, guess: Motion | None = None, quiet: QuietSpells | None = None,
    since_us: int | None = None,
) -> Activity[MotionEstimate | NotFound]:  # fmt: skip
    """Estimate the motion at a time of a stream.

    Parameters
    ----------
    start_us : int [us]
        Where its windows begin.
    solver : Solver
        Whose settings count.
    guess, quiet : as of `Solver.motion_at`
        The same.
    since_us : int [us]
        As of `motion_probes`: long windows may begin before.

    Returns
    -------
    found : MotionEstimate or NotFound
        With its timings.
    """
    clock, cfg = StageClock(), solver.config.motion
    probes = motion_probes(start_us, cfg, guess=guess, quiet=quiet, since_us=since_us)
    answer: Any = None
    while True:
        try:
            probe = probes.send(answer)
        except StopIteration as end:
            return timed(end.value, clock)
        window = yield probe.start_us, probe.end_us
        (found,) = yield [Estimate(window, probe)]
        clock.add(found.timings_ms)
        answer = found if isinstance(found, MotionEstimate) else found.reason


def decoded(works: list[Decode]) -> Working[list[Decoded | DecodeFailure]]:
    """Have grids decoded, on other threads where there are some.

    Parameters
    ----------
    works : list of Decode
        Of the grids.

    Returns
    -------
    outcomes : list of Decoded or DecodeFailure
        One a grid.
    """
    decodings = yield [*works]
    outcomes = yield [Await(one, work.clock) for one, work in zip(decodings, works, strict=True)]
    return outcomes


def with_windows(activity: Activity[T], events: EventBuffer) -> Working[T]:
    """Give an activity the windows that it asks for: their events are all here.

    Parameters
    ----------
    activity : generator
        What is read.
    events : EventBuffer
        What is read from.

    Returns
    -------
    answer : any
        What the activity returns.
    """
    answer: Any = None
    while True:
        try:
            asked = activity.send(answer)
        except StopIteration as end:
            return end.value
        answer = (yield asked) if isinstance(asked, list) else events.window(*asked)


def together(workings: Iterable[Working[T]]) -> Working[list[T]]:
    """Read side by side.

    Parameters
    ----------
    workings : iterable of generators
        Each reads on its own, and none sees what the others do.

    Returns
    -------
    answers : list
        What each returns, in their order.  Where work fails, all who asked for it are told, by the exception.
    """
    workings = list(workings)
    answers: list[Any] = [None] * len(workings)
    asked: dict[int, list[Work]] = {}

    def go_on(k: int, proceed: Callable[[Any], list[Work]], answer: Any) -> None:
        try:
            asked[k] = proceed(answer)
        except StopIteration as end:
            answers[k] = end.value

    for k, working in enumerate(workings):
        go_on(k, working.send, None)
    while asked:
        first = min(_kind(works) for works in asked.values())
        now = [(k, works) for k, works in sorted(asked.items()) if _kind(works) == first]
        for k, _ in now:
            del asked[k]
        try:
            done = iter((yield [work for _, works in now for work in works]))
        except Exception as error:  # all who asked may say what that means to them
            for k, _ in now:
                go_on(k, workings[k].throw, error)
            continue
        for k, works in now:
            go_on(k, workings[k].send, [next(done) for _ in works])
    return answers


def _kind(works: list[Work]) -> int:
    """Give the number of the kind of some works."""
    return KINDS.index(type(works[0])) if works else 0


def answer(working: Working[T], solver: Solver, pool: Executor | None = None) -> T:
    """Do the work that somebody asks for who reads.

    Parameters
    ----------
    working : generator
        What is read.
    solver : Solver
        Does the work, in this thread.
    pool : concurrent.futures.Executor, optional
        Threads on which grids are decoded that take long.

    Returns
    -------
    answer : any
        What the generator returns.
    """
    try:
        works = next(working)
        while True:
            try:
                done = do(works, solver, pool)
            except Exception as error:
                works = working.throw(error)
            else:
                works = working.send(done)
    except StopIteration as end:
        return end.value


def do(works: list[Any], solver: Solver, pool: Executor | None = None) -> list[Any]:
    """Do work.

    Parameters
    ----------
    works : list of Estimate, Find, FindTurning, Follow, Solve, Decode or Await
        All of one kind.
    solver, pool : as for `answer`
        The same.

    Returns
    -------
    answers : list
        One a work, as its kind says.
    """
    kind = type(works[0]) if works else None
    if kind is Estimate:
        return _estimated(works, solver)
    if kind is Find:
        return _found(works, solver)
    if kind is FindTurning:
        return [solver.find_turning(*work) for work in works]
    if kind is Follow:
        batch = EventBatch.of([work.window for work in works])
        detections, before = [work.detection for work in works], [work.before for work in works]
        return list(solver.follow(batch, detections, before))
    if kind is Solve:
        clock = StageClock()
        with clock("stage_two"):
            solved = solver.solve([work.equations for work in works])
        shares = {stage: ms / len(works) for stage, ms in clock.ms.items()}
        for work in works:
            work.clock.add(shares)
        return list(solved)
    if kind is Decode:
        return _decodings(works, pool)
    return [_awaited(work) for work in works]


def _estimated(works: list[Estimate], solver: Solver) -> list[MotionEstimate | NotFound]:
    """Estimate motions, those asked for in one way at once."""
    found: list[Any] = [None] * len(works)
    ways: dict[tuple[int | None, bool], list[int]] = {}
    for k, (_, probe) in enumerate(works):
        ways.setdefault((None, True) if probe is None else (probe.reduction, probe.thorough), []).append(k)
    for (reduction, thorough), rows in ways.items():
        windows = [works[k].window for k in rows]
        estimates = solver.motions(windows, reduction=reduction, thorough=thorough)
        for k, estimate in zip(rows, estimates, strict=True):
            found[k] = estimate
    return found


def _found(works: list[Find], solver: Solver) -> list[tuple[Detection, ...] | NotFound]:
    """Find codes, those of the same kinds at once."""
    found: list[Any] = [None] * len(works)
    kinds: dict[tuple[tuple[Symbology, ...] | None, bool], list[int]] = {}
    for k, work in enumerate(works):
        kinds.setdefault((work.symbologies, work.thorough), []).append(k)
    for (symbologies, thorough), rows in kinds.items():
        asked = [works[k] for k in rows]
        batch, taus = EventBatch.of([work.window for work in asked]), [work.tau_us for work in asked]
        motions = [work.motion for work in asked]
        codes = solver.find(batch, motions, tau_us=taus, symbologies=symbologies, thorough=thorough)
        for k, each in zip(rows, codes, strict=True):
            found[k] = each
    return found


def _decodings(works: list[Decode], pool: Executor | None) -> list[Decoding]:
    """Begin to decode grids: on other threads those that have errors."""
    clean: Sequence[bool] = [True] * len(works)
    if pool is not None:
        clean = are_valid([work.q for work in works], [work.space for work in works])
    return [
        _now(_decode, work) if pool is None or at_once else pool.submit(_decode, work)
        for work, at_once in zip(works, clean, strict=True)
    ]


def _now(decode: Callable[[Decode], Any], work: Decode) -> Decoding:
    """Give what comes of a work as if another thread had done it already."""
    done: Decoding = Future()
    done.set_result(decode(work))
    return done


def _decode(work: Decode) -> tuple[Decoded | DecodeFailure, Mapping[str, float]]:
    clock = StageClock()
    with clock("decode"):
        outcome = decode_grid(work.q, work.space, config=work.config, effort=work.effort)
    return outcome, clock.ms


def _awaited(work: Await) -> Decoded | DecodeFailure:
    outcome, timings_ms = work.decoding.result()
    work.clock.add(timings_ms)
    return outcome
