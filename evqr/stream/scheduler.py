"""The codes of one recording: searched for, followed, read, one after another and side by side.

One loop over event time: the next thing to do, a search or the next window of a code that is followed, is
always the earliest one, so a stream of any length is read in bounded memory.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from evqr.clock import StageClock
from evqr.events.window import Window
from evqr.fit.detection import Detection, NotFound
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.recording import Recording
from evqr.results import CodeReading
from evqr.solver import Solver
from evqr.stream.feed import Feed
from evqr.stream.track import Track

Progress = Callable[[int, "int | None"], None]

SEARCH_UNKNOWN_US = 2_000
"""Time between two searches while the speed is unknown [us]."""

MOST_BESIDE = 16
"""Codes that one search finds at most."""

SEARCH_LONGEST_US = 20_000
"""Longest time between two searches [us]: what is in view now may be slow, and a fast code may come."""

SEARCH_SELDOM = 2
"""How much less often is searched while a code that was read is followed."""

OUTLINE_MARGIN = 4.0
"""Modules around a followed code whose events a search does not see: its quiet zone."""

SAME_PLACE = 0.5
"""How far from where a lost code must be one with the same text may be found, for them to be one, in sizes of
the code: two codes cannot overlap."""


@dataclass(frozen=True, eq=False)
class _Look:
    """One search: where, what moved there, and what was found or why nothing was."""

    start_us: int
    end_us: int
    motion: Motion | None
    found: Detection | NotFound
    clock: StageClock


class Passes:
    """All codes of one recording."""

    def __init__(
        self,
        solvers: list[Solver],
        events: Feed,
        recording: Recording,
        *,
        pool: Executor | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Read with one solver, or search with several at once on the threads of a pool."""
        self.config = solvers[0].config
        self.events = events
        self.readings: list[CodeReading] = []
        self.clock = StageClock()
        self._solvers = solvers
        self._solver = solvers[0]
        self._pool = pool
        self._recording = recording
        self._progress = progress
        self._tracks: list[Track] = []
        self._unread: list[Track] = []
        self._read: list[tuple[Track, int]] = []
        self._motion: Motion | None = None
        self._tau_us: tuple[float, float] | None = None
        self._windows = 0
        self._searches = 0
        self._nearest = NotFound(Reason.NO_EVENTS, closest=-1.0)

    def run(self) -> None:
        """Work through the recording in order of event time."""
        start = self.events.first_us
        if start is None:
            return
        order = itertools.count()
        search_us = start
        queue: list[tuple[int, int, Track | None]] = [(start, next(order), None)]
        while queue:
            at_us, _, track = heapq.heappop(queue)
            self.events.forget(at_us)
            if self._progress is not None:
                last = self._recording.t_last_us
                done = at_us if last is None else min(at_us, last)
                self._progress(done - start, None if last is None else last - start)
            most = self.config.max_windows
            if most is not None and self._windows >= most:
                break
            if track is None:
                if at_us != search_us or not self.events.reaches(at_us + 1):
                    continue
                search_us = self._search(at_us)
                for new in self._tracks:
                    if all(new is not entry[2] for entry in queue):
                        heapq.heappush(queue, (new.next_window(self._solver)[0], next(order), new))
                heapq.heappush(queue, (search_us, next(order), None))
            else:
                self._follow(track)
                if track in self._tracks:
                    heapq.heappush(queue, (track.next_window(self._solver)[0], next(order), track))
                elif at_us < search_us:  # where one code has gone the next may be
                    search_us = at_us
                    heapq.heappush(queue, (search_us, next(order), None))
        for track in list(self._tracks):
            self._finish(track)

    def _search(self, at_us: int) -> int:
        """Search at a time, and ahead of it on the other threads, and say when to search again [us]."""
        looks: list[_Look]
        if self._pool is None or self._tracks or self._motion is None:
            looks = [self._look_at(self._solver, at_us)]
        else:
            step = self._step_us(self._motion)
            starts = [at_us + k * step for k in range(len(self._solvers))]
            looks = list(self._pool.map(self._look_at, self._solvers, starts))
        found = next((k for k, look in enumerate(looks) if isinstance(look.found, Detection)), len(looks) - 1)
        for look in looks[: found + 1]:
            self._searches += 1
            self._windows += look.end_us > look.start_us
            if isinstance(look.found, NotFound) and look.found.closest >= self._nearest.closest:
                self._nearest = look.found
        for look in looks[:found]:
            self._note(look.clock)
        look = looks[found]
        if look.motion is None:
            self._note(look.clock)
            return look.start_us + SEARCH_UNKNOWN_US
        self._motion = look.motion
        for _ in range(MOST_BESIDE):
            if not isinstance(look.found, Detection) or look.motion is None:
                break
            self._tracks.append(Track(look.found, look.start_us, look.end_us, self._solver, look.clock))
            self._settle(self._tracks[-1])
            look = self._look_beside(look, look.motion)
        self._note(look.clock)
        return look.start_us + self._step_us(self._motion)

    def _look_beside(self, look: _Look, motion: Motion) -> _Look:
        """Search the window of a find again, for a code beside it."""
        clock = StageClock()
        window = self._outside_tracks(self.events.window(look.start_us, look.end_us))
        found = self._solver.find(window, motion, tau_us=self._tau_us)
        clock.add(found.timings_ms)
        return replace(look, found=found, clock=clock)

    def _step_us(self, motion: Motion) -> int:
        """Time between two searches [us]."""
        sure = any(track.reading is not None for track in self._tracks)
        travel = self.config.search_px * (SEARCH_SELDOM if sure else 1)
        step = max(self._solver.window_us(motion), round(motion.travel_time_us(travel)))
        return min(step, SEARCH_LONGEST_US)

    def _look_at(self, solver: Solver, at_us: int) -> _Look:
        """Search once; runs on any thread and changes nothing here."""
        clock = StageClock()
        moving = solver.motion_at(self.events, at_us, guess=self._motion)
        clock.add(moving.timings_ms)
        if isinstance(moving, NotFound) and self._motion is not None:
            moving = solver.motion_at(self.events, at_us)
            clock.add(moving.timings_ms)
        if isinstance(moving, NotFound):
            return _Look(at_us, at_us, None, NotFound(Reason.NOTHING_MOVES), clock)
        motion = moving.motion
        end_us = at_us + solver.window_us(motion)
        if not self.events.reaches(end_us):
            return _Look(at_us, at_us, motion, NotFound(Reason.RECORDING_ENDS, closest=-1.0), clock)
        window = self._outside_tracks(self.events.window(at_us, end_us))
        found = solver.find(window, motion, tau_us=self._tau_us)
        clock.add(found.timings_ms)
        return _Look(at_us, end_us, motion, found, clock)

    def _outside_tracks(self, window: Window) -> Window:
        """Give a window without the events of the codes that are followed already."""
        for track in self._tracks:
            target = track.seen.at(window.middle_us)
            x, y = target.motion.transport(window.x, window.y, window.t)
            u, v, z = (row[0] * x + row[1] * y + row[2] for row in np.linalg.inv(target.pose))
            half = target.space.size / 2.0
            reach = half + OUTLINE_MARGIN
            window = window.keep((np.abs(u / z - half) > reach) | (np.abs(v / z - half) > reach))
        return window

    def _follow(self, track: Track) -> None:
        start, end = track.next_window(self._solver)
        if not self.events.reaches(end):
            self._finish(track)
            return
        self._windows += 1
        was_read = track.reading is not None
        track.follow(self.events, start, end, self._solver)
        self._motion = track.seen.motion
        if not was_read:
            self._settle(track)
        if track.gone:
            self._finish(track)

    def _settle(self, track: Track) -> None:
        """Join a code that was just read with an earlier sight of the same one."""
        if track.reading is None:
            return
        if any(track.seen.tau_us):  # of the sensor and its light, so the next code will lag as much
            self._tau_us = track.seen.tau_us
        for k, (earlier, index) in enumerate(self._read):
            if earlier.reading is not None and earlier.reading.text == track.reading.text:
                size = earlier.seen.space.size
                there = earlier.seen.at(track.seen.time_us)
                x, y, z = np.linalg.inv(track.seen.pose) @ (*there.centre, 1.0)
                if np.hypot(x / z - size / 2.0, y / z - size / 2.0) < SAME_PLACE * size:
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
        self.clock.add(clock.ms)

    def seen(self) -> dict[str, Any]:
        """Say what was seen, for a report."""
        first = self.events.first_us or 0
        return {
            "events": self.events.pushed,
            "duration_us": (self.events.last_us or 0) - first,
            "windows": self._windows,
            "searches": self._searches,
            "codes_not_decoded": len(self._unread),
        }

    def why_nothing(self) -> str:
        """Say why nothing was read, in words."""
        if self._unread:
            best = max(self._unread, key=lambda track: track.seen.score)
            followed = best.last_us - best.first_us
            return f"a code was followed over {followed} us but does not decode: {best.why_not}"
        return str(self._nearest)
