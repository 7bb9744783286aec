"""Recordings to readings: search for codes, follow each one, read it, go on.

One loop over event time: the next thing to do, a search or the next window of a code that is followed, is always the earliest one, so
a stream of any length is read in bounded memory.
"""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evqr.decode import Decoded, decode_grid
from evqr.initial.motion import Motion
from evqr.recording import Recording, open_recording
from evqr.solver import Sighting, Solver, StageClock
from evqr.stage_two import solve_modules
from evqr.track import Track
from evqr.types import CodeReading, ReadResult, ReadStatus, WindowReading
from evqr.windows import EventBuffer, Window

if TYPE_CHECKING:
    from evqr.config import ReadConfig
    from evqr.recording import TimeUnit

Progress = Callable[[int, "int | None"], None]

SEARCH_UNKNOWN_US = 2_000
"""Time between two searches while the speed is unknown [us]."""

OUTLINE_MARGIN = 4.0
"""Modules around a followed code whose events a search does not see: its quiet zone."""

SAME_PLACE = 3.0
"""Modules between where a lost code must be by now and where one with the same text is found, for them to be one."""


def read_codes(
    source: Any,
    *,
    config: ReadConfig | None = None,
    sensor: tuple[int, int] | None = None,
    time_unit: TimeUnit | None = None,
    backend: str = "auto",
    device: str = "cpu",
    threads: int | None = None,
    progress: Progress | None = None,
) -> ReadResult:
    """Read every code that passes, each once.

    Parameters
    ----------
    source      path, `EventArray`, structured array, (t, x, y, p) arrays, or an open `Recording`
    config      what to do; default `ReadConfig()`
    sensor      (width, height) where the source does not tell [px]
    time_unit   "us", "ms", "s" or "ns" where neither source nor numbers tell
    backend     "auto", "warp", "numpy", or a registered name
    device      "cpu", "cuda:0", ...
    threads     windows searched at once; default 1
    progress    called with the event time done and the whole duration, None while unknown [us]

    Returns
    -------
    ReadResult  READ with the readings in order of time, or NO_READ with the reason

    Raises
    ------
    RecordingError, MissingExtra   the source cannot be read
    BackendUnavailable             the backend cannot be had
    """
    started = time.perf_counter()
    with ExitStack() as stack:
        recording, path = _open(source, sensor, time_unit, stack)
        solver = Solver(config, backend=backend, device=device)
        events = EventBuffer(recording.chunks())
        passes = _Passes(solver, events, recording, progress)
        passes.run()
        seen = passes.seen()
    compute = {**passes.clock.ms, "total": 1e3 * (time.perf_counter() - started)}
    readings = tuple(sorted(passes.readings, key=lambda r: r.t_read_us))
    status = ReadStatus.READ if readings else ReadStatus.NO_READ
    return ReadResult(status, "" if readings else passes.why_nothing(), readings, seen, compute, path)


def _open(
    source: Any, sensor: tuple[int, int] | None, time_unit: TimeUnit | None, stack: ExitStack
) -> tuple[Recording, str]:
    if isinstance(source, Recording):
        return source, source.path
    recording = stack.enter_context(open_recording(source, sensor=sensor, time_unit=time_unit))
    return recording, recording.path


