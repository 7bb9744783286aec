"""The codes of a stream: searched for, followed, read, one after another and side by side, as events come.

A simulation of discrete events.  What is done with a stream is a few activities: one search, and one for
each code that is followed.  An activity is a generator that asks for windows, one after the other; it goes on
as soon as all events of its window are here.  Of several that may go on, the one whose window ends first
does, however the events were cut into chunks when they came.  So the records are the same whether a stream is
pushed microsecond by microsecond or all at once, and a search that waits for a long window holds up no code
that is followed.

What following a code comes to depends on nothing but the code and its windows.  So all codes whose windows
are here are followed side by side, ahead of their turns, and each becomes what came of it at its turn.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from evqr.clock import StageClock
from evqr.events.array import EventArray
from evqr.events.buffer import EventBuffer
from evqr.events.window import Window
from evqr.fit.detection import Detection, NotFound
from evqr.fit.outside import inside, outside
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.search.motion_estimate import MotionEstimate, Probe, QuietSpells
from evqr.seen import Statistics
from evqr.solver import Solver
from evqr.stream.known import KnownCodes
from evqr.stream.moving import Moving
from evqr.stream.records import CodeAgain, CodeLeft, CodeRead, CodeUnread, Searched, StreamRecord
from evqr.stream.track import Track
from evqr.stream.unread import UnreadCodes
from evqr.symbology import BY_THREE_PATTERNS, Symbology
from evqr.work import Activity, Estimate, Find, FindTurning, Follow, Working, answer, together, with_windows

FOLLOW, SEARCH = range(2)
"""Ranks of activities: of those that wait for the same time, those that follow a code go on first."""


SCORES_ALIKE = 0.02
"""A code with the motion of its own events is taken though it agrees less well by so much."""


CLEARLY_OFF = 0.1
"""A code whose own events move by so much of the speed in another way was found with a wrong motion."""


class _Waiting(NamedTuple):
    """An activity that waits for the events of a window; the smallest goes on first."""

    end_us: int
    rank: int
    order: int
    start_us: int
    activity: Activity[None] | _Following


class _Following:
    """A code that is followed: as it is by now, and as it will be after the window that it waits for."""

    def __init__(self, track: Track) -> None:
        self.track = track
        self.ahead: Track | None = None


@dataclass(frozen=True, eq=False)
class _Try:
    """What a search at one time found, or why it found nothing; no window where nothing moves."""

    start_us: int
    motion: Motion | None
    window: Window | None
    found: tuple[Detection, ...] | NotFound

    @property
    def silent(self) -> bool:
        """Whether there was no event to search."""
        return isinstance(self.found, NotFound) and self.found.reason is Reason.NO_EVENTS


class StreamScheduler:
    """Reads all codes of a stream whose events come bit by bit.

    Events before the earliest that anything may still ask for are forgotten, so a stream of any length is
    read in bounded memory.

    Parameters
    ----------
    solvers : list of Solver
        One, or more to search with several at once while no code is followed. They must have one
        configuration.
    width, height : int [px]
        Size of the sensor.
    pool : concurrent.futures.Executor, optional
        Threads for searching with several solvers, and for decoding grids that have errors.

    Attributes
    ----------
    finished : bool
        Whether nothing will be done any more: the stream is closed, or as many windows as the configuration
        allows have been worked on.
    """

    def __init__(
        self, solvers: list[Solver], width: int, height: int, *, pool: Executor | None = None
    ) -> None:
        self._config = solvers[0].config
        self._size = width, height
        self._solvers = solvers
        self._solver = solvers[0]
        self._pool = pool if len(solvers) > 1 else None
        self._events = EventBuffer(width, height)
        self._known = KnownCodes(self._config.scheduler, width, height)
        self._records: list[StreamRecord] = []
        self._waiting: list[_Waiting] = []
        self._order = itertools.count()
        self._searching: Activity[None] | None = None
        self._search_us = 0
        self._tracks: list[Track] = []
        self._lost: list[Track] = []
        self._motion: Motion | None = None
        self._moving = Moving(
            self._events, width, height, self._solver, lambda: self._outside_tracks if self._tracks else None
        )
        self._tau_us: tuple[float, float] | None = None
        self._clock = StageClock()
        self._windows = self._searches = self._vain = self._found = 0
        self._unread = UnreadCodes(self._config)
        self._ended: tuple[int, int] | None = None

    @property
    def finished(self) -> bool:
        """Whether nothing will be done any more."""
        return self._ended is not None or self._events.closed

    def push(self, events: EventArray) -> None:
        """Take the next events of the stream; `step` works on them.

        Parameters
        ----------
        events : EventArray
            In order of time, none before the newest that was pushed or the time stepped to; any number. None
            is taken any more once the configuration allows no further window.

        Raises
        ------
        ValueError
            When they come too late, after `close`, or of a sensor of another size.
        """
        if self._ended is not None:
            return
        self._events.push(events)
        if self._searching is None and self._events.first_us is not None:
            self._search_from(self._events.first_us)

    def step(self, until_us: int | None = None) -> list[StreamRecord]:
        """Do all that can be done with the events up to a time.

        Parameters
        ----------
        until_us : int [us]
            All events before it have been pushed; it may lie after the newest one, where time passes without
            events.  Default: the time of the newest event.

        Returns
        -------
        records : list of StreamRecord
            What has become certain, in order.
        """
        return answer(self.stepping(until_us), self._solver, self._pool)

    def stepping(self, until_us: int | None = None) -> Working[list[StreamRecord]]:
        """Do what `step` does, and leave the work to who runs it: with `together`, for many streams at once.

        Parameters
        ----------
        until_us : int [us]
            As of `step`.

        Returns
        -------
        records : list of StreamRecord
            As of `step`.
        """
        if until_us is None:
            until_us = self._events.last_us
        elif self._events.last_us is not None:
            self._events.advance(until_us)
        return self._running(-math.inf if until_us is None else until_us)

    def skip(self, until_us: int) -> int:
        """Search for nothing before a time: there is too much to do.  Codes that are followed still are.

        Parameters
        ----------
        until_us : int [us]
            The time.

        Returns
        -------
        skipped : int
            Searches that are left out by that, about.
        """
        if self._searching is None or until_us <= self._search_us:
            return 0
        motion = self._motion
        step_us = self._config.scheduler.unknown_us if motion is None else self._step_us(motion)
        skipped = -(-(until_us - self._search_us) // step_us)
        self._search_from(until_us)
        return skipped

    def close(self) -> list[StreamRecord]:
        """Take the stream as ended, and do what is left to do.

        Returns
        -------
        records : list of StreamRecord
            The last ones.
        """
        return answer(self.closing(), self._solver, self._pool)

    def closing(self) -> Working[list[StreamRecord]]:
        """Do what `close` does, and leave the work to who runs it, as `stepping`."""
        self._events.close()
        return self._running(math.inf)

    @property
    def settled_us(self) -> float:
        """Time up to which all is certain that was asked of the stream: no window begins before it [us]."""
        if not self._waiting:
            return math.inf if self.finished else -math.inf
        return min(waiting.start_us for waiting in self._waiting)

    @property
    def unread(self) -> list[CodeUnread]:
        """What is known of the codes that are followed and not read yet."""
        return [track.unread for track in self._tracks if track.reading is None]

    @property
    def statistics(self) -> Statistics:
        """What has been done so far."""
        events = self._events
        count, duration_us = self._ended or (events.pushed, (events.last_us or 0) - (events.first_us or 0))
        return Statistics(
            events=count,
            duration_us=duration_us,
            windows=self._windows,
            searches=self._searches,
            codes_not_decoded=len(self._unread),
        )

    @property
    def timings_ms(self) -> dict[str, float]:
        """What it took so far, by stage [ms]."""
        clock = StageClock()
        for timings_ms in (self._clock.ms, *(track.timings_ms for track in self._tracks)):
            clock.add(timings_ms)
        return clock.ms

    # ---- activities

    def _running(self, until_us: float) -> Working[list[StreamRecord]]:
        """Let activities go on, in the order of the times at which their events are here."""
        most = self._config.max_windows
        ran = False
        while self._waiting and self._waiting[0].end_us <= until_us:
            if most is not None and self._windows >= most:
                self._end(self._waiting[0].end_us)
                break
            ran = True
            activity = self._waiting[0].activity
            if not isinstance(activity, _Following):
                yield from self._go_on(heapq.heappop(self._waiting), activity)
                continue
            if activity.ahead is None:
                yield from self._follow_ahead(until_us)
            self._followed(heapq.heappop(self._waiting), activity)
        if ran and self._waiting:
            self._forget(min(waiting.start_us for waiting in self._waiting))
        records, self._records = self._records, []
        return records

    def _go_on(self, waiting: _Waiting, activity: Activity[None]) -> Working[None]:
        """Let an activity go on with the window that it waits for, until it asks for the next."""
        answers: Any = self._events.window(waiting.start_us, waiting.end_us)
        while True:
            try:
                asked = activity.send(answers)
            except StopIteration:
                return
            if not isinstance(asked, list):
                break
            answers = yield asked
        start_us, end_us = asked
        heapq.heappush(self._waiting, waiting._replace(start_us=start_us, end_us=end_us))

    def _wait(self, activity: Activity[None] | _Following, rank: int, bounds: tuple[int, int]) -> None:
        """Let an activity wait for its first window."""
        start_us, end_us = bounds
        heapq.heappush(self._waiting, _Waiting(end_us, rank, next(self._order), start_us, activity))

    def _end(self, time_us: int) -> None:
        """Stop at a time, with all windows worked on that may be."""
        self._ended = self._events.count_before(time_us), time_us - (self._events.first_us or 0)
        self._waiting.clear()
        for track in list(self._tracks):
            self._finish(track)

    def _forget(self, before_us: int) -> None:
        """Let go of what no activity may ask for: the search alone goes back, by its longest window."""
        self._events.forget(before_us - self._config.motion.longest_us)
        self._known.forget(before_us)
        self._lost = [track for track in self._lost if self._until_us(track) > before_us]

    def _search_from(self, at_us: int) -> None:
        """Search from a time on, instead of from a later one."""
        if self._searching is not None:
            self._searching.close()
            self._waiting = [one for one in self._waiting if one.activity is not self._searching]
            heapq.heapify(self._waiting)
        self._search_us = at_us
        self._searching = self._search(at_us)
        first = next(self._searching)
        assert isinstance(first, tuple)  # a window
        self._wait(self._searching, SEARCH, first)

    # ---- searching

    def _search(self, at_us: int) -> Activity[None]:
        """Search again and again, from a time on.

        What is slow shows in windows that are not here before the stream has been so long.  One that ends
        earlier without a code is searched once more, in windows that are as long as it.
        """
        while True:
            self._search_us = at_us
            yield at_us, at_us + 1
            if not self._events.reaches(at_us + 1):
                if self._found or self._moving.patient or not self._is_young(at_us):
                    return
                self._moving.patient, self._moving.quiet = True, QuietSpells()
                at_us = self._events.first_us or 0
                continue
            self._moving.newest_us = max(self._moving.newest_us, at_us)
            at_us = yield from self._search_once(at_us)

    def _is_young(self, at_us: int) -> bool:
        """Whether the stream has not been as long as the longest window yet."""
        return at_us - (self._events.first_us or 0) < self._config.motion.longest_us

    def _first_event(self, from_us: int) -> Activity[int]:
        """Wait for the first event from a time on; say when it is, or a time past the end of the stream.

        However long that is, nothing is done meanwhile.
        """
        events = self._events
        while (at_us := events.first_from(from_us)) is None:
            now_us = int(events.known_us)
            if events.closed:
                return now_us + 1
            yield now_us, now_us + 1
        yield at_us, at_us + 1
        return at_us

    def _search_once(self, at_us: int) -> Activity[int]:
        """Search at a time, and ahead of it on the other threads, and say when to search again [us]."""
        tries = yield from self._tries(at_us)
        last = next(
            (k for k, tried in enumerate(tries) if not isinstance(tried.found, NotFound)), len(tries) - 1
        )
        for tried in tries[: last + 1]:  # what was searched behind a find will be searched again
            if tried.silent:
                continue
            self._searches += 1
            self._windows += tried.window is not None
            self._vain = self._vain + 1 if tried.window is not None else 0  # until a code is read
            yield from self._take(tried)
        motion, start_us = tries[last].motion, tries[last].start_us
        self._motion = motion
        if tries[last].silent:
            self._vain = 0
            first_us = yield from self._first_event(start_us)
            if first_us > start_us:
                return first_us  # else all events here are of codes that are followed: search behind them
        if motion is None:
            return start_us + self._config.scheduler.unknown_us
        due_us = start_us + self._step_us(motion)
        next_us = yield from self._moving.faster(motion, start_us, due_us, self._config.scheduler.unknown_us)
        if next_us < due_us:
            self._motion = None
        return next_us

    def _tries(self, at_us: int) -> Activity[list[_Try]]:
        """Search at a time, and ahead of it on the other threads while nothing else is going on."""
        if self._pool is None or self._tracks or self._motion is None:
            tried = yield from self._try(at_us)
            return [tried]
        step = self._step_us(self._motion)
        asking = [self._try(at_us + k * step, ahead=k) for k in range(len(self._solvers))]
        # none of them asks for more, so each may run to its end
        most = max(self._config.motion.longest_us, self._config.window_us or 0)
        yield at_us, at_us + (len(asking) - 1) * step + most
        here = [with_windows(one, self._events) for one in asking]
        return list(self._pool.map(answer, here, self._solvers))

    def _step_us(self, motion: Motion) -> int:
        """Time between two searches [us]."""
        cfg = self._config.scheduler
        sure = any(track.reading is not None for track in self._tracks)
        times = (cfg.seldom if sure else 1.0) * 2.0 ** min(self._vain // 2, 16)
        least = self._config.search_px
        travel = min(times * least, max(least, motion.across_px(*self._size) / cfg.searches_across))
        step = max(self._solver.window_us(motion), round(motion.travel_time_us(travel)))
        return min(step, cfg.longest_us)

    def _kinds(self, vain: int) -> tuple[tuple[Symbology, ...], bool]:
        """Give the kinds of symbols that are searched for after so many searches in vain.

        And whether the search is thorough.
        """
        asked, every = self._config.symbologies, self._config.scheduler.every_kind
        first = tuple(kind for kind in asked if kind in BY_THREE_PATTERNS)
        of_all = vain % every == every - 1 or not first
        return asked if of_all else first, vain % (2 * every) == every - 1

    def _try(self, at_us: int, *, ahead: int | None = None) -> Activity[_Try]:
        """Search once; may run on any thread where it is so many ``ahead``, and changes nothing here then."""
        clock, solver = StageClock(), self._solver
        off = ahead is not None
        moving, start_us, known_us = yield from self._moving.at(at_us, self._motion, ahead=off)
        clock.add(moving.timings_ms)
        if isinstance(moving, NotFound) and self._motion is not None:
            moving, start_us, known_us = yield from self._moving.at(at_us, None, ahead=off)
            clock.add(moving.timings_ms)
        if isinstance(moving, NotFound):
            return _Try(at_us, None, None, replace(moving, timings_ms=clock.ms))
        motion = moving.motion
        end_us = start_us + solver.window_us(motion)
        window = yield start_us, end_us
        if not self._events.reaches(end_us):
            ends = NotFound(Reason.RECORDING_ENDS, closest=-1.0, timings_ms=clock.ms)
            return _Try(at_us, motion, None, ends)
        kinds, thorough = self._kinds(self._vain + (ahead or 0))
        (found,) = yield [Find(self._outside_tracks(window), motion, self._tau_us, kinds, thorough)]
        if isinstance(found, NotFound):
            clock.add(found.timings_ms)
            turning = yield [FindTurning(self._outside_tracks(window), motion)] if thorough else []
            if not any(turning):
                return _Try(at_us, motion, window, replace(found, timings_ms=clock.ms))
            return _Try(at_us, motion, window, turning[0])
        longer = self._events.window(start_us, max(end_us, known_us))
        best, *others = yield from self._each_with_its_motion(longer, window, found, clock)
        clock.add(best.timings_ms)
        return _Try(at_us, motion, window, (replace(best, timings_ms=clock.ms), *others))

    def _each_with_its_motion(
        self, longer: Window, window: Window, found: Sequence[Detection], clock: StageClock
    ) -> Working[tuple[Detection, ...]]:
        """Correct the motions of codes by their events alone: what is beside them may move in other ways.

        A window is so short that a code agrees in it with motions that are far off; followed with one of them
        it is lost.  A coarse look tells whether one is.
        """
        own = [inside(longer, code.target, 0.0) for code in found]
        probe = Probe(longer.start_us, longer.end_us, self._config.motion.reduction, True)
        coarse = yield [Estimate(each, probe) for each in own]
        off = [k for k, one in enumerate(coarse) if self._is_off(found[k].motion, one)]
        fine = yield [Estimate(own[k]) for k in off]
        moving = {
            k: found[k].moving(one.motion)
            for k, one in zip(off, fine, strict=True)
            if isinstance(one, MotionEstimate)
        }
        again = yield [Follow(window, code) for code in moving.values()]
        for timed in (*coarse, *fine, *again):
            clock.add(timed.timings_ms)
        codes = list(found)
        for k, one in zip(moving, again, strict=True):
            if isinstance(one, Detection) and one.score >= codes[k].score - SCORES_ALIKE:
                codes[k] = one.altered(timings_ms=codes[k].timings_ms)
        return tuple(codes)

    @staticmethod
    def _is_off(motion: Motion, own: MotionEstimate | NotFound) -> bool:
        """Whether a code clearly moves in another way than was taken for granted."""
        if isinstance(own, NotFound):
            return False
        (x, y), (own_x, own_y) = motion.velocity.tolist(), own.motion.velocity.tolist()
        return math.hypot(own_x - x, own_y - y) > CLEARLY_OFF * math.hypot(x, y)

    def _take(self, tried: _Try) -> Working[None]:
        """Follow the codes that a search found."""
        found, codes = tried.found, 0
        if not isinstance(found, NotFound):
            assert tried.window is not None
            most = self._config.scheduler.codes_a_search
            tracks = [Track(code, tried.window, self._solver) for code in found[:most]]
            yield from together(track.begin() for track in tracks)
            for track in tracks:
                self._tracks.append(track)
                self._merge_with_earlier(track)
                self._wait(_Following(track), FOLLOW, track.next_window())
            codes = len(tracks)
            self._found += codes
        not_found = found if isinstance(found, NotFound) else None
        if not_found is not None:
            self._clock.add(not_found.timings_ms)
        end_us = tried.start_us if tried.window is None else max(tried.start_us, tried.window.end_us)
        self._records.append(
            Searched(tried.start_us, end_us, codes, None if codes else not_found, tried.motion)
        )

    def _outside_tracks(self, window: Window) -> Window:
        """Give a window without the events of the codes that are, or were in it, followed already."""
        lately = (track for track in self._lost if window.start_us < self._until_us(track))
        targets = [track.detection.target for track in (*self._tracks, *lately)]
        return outside(window, targets, self._config.scheduler.margin_modules)

    def _until_us(self, track: Track) -> float:
        """Give until when the events of a code that is not followed any more are its own [us]."""
        detection = track.detection
        if not track.given_up:
            return detection.time_us
        across_px = detection.motion.across_px(*self._size)
        return detection.time_us + detection.motion.travel_time_us(
            self._config.scheduler.given_up_across * across_px
        )

    # ---- following

    def _follow_ahead(self, until_us: float) -> Working[None]:
        """Follow all codes whose windows are here, side by side: what comes of it waits for their turns."""
        due = [
            (one.activity, self._events.window(one.start_us, one.end_us))
            for one in self._waiting
            if isinstance(one.activity, _Following) and one.activity.ahead is None
            if one.end_us <= until_us and self._events.reaches(one.end_us)
        ]
        ahead = yield from together(following.track.follow(window) for following, window in due)
        for (following, _), track in zip(due, ahead, strict=True):
            following.ahead = track

    def _followed(self, waiting: _Waiting, following: _Following) -> None:
        """Take what following a code came to, now that it is its turn; lost where the stream has ended."""
        track = following.track
        if following.ahead is not None:
            self._windows += 1
            self._tracks[self._tracks.index(track)] = track = following.ahead
            self._motion = track.detection.motion
            self._merge_with_earlier(track)
            if not track.lost:
                following.track, following.ahead = track, None
                start_us, end_us = track.next_window()
                heapq.heappush(self._waiting, waiting._replace(start_us=start_us, end_us=end_us))
                return
        self._finish(track)
        if track.reading is not None and waiting.start_us < self._search_us:
            # where one code has gone the next may be; what was given up would only be found again
            self._search_from(waiting.start_us)

    def _merge_with_earlier(self, track: Track) -> None:
        """Give a code its number once it is read, and keep in mind where it is."""
        if track.reading is None:
            return
        target = track.detection.target
        if track.code is not None:
            self._known.moved(track.code, target)
            return
        if any(target.tau_us):  # of the sensor and its light, so the next code will lag as much
            self._tau_us = target.tau_us
        self._vain = 0
        track.code, again = self._known.merge_with_earlier(track.reading, target)
        self._unread.read(target)
        if not again:
            self._records.append(CodeRead(track.code, track.reading))
        elif all(other.code != track.code for other in self._tracks if other is not track):
            self._records.append(CodeAgain(track.code, track.first_us))

    def _finish(self, track: Track) -> None:
        """Follow a code no more."""
        self._tracks.remove(track)
        self._moving.quiet = QuietSpells()  # what was seen without its events says nothing of them
        self._lost.append(track)
        self._clock.add(track.timings_ms)
        if track.code is not None:
            if all(other.code != track.code for other in self._tracks):
                self._records.append(CodeLeft(track.code, track.last_us))
        else:
            unread = track.unread
            self._unread.add(unread)
            self._records.append(unread)
