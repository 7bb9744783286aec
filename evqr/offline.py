"""Recordings to readings: every code that passes, or windows one by one."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from evqr.clock import ONE_TIME, StageClock
from evqr.events.buffer import EventBuffer
from evqr.events.window import Window
from evqr.fit.detection import Detection, NotFound, Target
from evqr.fit.modules import CodeEstimate
from evqr.geometry import affine_to_code
from evqr.grade import grade_reading
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.recording import Recording, open_recording
from evqr.recording.options import check_names
from evqr.results import CodeReading, ReadResult, ReadStatus, WindowCode, WindowReading
from evqr.search.motion_estimate import MotionEstimate
from evqr.seen import Candidate, Nearest
from evqr.solver import Solver
from evqr.solvers import solvers_for
from evqr.stream.records import CodeLeft, CodeRead, CodeUnread, Searched, StreamRecord
from evqr.stream.scheduler import StreamScheduler
from evqr.stream.unread import at_one_place
from evqr.symbol.decoded import Decoded, DecodeFailure
from evqr.work import (
    Activity,
    Decode,
    Estimate,
    Find,
    FindTurning,
    Solve,
    Working,
    answer,
    decoded,
    moving_at,
    together,
    with_windows,
)  # fmt: skip

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from evqr.config import ReadConfig
    from evqr.recording import RecordingOptions

Progress = Callable[[int, "int | None"], None]

PROGRESS_US = 1_000
"""Event time between two calls of a progress function at least [us]."""

MOST_CANDIDATES = 3
"""That are told of where nothing was read."""

SIDE_BY_SIDE = 64
"""Windows that are read at once on a device.  On a CPU they are read one by one: side by side they take as
long, and two times the memory (measured with 16)."""

WINDOWS_A_JOB = 4
"""Windows that a thread reads at least before it asks for more: it may have to wait for the GIL then."""

MOST_EVENTS = 1 << 22
"""Events that are held for windows that are read side by side, of which there are fewer where they lie far
apart."""


def read_codes(
    source: Any,
    *,
    config: ReadConfig | None = None,
    backend: str = "auto",
    device: str = "cpu",
    threads: int | None = None,
    progress: Progress | None = None,
    **opening: Unpack[RecordingOptions],
) -> ReadResult:
    """Read every code that passes, each once.

    Parameters
    ----------
    source : path, EventArray, array, tuple or Recording
        What `open_recording` takes, or a recording that is open already.
    config : ReadConfig, optional
        What to do; default `ReadConfig()`.
    backend : str
        "auto", "warp", "taichi", "numpy", or a registered name.
    device : str
        "cpu", "cuda:0", ...
    threads : int, optional
        Windows searched at once; default 1.
    progress : callable, optional
        Called with the event time done and the whole duration, None while unknown [us].
    **opening : as for `open_recording`
        Such as ``sensor`` and ``time_unit``.

    Returns
    -------
    result : ReadResult
        READ with the readings in order of time, or NO_READ with the reason.

    Raises
    ------
    RecordingError, MissingExtra
        The source cannot be read.
    UsageError
        An option of `open_recording` makes no sense.
    BackendError
        The backend or the device is not there.
    TypeError, ValueError
        An argument is of the wrong type, or makes no sense.
    """
    check_names("read_codes", opening)
    clock, started = StageClock(), time.perf_counter()
    with ExitStack() as stack:
        recording, path = open_source(source, opening, stack)
        with clock(ONE_TIME):
            solvers, pool = _solvers(threads, stack, config=config, backend=backend, device=device)
        reading = reading_codes(recording, path, solvers, started, pool=pool, progress=progress, clock=clock)
        return answer(reading, solvers[0], pool)


def reading_codes(
    recording: Recording,
    path: str,
    solvers: list[Solver],
    started: float,
    *,
    pool: Executor | None = None,
    progress: Progress | None = None,
    clock: StageClock | None = None,
) -> Working[ReadResult]:
    """Read every code that passes; with `together`, in several recordings side by side.

    Parameters
    ----------
    recording : Recording
        What is read.
    path : str
        Where it is from, for the result.
    solvers, pool : as for `StreamScheduler`
        Their settings count; the work is left to who runs this, but for searches on other threads.
    started : float [s]
        When reading began, of `time.perf_counter`.
    progress : callable, optional
        As for `read_codes`.
    clock : StageClock, optional
        With what it took to get here.

    Returns
    -------
    result : ReadResult
        As of `read_codes`; what is done side by side is shared out, but for the total time.
    """
    clock = clock or StageClock()
    scheduler = StreamScheduler(solvers, recording.width, recording.height, pool=pool)
    codes = _Codes(solvers[0].config.align.good_score)
    yield from _pushing(recording, scheduler, codes, progress)
    clock.add(scheduler.timings_ms)
    readings = tuple(sorted(codes.readings.values(), key=lambda reading: reading.t_read_us))
    reason, reason_code = ("", None) if readings else codes.why_nothing()
    return ReadResult(
        status=ReadStatus.READ if readings else ReadStatus.NO_READ,
        reason=reason,
        readings=readings,
        seen=scheduler.statistics,
        compute_ms={**clock.ms, "total": 1e3 * (time.perf_counter() - started)},
        source=path,
        reason_code=reason_code,
        warnings=recording.notes,
        nearest=None if readings else codes.nearest(),
    )


class _Codes:
    """What the records of a stream come to."""

    def __init__(self, good_score: float) -> None:
        self.readings: dict[int, CodeReading] = {}
        self._good_score = good_score
        self._unread: list[CodeUnread] = []  # the best, best first
        self._nearest = NotFound(Reason.TOO_FEW_EVENTS, closest=-1.0)
        self._moving: tuple[float, Motion] | None = None

    def take(self, records: Sequence[StreamRecord]) -> None:
        """Add records."""
        for record in records:
            self._take(record)

    def _take(self, record: StreamRecord) -> None:
        if isinstance(record, CodeRead):
            self.readings[record.code] = record.reading
        elif isinstance(record, CodeLeft):
            reading = self.readings[record.code]
            self.readings[record.code] = replace(reading, t_last_us=record.t_last_us)
        elif isinstance(record, CodeUnread):
            if all(not at_one_place(record.target, each.target) for each in self._unread):
                self._unread.append(record)
            else:
                self._unread = [
                    max(each, record, key=_score) if at_one_place(record.target, each.target) else each
                    for each in self._unread
                ]
            self._unread = sorted(self._unread, key=_score, reverse=True)[:MOST_CANDIDATES]
        elif isinstance(record, Searched) and record.not_found is not None:
            if record.not_found.closest >= self._nearest.closest:
                self._nearest = record.not_found
                if record.motion is not None:
                    self._moving = (record.start_us + record.end_us) / 2.0, record.motion

    def why_nothing(self) -> tuple[str, Reason]:
        """Why nothing was read, for people and for programs."""
        if not self._unread:
            return str(self._nearest), self._nearest.reason
        best = self._unread[0]
        detail = f"over {best.t_last_us - best.t_first_us} us: {best.failure}"
        if best.agrees(self._good_score):
            return Reason.NOT_DECODED.explained(detail), Reason.NOT_DECODED
        return Reason.DISAGREES.explained(f"{best.mean_score:.2f}, followed {detail}"), Reason.DISAGREES

    def nearest(self) -> Nearest | None:
        """Tell what came nearest to a code; None where nothing moved."""
        if not self._unread:
            if self._moving is None:
                return None
            time_us, motion = self._moving
            taken = self._nearest.nearest
            return Nearest(
                t_us=round(time_us),
                motion_px_per_s=motion.velocity,
                candidates=() if taken is None else (_candidate(taken, self._nearest.closest, time_us),),
            )
        best = self._unread[0].target
        return Nearest(
            t_us=round(best.time_us),
            motion_px_per_s=best.motion.velocity_at(best.centre),
            candidates=tuple(_candidate(each.target, each.mean_score, best.time_us) for each in self._unread),
        )


def _candidate(target: Target, score: float, time_us: float) -> Candidate:
    return Candidate(
        symbol=f"{target.space.symbology.value} {target.space.version}",
        score=score,
        corners_px=target.at(time_us).outline(),
    )


def _score(record: CodeUnread) -> float:
    return record.mean_score


def _pushing(
    recording: Recording, scheduler: StreamScheduler, codes: _Codes, progress: Progress | None
) -> Working[None]:
    """Push a recording through a scheduler, and take its records."""
    for chunk in recording.chunks():
        if scheduler.finished:
            break
        scheduler.push(chunk)
        if progress is not None:
            start, end = int(chunk.t[0]), int(chunk.t[-1])
            for until in range(start, end, max(PROGRESS_US, (end - start) // 100)):
                codes.take((yield from scheduler.stepping(until)))
                _tell(progress, until, recording)
        codes.take((yield from scheduler.stepping()))
        _tell(progress, int(chunk.t[-1]), recording)
    codes.take((yield from scheduler.closing()))


def open_source(source: Any, opening: RecordingOptions, stack: ExitStack) -> tuple[Recording, str]:
    """Open what is to be read, until the stack is closed, and say where it is from."""
    if isinstance(source, Recording):
        if opening:
            raise TypeError(f"a Recording is open already: pass {', '.join(opening)} to open_recording")
        return source, source.path
    recording = stack.enter_context(open_recording(source, **opening))
    return recording, recording.path


def read_windows(
    source: Any,
    *,
    config: ReadConfig | None = None,
    backend: str = "auto",
    device: str = "cpu",
    threads: int | None = None,
    progress: Progress | None = None,
    **opening: Unpack[RecordingOptions],
) -> Iterator[WindowReading]:
    """Read windows spread evenly over a recording, each alone and from cold.

    Windows have the length that the configuration sets, or one that suits the motion at their time;
    ``config.max_windows`` is their number, without it they follow one another, and those without any event
    are left out.  Beside a code that was found
    others are searched for, but not as thoroughly as where there is none.

    Parameters
    ----------
    source : path, EventArray, array, tuple or Recording
        As for `read_codes`.
    config, backend, device, threads, progress, **opening : as for `read_codes`
        The same.

    Yields
    ------
    window : WindowReading
        In order of time.

    Raises
    ------
    RecordingError, MissingExtra, UsageError, BackendError, TypeError, ValueError
        As for `read_codes`, when the first window is asked for, or later for what is wrong further on.
    """
    check_names("read_windows", opening)
    with ExitStack() as stack:
        recording, _ = open_source(source, opening, stack)
        solvers, pool = _solvers(threads, stack, config=config, backend=backend, device=device)
        feed = _Feed(recording, solvers[0].config)
        events, most = feed.events, solvers[0].config.max_windows
        if pool is None:
            for starts in _batches(_starts(feed, recording, solvers[0]), events, _at_once(solvers[0])):
                events.forget(starts[0].us)
                for start, read in zip(starts, _read(starts, events, solvers[0]), strict=True):
                    yield read
                    _tell(progress, start.us, recording)
            return
        idle: SimpleQueue[Solver] = SimpleQueue()
        for solver in solvers:
            idle.put(solver)

        def job(starts: list[_Start]) -> list[WindowReading]:
            solver = idle.get()
            try:
                return _read(starts, events, solver)
            finally:
                idle.put(solver)

        # a solver of its own, for the motion that windows are as long as: the others are at work meanwhile
        ahead = _starts(feed, recording, Solver(config, backend=backend, device=device))
        running: deque[tuple[int, Future[list[WindowReading]]]] = deque()
        count = max(_at_once(solvers[0]), WINDOWS_A_JOB)
        count = count if most is None else min(count, -(-most // len(solvers)))
        for starts in _batches(ahead, events, count):
            running.append((starts[0].us, pool.submit(job, starts)))
            if len(running) > 2 * len(solvers):
                events.forget(running[0][0])
                yield from running.popleft()[1].result()
            _tell(progress, starts[-1].us, recording)
        while running:
            yield from running.popleft()[1].result()


def _solvers(
    threads: int | None, stack: ExitStack, *, config: ReadConfig | None, backend: str, device: str
) -> tuple[list[Solver], ThreadPoolExecutor | None]:
    """One solver a thread, and the threads where there is more than one."""
    count = 1 if threads is None else threads
    if count < 1:
        raise ValueError(f"threads must be at least 1, got {threads}")
    solvers = stack.enter_context(solvers_for(count, config, backend=backend, device=device))
    return solvers, stack.enter_context(ThreadPoolExecutor(count)) if count > 1 else None


def _tell(progress: Progress | None, now_us: int, recording: Recording) -> None:
    first, last = recording.t_first_us, recording.t_last_us
    if progress is not None and first is not None:
        progress(now_us - first, None if last is None else last - first)


@dataclass(frozen=True)
class _Start:
    """A window to read: its number, start and length [us]; no length where it finds its own.

    With what was odd about the recording by then.
    """

    index: int
    us: int
    length_us: int | None
    warnings: tuple[str, ...]


class _Feed:
    """The events of a recording, loaded as far as they are needed."""

    def __init__(self, recording: Recording, config: ReadConfig) -> None:
        self.events = EventBuffer(recording.width, recording.height)
        self._chunks = recording.chunks()
        self._longest_us = max(config.motion.longest_us, config.window_us or 0)
        while self.events.first_us is None and self._pull():
            pass

    def _pull(self) -> bool:
        """Load a chunk; False where there is none."""
        chunk = next(self._chunks, None)
        if chunk is None:
            self.events.close()
            return False
        self.events.push(chunk)
        return True

    def load(self, start_us: int) -> bool:
        """Load all that a window from a time on may ask for; False where the recording ends before it."""
        while not self.events.reaches(start_us + self._longest_us) and self._pull():
            pass
        return self.events.reaches(start_us + 1)


def _starts(feed: _Feed, recording: Recording, solver: Solver) -> Iterator[_Start]:
    """Windows to read, in order of time, their events loaded."""
    cfg, events = solver.config, feed.events
    first = events.first_us
    if first is None:
        return
    if cfg.max_windows is not None:
        last = recording.t_last_us
        if last is None:
            last = max(int(chunk.t[-1]) for chunk in recording.chunks() if len(chunk))
        slot = (last + 1 - first) / cfg.max_windows
        for index in range(cfg.max_windows):
            start_us = round(first + index * slot)
            feed.load(start_us)
            yield _Start(index, start_us, cfg.window_us, recording.notes)
        return
    start_us, index = first, 0
    while feed.load(start_us):
        length = cfg.window_us
        step = length or cfg.motion.probe_us
        silent = ((events.first_from(start_us) or start_us) - start_us) // step
        if silent:
            start_us, index = start_us + silent * step, index + silent
            continue
        if length is None:
            moving = events.answer(solver.motion_at(start_us))
            found = isinstance(moving, MotionEstimate)
            length = solver.window_us(moving.motion) if found else cfg.motion.probe_us
        yield _Start(index, start_us, length, recording.notes)
        start_us, index = start_us + length, index + 1


def _batches(starts: Iterator[_Start], events: EventBuffer, count: int) -> Iterator[list[_Start]]:
    """Put windows together that are read at once: so many, or fewer where many events lie between them."""
    batch: list[_Start] = []
    for start in starts:
        batch.append(start)
        if len(batch) == count or events.count_from(batch[0].us) > MOST_EVENTS:
            yield batch
            batch = []
    if batch:
        yield batch


def _at_once(solver: Solver) -> int:
    """Give how many windows are read side by side."""
    return 1 if solver.workspace.shared else SIDE_BY_SIDE


def _read(starts: Sequence[_Start], events: EventBuffer, solver: Solver) -> list[WindowReading]:
    """Read windows, each from cold."""
    found: list[WindowReading] = []
    count = _at_once(solver)
    for first in range(0, len(starts), count):
        readings = [with_windows(_reading(one, solver), events) for one in starts[first : first + count]]
        found += answer(together(readings), solver)
    return found


def _reading(start: _Start, solver: Solver) -> Activity[WindowReading]:
    """Read one window from cold."""
    clock, cfg = StageClock(), solver.config
    start_us, length = start.us, start.length_us
    moving: MotionEstimate | NotFound | None = None
    if length is None:
        moving = yield from moving_at(start_us, solver)
        clock.add(moving.timings_ms)
        length = (
            solver.window_us(moving.motion) if isinstance(moving, MotionEstimate) else cfg.motion.probe_us
        )
    window = yield start_us, start_us + length
    if not isinstance(moving, MotionEstimate):
        (estimated,) = yield [Estimate(window)]
        clock.add(estimated.timings_ms)
        moving = estimated
    codes: list[WindowCode] = []
    found = moving
    if isinstance(moving, MotionEstimate):
        (found,) = yield [Find(window, moving.motion)]
        if isinstance(found, NotFound):
            clock.add(found.timings_ms)
        else:
            clock.add(found[0].timings_ms)
            found = found[: cfg.scheduler.codes_a_search]
            codes = yield from _codes(found, window, solver, clock)
        if not any(code.status is ReadStatus.READ for code in codes):
            first = () if isinstance(found, NotFound) else found
            (turning,) = yield [FindTurning(window, moving.motion, first)]
            if turning:
                clock.add(turning[0].timings_ms)
                codes = (yield from _codes(turning, window, solver, clock, grids=2)) or codes
    codes.sort(key=lambda code: code.status is not ReadStatus.READ)  # the sort is stable
    if codes:
        status, reason, reason_code = codes[0].status, codes[0].reason, codes[0].reason_code
    else:
        assert isinstance(found, NotFound)
        status, reason, reason_code = ReadStatus.NO_CODE, str(found), found.reason
    return WindowReading(
        status=status,
        reason=reason,
        reason_code=reason_code,
        window=start.index,
        t_start_us=window.start_us,
        t_end_us=window.end_us,
        n_events=len(window),
        codes=tuple(codes),
        compute_ms=clock.total(),
        warnings=start.warnings,
    )


def _codes(
    found: Sequence[Detection], window: Window, solver: Solver, clock: StageClock, *, grids: int = 1
) -> Working[list[WindowCode]]:
    """Read codes that were found in a window, as one of so many grids."""
    decode = solver.config.decode.among(grids)
    estimates = yield [Solve(code, clock) for code in found]
    outcomes = yield from decoded(
        [
            Decode(estimate.q, code.space, decode, "full", clock)
            for code, estimate in zip(found, estimates, strict=True)
        ]
    )
    length_us = window.end_us - window.start_us
    return [_window_code(*one, length_us) for one in zip(found, estimates, outcomes, strict=True)]


def _window_code(
    found: Detection, estimate: CodeEstimate, outcome: Decoded | DecodeFailure, length_us: int
) -> WindowCode:
    read = isinstance(outcome, Decoded)
    return WindowCode(
        status=ReadStatus.READ if read else ReadStatus.NO_READ,
        reason="" if read else str(outcome),
        reason_code=None if read else outcome.reason,
        payload=outcome.payload if read else None,
        symbology=outcome.space.symbology.value,
        version=outcome.space.version,
        ec_level=outcome.ec_level if read else None,
        mask=outcome.mask if read else None,
        confidence=outcome.confidence if read else None,
        log10_chance=outcome.log10_chance if read else None,
        unused_correction=outcome.unused_correction if read else None,
        grade=grade_reading(found, length_us, estimate, outcome) if read else None,
        modules=estimate.q,
        motion_px_per_s=found.motion.velocity,
        affine=affine_to_code(found.pose, found.space.shape),
        stage_one_iterations=found.iterations,
        stage_two_iterations=estimate.iterations,
    )