class _Passes:
    """All codes of one recording."""

    def __init__(
        self, solver: Solver, events: EventBuffer, recording: Recording, progress: Progress | None
    ) -> None:
        self.solver = solver
        self.events = events
        self.readings: list[CodeReading] = []
        self.clock = StageClock()
        self._recording = recording
        self._progress = progress
        self._tracks: list[Track] = []
        self._unread: list[Track] = []
        self._read: list[tuple[Track, int]] = []
        self._speed: float | None = None
        self._lag_us: tuple[float, float] | None = None
        self._windows = 0
        self._searches = 0
        self._with_motion = 0
        self._reason = "no events"

    def run(self) -> None:
        """Work through the recording in order of event time."""
        start = self.events.first_us
        if start is None:
            return
        order = itertools.count()
        queue: list[tuple[int, int, Track | None]] = [(start, next(order), None)]
        while queue:
            at_us, _, track = heapq.heappop(queue)
            self.events.forget(at_us)
            if self._progress is not None:
                last = self._recording.t_last_us
                self._progress(at_us - start, None if last is None else last - start)
            most = self.solver.config.max_windows
            if most is not None and self._windows >= most:
                break
            if track is None:
                if not self.events.reaches(at_us + 1):
                    continue
                after = self._search(at_us)
                for new in self._tracks:
                    if all(new is not entry[2] for entry in queue):
                        heapq.heappush(queue, (new.next_window(self.solver)[0], next(order), new))
                heapq.heappush(queue, (after, next(order), None))
            else:
                self._follow(track)
                if track in self._tracks:
                    heapq.heappush(queue, (track.next_window(self.solver)[0], next(order), track))
        for track in list(self._tracks):
            self._finish(track)

    def _search(self, at_us: int) -> int:
        """Search once, and say when to search again [us]."""
        solver, cfg = self.solver, self.solver.config
        solver.clock = StageClock()
        self._searches += 1
        motion = solver.motion_at(self.events, at_us, speed=self._speed)
        if motion is None and self._speed is not None:
            motion = solver.motion_at(self.events, at_us)
        if motion is None:
            self._note(solver.clock)
            self._reason = "nothing moves" if not self._with_motion else self._reason
            return at_us + SEARCH_UNKNOWN_US
        self._with_motion += 1
        length = solver.window_us(motion.speed)
        after = at_us + max(length, round(cfg.search_px / motion.speed * 1e6))
        if not self.events.reaches(at_us + length):
            self._note(solver.clock)
            return after
        window = self._outside_tracks(self.events.window(at_us, at_us + length))
        self._windows += 1
        sighting = solver.look(window, motion, lag_us=self._lag_us)
        if isinstance(sighting, str):
            self._reason = sighting
            self._note(solver.clock)
            return after
        self._speed = motion.speed
        if any(sighting.lag_us):
            self._lag_us = sighting.lag_us
        track = Track(sighting, at_us, at_us + length, solver)
        self._tracks.append(track)
        self._settle(track)
        return after

    def _outside_tracks(self, window: Window) -> Window:
        """A window without the events of the codes that are followed already."""
        for track in self._tracks:
            seen = track.seen
            to_code = np.linalg.inv(seen.pose_at(window.middle_us))
            # bring each event to the middle of the window, then into code coordinates
            x = window.x - window.t * np.float32(seen.velocity[0])
            y = window.y - window.t * np.float32(seen.velocity[1])
            u, v, z = (row[0] * x + row[1] * y + row[2] for row in to_code)
            half = seen.size / 2.0
            reach = half + OUTLINE_MARGIN
            window = window.keep((np.abs(u / z - half) > reach) | (np.abs(v / z - half) > reach))
        return window

    def _follow(self, track: Track) -> None:
        start, end = track.next_window(self.solver)
        if not self.events.reaches(end):
            self._finish(track)
            return
        self._windows += 1
        was_read = track.reading is not None
        track.follow(self.events, start, end, self.solver)
        self._speed = float(np.hypot(*track.seen.velocity))
        if not was_read:
            self._settle(track)
        if track.gone:
            self._finish(track)

    def _settle(self, track: Track) -> None:
        """Join a code that was just read with an earlier sight of the same one."""
        if track.reading is None:
            return
        for k, (earlier, index) in enumerate(self._read):
            if earlier.reading is not None and earlier.reading.text == track.reading.text:
                middle = earlier.seen.size / 2.0
                x, y, z = np.linalg.inv(track.seen.pose) @ (
                    earlier.seen.pose_at(track.seen.time_us) @ (middle, middle, 1.0)
                )
                if np.hypot(x / z - middle, y / z - middle) < SAME_PLACE:
                    self._read[k] = (track, index)
                    return
        self._read.append((track, len(self.readings)))
        self.readings.append(track.reading)

    def _finish(self, track: Track) -> None:
        self._tracks.remove(track)
        self._note(track.clock)
        if track.reading is None:
            self._unread.append(track)
            return
        for known, index in self._read:
            if known is track:
                self.readings[index] = replace(self.readings[index], t_last_us=track.last_us)

    def _note(self, clock: StageClock) -> None:
        for stage, ms in clock.ms.items():
            self.clock.ms[stage] = self.clock.ms.get(stage, 0.0) + ms

    def seen(self) -> dict[str, Any]:
        """What was seen, for a report."""
        first = self.events.first_us or 0
        return {
            "events": self.events.seen,
            "duration_us": self.events.last_us - first if self.events.seen else 0,
            "windows": self._windows,
            "searches": self._searches,
            "codes_not_decoded": len(self._unread),
        }

    def why_nothing(self) -> str:
        """Why nothing was read, in words."""
        if self._unread:
            best = max(self._unread, key=lambda track: track.seen.score)
            return f"a code was followed over {best.last_us - best.first_us} us but does not decode: {best.why_not}"
        return self._reason


def read_windows(
    source: Any,
    *,
    config: ReadConfig | None = None,
    sensor: tuple[int, int] | None = None,
    time_unit: TimeUnit | None = None,
    backend: str = "auto",
    device: str = "cpu",
    threads: int | None = None,
    progress: Progress | None = None,
) -> Iterator[WindowReading]:
    """Read windows spread evenly over a recording, each alone and from cold.

    Parameters are those of `read_codes`.  Windows have the length that the configuration sets, or one that suits the motion at
    their time; ``config.max_windows`` is their number, without it they follow one another.

    Yields
    ------
    WindowReading   in order of time
    """
    with ExitStack() as stack:
        recording, _ = _open(source, sensor, time_unit, stack)
        count = max(threads or 1, 1)
        solvers = [Solver(config, backend=backend, device=device) for _ in range(count)]
        events = EventBuffer(recording.chunks())
        cut = _cut_windows(events, recording, solvers[0], progress)
        if count == 1:
            for index, (window, motion) in enumerate(cut):
                yield _read_alone(index, window, motion, solvers[0])
            return
        pool = stack.enter_context(ThreadPoolExecutor(count))
        jobs = ((index, window, motion) for index, (window, motion) in enumerate(cut))
        while batch := list(itertools.islice(jobs, count)):
            yield from pool.map(_read_alone, *zip(*batch, strict=True), solvers[: len(batch)])


def _cut_windows(
    events: EventBuffer, recording: Recording, solver: Solver, progress: Progress | None
) -> Iterator[tuple[Window, Motion | None]]:
    cfg = solver.config
    first = events.first_us
    if first is None:
        return
    slot: float | None = None
    if cfg.max_windows is not None:
        last = recording.t_last_us
        if last is None:
            events.reaches(float("inf"))
            last = events.last_us
        slot = (last + 1 - first) / cfg.max_windows
    start, index = first, 0
    while events.reaches(start + 1) and (cfg.max_windows is None or index < cfg.max_windows):
        events.forget(start)
        solver.clock = StageClock()
        motion = None
        length = cfg.window_us
        if length is None:
            motion = solver.motion_at(events, start)
            length = solver.window_us(motion.speed) if motion is not None else cfg.motion.probe_us
        window = events.window(start, start + length)
        yield window, motion
        if progress is not None:
            last = recording.t_last_us
            progress(start - first, None if last is None else last - first)
        index += 1
        start = round(first + index * slot) if slot is not None else start + length


def _read_alone(index: int, window: Window, motion: Motion | None, solver: Solver) -> WindowReading:
    """Read one window from cold."""
    solver.clock = StageClock()
    status, reason = ReadStatus.NO_CODE, ""
    if motion is None:
        motion = solver.motion_in(window)
    sighting = "nothing moves, or too few events" if motion is None else solver.look(window, motion)
    text, q, solved = None, None, 0
    if isinstance(sighting, str):
        reason = sighting
    else:
        with solver.clock("stage_two"):
            estimate = solve_modules(sighting.equations, solver.config.stage_two, workspace=solver.workspace)
            q, solved = estimate.q, estimate.iterations
        with solver.clock("decode"):
            outcome = decode_grid(q, effort="full")
        if isinstance(outcome, Decoded):
            status, text = ReadStatus.READ, outcome.text
        else:
            status, reason = ReadStatus.NO_READ, outcome.reason
    found = sighting if isinstance(sighting, Sighting) else None
    return WindowReading(
        status=status,
        reason=reason,
        window=index,
        t_start_us=window.start_us,
        t_end_us=window.end_us,
        n_events=len(window),
        text=text,
        version=found.version if found else None,
        modules=q,
        motion_px_per_s=found.velocity if found else None,
        affine=_affine(found) if found else None,
        stage_one_iterations=found.iterations if found else 0,
        stage_two_iterations=solved,
        compute_ms=solver.clock.total(),
    )


def _affine(sighting: Sighting) -> NDArray[np.float64]:
    """W of the paper, (2, 3): px to modules with integers at module centres; perspective is linearised at the code's centre."""
    c = sighting.size / 2.0
    x, y, z = sighting.pose @ (c, c, 1.0)
    jacobian = (sighting.pose[:2, :2] - np.outer((x / z, y / z), sighting.pose[2, :2])) / z
    linear = np.linalg.inv(jacobian)
    return np.column_stack([linear, (c - 0.5) - linear @ (x / z, y / z)])
