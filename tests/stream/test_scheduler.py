"""The loop over event time: the same records however a stream was cut, each as soon as it can be."""

import itertools
from copy import copy
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from scenes import SPEED_PX_MS, joined, keep, noise, scene
from stream_steps import cut_anywhere, cut_every, records_of

from evqr import ReadConfig, read_codes
from evqr.config import SchedulerConfig
from evqr.events.array import EventArray
from evqr.events.buffer import EventBuffer
from evqr.fit.detection import Detection, NotFound, Target
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.search.motion_estimate import MotionEstimate
from evqr.simulate import CodePlacement, SensorConfig
from evqr.solver import Solver
from evqr.stream.records import CodeAgain, CodeLeft, CodeRead, CodeUnread, Searched
from evqr.stream.scheduler import StreamScheduler
from evqr.stream.unread import at_one_place
from evqr.symbol import qr
from evqr.symbol.decoded import DecodeFailure
from evqr.work import answer, together

VIEW = {"width": 330, "height": 140, "direction": 0.0}


@pytest.fixture(scope="module")
def solver():
    return Solver()


@pytest.fixture(scope="module")
def mixed():
    """Something that is no code, a code that is lost for a while, another of that text, two at once."""
    decoy = scene(code=False, travel_px=8.0, **VIEW).events
    code = scene(version=1, module_px=4.0, travel_px=44.0, **VIEW).events
    again = scene(version=1, module_px=4.0, travel_px=14.0, **VIEW).events
    codes = (
        CodePlacement(text="LEFT", version=1, module_px=4.0, angle=20.0, offset_px=(-80.0, 0.0)),
        CodePlacement(text="RIGHT", version=1, module_px=4.0, angle=60.0, offset_px=(80.0, 0.0)),
    )
    two = scene(codes=codes, travel_px=14.0, **VIEW).events
    parts = (
        decoy,
        keep(code, (code.t < 3_000) | (code.t >= 7_500)),
        replace(again, t=again.t + 9_000),  # where the one before would have been is another place by now
        two,
    )
    return joined(*parts, gap_us=4_000)


@pytest.fixture(scope="module")
def whole(mixed, solver):
    return records_of([mixed], solver)


def kinds(records, *wanted):
    return [record for record in records if isinstance(record, wanted)]


# ---- chunks


def test_what_the_mixed_stream_holds(whole):
    """Or the tests below would compare less than they seem to."""
    records, statistics = whole
    texts = [r.reading.text for r in kinds(records, CodeRead)]
    assert (texts[:2], sorted(texts[2:])) == (["EVQR-07", "EVQR-07"], ["LEFT", "RIGHT"])
    assert [r.code for r in kinds(records, CodeAgain)] == [0]
    assert len(kinds(records, CodeLeft)) == 5
    searched = [r for r in kinds(records, Searched) if r.end_us > r.start_us]
    assert statistics.windows >= len(searched) + 5  # those in which a code is followed
    assert statistics.searches == len(kinds(records, Searched))
    assert statistics.codes_not_decoded <= len(kinds(records, CodeUnread))


@pytest.mark.parametrize("cut", ["1 us", "1 ms", "7 us", "anywhere"])
def test_chunks_of_any_size_give_the_same_records(cut, mixed, whole, solver):
    chunks = (
        cut_anywhere(mixed, 60, seed=2)
        if cut == "anywhere"
        else cut_every(mixed, {"1 us": 1, "1 ms": 1000, "7 us": 7}[cut])
    )
    records, statistics = records_of(chunks, solver)
    assert records == whole[0]
    assert statistics == whole[1]


@pytest.mark.parametrize("step_us", [50, 1_900])
def test_steps_of_any_size_give_the_same_records(step_us, mixed, whole, solver):
    """All events are there, but time goes on bit by bit."""
    scheduler, records = StreamScheduler([solver], mixed.width, mixed.height), []
    scheduler.push(mixed)
    for until in range(int(mixed.t[0]), int(mixed.t[-1]), step_us):
        records += scheduler.step(until)
    records += scheduler.close()
    assert records == whole[0]


@pytest.mark.parametrize("most", [1, 4])
def test_chunks_do_not_matter_where_windows_are_limited(most, mixed):
    solver = Solver(ReadConfig(max_windows=most))
    ways = [records_of(chunks, solver) for chunks in ([mixed], cut_every(mixed, 40))]
    assert ways[0] == ways[1]
    assert ways[0][1].windows == most
    assert ways[0][1].events < len(mixed)


# ---- side by side


def counted(solver, monkeypatch, name):
    """How many windows each call of a method of a solver is given."""
    counts, method = [], getattr(solver, name)
    monkeypatch.setattr(solver, name, lambda *given: (counts.append(len(given[-1])), method(*given))[1])
    return counts


def test_codes_side_by_side_are_followed_and_solved_at_once(whole, mixed, monkeypatch):
    solver = Solver()
    followed, solved = (counted(solver, monkeypatch, name) for name in ("follow", "solve"))
    assert records_of([mixed], solver)[0] == whole[0]
    assert max(followed) == max(solved) == 2


def test_a_code_that_was_followed_ahead_is_still_what_it_was_before_its_turn(mixed, monkeypatch):
    """A search in between must see what was followed up to then, though more is known already."""
    scheduler, ahead = StreamScheduler([Solver()], mixed.width, mixed.height), []
    followed = scheduler._followed

    def spy(waiting, following):
        for track in scheduler._tracks:  # each ended before this turn, or is another's first window
            assert track.last_us <= waiting.end_us
        ahead.append(sum(one.activity.ahead is not None for one in scheduler._waiting if one.rank == 0))
        followed(waiting, following)

    monkeypatch.setattr(scheduler, "_followed", spy)
    scheduler.push(mixed)
    scheduler.close()
    assert max(ahead) >= 1


def test_streams_that_are_read_together_are_what_each_is_alone(whole, mixed):
    """Each cut in its own way, so that one is ahead of another; one of them ends early, one has no events."""
    solver = Solver()
    early = keep(mixed, mixed.t < mixed.t[0] + 12_000)
    streams = [
        cut_every(mixed, 2_000),
        cut_every(early, 700),
        cut_anywhere(mixed, 20, seed=1),
        [mixed.cut(0, 0)],
    ]
    schedulers = [StreamScheduler([solver], mixed.width, mixed.height) for _ in streams]
    records = [[] for _ in streams]
    for chunks in itertools.zip_longest(*streams):
        steps = []
        for scheduler, chunk in zip(schedulers, chunks, strict=True):
            if chunk is not None:
                scheduler.push(chunk)
            steps.append(scheduler.stepping())
        for found, new in zip(records, answer(together(steps), solver), strict=True):
            found += new
    ends = answer(together(scheduler.closing() for scheduler in schedulers), solver)
    for found, new in zip(records, ends, strict=True):
        found += new
    alone, _ = records_of([early], solver)
    for found, expected in zip(records, (whole[0], alone, whole[0], []), strict=True):
        assert list(map(type, found)) == list(map(type, expected))
        assert [r.reading.text for r in kinds(found, CodeRead)] == [
            r.reading.text for r in kinds(expected, CodeRead)
        ]
        assert [(r.start_us, r.end_us) for r in kinds(found, Searched)] == [
            (r.start_us, r.end_us) for r in kinds(expected, Searched)
        ]


# ---- as soon as can be


class Scripted:
    """A solver that finds a code at once, and whose later searches ask for 30 ms, in which nothing moves."""

    motion = Motion(np.array([4_000.0, 0.0]))

    def __init__(self):
        self.config = ReadConfig()
        self.searches = self.finds = 0

    def window_us(self, motion):
        return 100

    @staticmethod
    def moving_at(start_us, solver, *, guess=None, quiet=None, since_us=None):
        solver.searches += 1
        yield start_us, start_us + (100 if solver.searches == 1 else 30_000)
        return MotionEstimate(solver.motion, 0.5) if solver.searches == 1 else NotFound(Reason.NOTHING_MOVES)

    def find(self, batch, motions, *, tau_us=None, symbologies=None, thorough=True):
        self.finds += 1
        if self.finds > 1:
            return [NotFound(Reason.DISAGREES)]
        target = Target(qr.space(1), np.eye(3), motions[0].at(batch.windows[0].middle_us))
        return [(Detection(target, np.ones(2), 0.9, 1.0, None, 1),)]

    def motions(self, windows, *, reduction=None, thorough=True):
        return [MotionEstimate(self.motion, 0.5) for _ in windows]


class FollowedFor:
    """Stands in for a track: a window of 100 us each 500 us, lost after so many."""

    followed: ClassVar[list] = []
    given_up = False

    def __init__(self, detection, window, solver):
        self.detection, self.first_us, self.last_us = detection, window.start_us, window.end_us
        self.code = self.reading = None
        self.timings_ms = {}

    def next_window(self):
        return self.last_us + 400, self.last_us + 500

    def begin(self):
        yield []

    def follow(self, window):
        yield []
        later = copy(self)
        later.last_us = window.end_us
        self.followed.append(window.end_us)
        return later

    @property
    def unread(self):
        return CodeUnread(
            self.first_us, self.last_us, 1, 0.9, NotFound(Reason.NO_CONTENT), self.detection.target
        )

    @property
    def lost(self):
        return len(self.followed) >= 20


def test_a_search_that_waits_for_a_long_window_holds_up_no_code_that_is_followed(monkeypatch):
    monkeypatch.setattr("evqr.stream.scheduler.Track", FollowedFor)
    monkeypatch.setattr("evqr.stream.moving.moving_at", Scripted.moving_at)
    monkeypatch.setattr(FollowedFor, "followed", [])
    events = noise(60_000, 20_000, width=64, height=48)
    scheduler = StreamScheduler([Scripted()], 64, 48)
    for chunk in cut_every(events, 10):
        scheduler.push(chunk)
        records = scheduler.step()
        ended = [r for r in records if isinstance(r, CodeUnread)]
        since = int(chunk.t[-1] - events.t[0])
        assert len(FollowedFor.followed) == min(20, max(0, (since - 100) // 500))
        assert len(scheduler.unread) == (not ended and since >= 100)
        if ended:
            assert ended[0].t_last_us == events.t[0] + 10_100 <= chunk.t[-1] < events.t[0] + 10_120
            return
    pytest.fail("still followed")


class Vain:
    """A solver that finds no code: something moves at 4 px/ms, but for one search."""

    def __init__(self, still):
        self.config, self.still, self.guesses = ReadConfig(), still, []

    def window_us(self, motion):
        return 100

    @staticmethod
    def moving_at(start_us, solver, *, guess=None, quiet=None, since_us=None):
        solver.guesses.append(guess is not None)
        yield start_us, start_us + 100
        if len(solver.guesses) in solver.still:
            return NotFound(Reason.NOTHING_MOVES)
        return MotionEstimate(Motion([4_000.0, 0.0]), 0.5)

    def motions(self, windows, *, reduction=None, thorough=True):
        return [NotFound(Reason.NOTHING_MOVES) for _ in windows]

    def find(self, batch, motions, *, tau_us=None, symbologies=None, thorough=True):
        return [NotFound(Reason.DISAGREES)]

    def find_turning(self, window, motion, found=()):
        return ()


def test_searches_in_vain_become_rarer_until_something_changes(monkeypatch):
    monkeypatch.setattr("evqr.stream.moving.moving_at", Vain.moving_at)
    solver = Vain(still=(7, 8))  # from a guess and without: one search
    records, _ = records_of([noise(90_000, 100_000, width=640, height=48)], solver)
    starts = [record.start_us for record in kinds(records, Searched)]
    # 10, 20, 40 and at most 80 px at 4 px/ms; where nothing moved what is known of the motion is forgotten
    gaps = [2_500, 5_000, 5_000, 10_000, 10_000, 20_000, 2_000, 2_500, 5_000, 5_000]
    assert np.diff(starts)[: len(gaps)].tolist() == gaps
    assert solver.guesses[:10] == [False, *[True] * 6, False, False, True]


def test_where_nothing_moves_the_search_is_up_to_date(solver):
    """No code that comes is waited for until the longest window from before it is over."""
    cfg = solver.config
    latest_us = cfg.scheduler.unknown_us + cfg.motion.probe_us
    events = noise(30_000, 100_000, width=64, height=48)
    scheduler = StreamScheduler([solver], 64, 48)
    behind = []
    for chunk in cut_every(events, 1_000):
        scheduler.push(chunk)
        scheduler.step()
        if (
            len(chunk) and chunk.t[-1] > events.t[0] + cfg.motion.longest_us
        ):  # before, there is no time before
            behind.append(int(chunk.t[-1]) - scheduler.settled_us)
    assert behind and max(behind) <= latest_us + 1_000


def test_something_slow_that_comes_after_noise_is_read(solver):
    """Its speed is told by windows that begin before it came."""
    slow = scene(text="SLOW", version=1, module_px=4.0, speed_px_ms=0.2, travel_px=30.0, **VIEW).events
    events = joined(noise(9_000, 70_000, width=VIEW["width"], height=VIEW["height"]), slow)
    records, _ = records_of(cut_every(events, 5_000), solver)
    (read,) = kinds(records, CodeRead)
    assert read.reading.text == "SLOW"
    assert read.reading.t_first_us < 70_000 + solver.config.motion.longest_us


def test_time_that_passes_without_events_lets_a_code_leave(solver):
    """A belt that stops: no event comes any more, but the line must hear that the code is gone."""
    events = scene(travel_px=16.0, version=1).events
    scheduler = StreamScheduler([solver], events.width, events.height)
    scheduler.push(events)
    records = scheduler.step()
    assert kinds(records, CodeRead)
    assert not kinds(records, CodeLeft)
    assert scheduler.step(int(events.t[-1]) + 10) == []
    (left,) = kinds(scheduler.step(int(events.t[-1]) + 100_000), CodeLeft)
    assert left.code == 0
    assert left.t_last_us <= events.t[-1] + 2_000
    assert left.t_last_us < scheduler.settled_us <= events.t[-1] + 100_000


def test_a_code_that_does_not_decode_says_how_well_it_agrees(solver, monkeypatch):
    """It is known to be a code by its known modules, in the mean over its windows."""

    def fail(q, space, **_):
        return DecodeFailure(reason=Reason.TOO_MANY_ERRORS, detail="", space=space)

    monkeypatch.setattr("evqr.work.decode_grid", fail)
    events = scene(travel_px=16.0, version=1).events
    scheduler = StreamScheduler([solver], events.width, events.height)
    scheduler.push(events)
    records = scheduler.step()
    followed = scheduler.unread
    records += scheduler.close()
    assert len(followed) == 1 and followed[0].agrees(solver.config.align.good_score)
    best = max(kinds(records, CodeUnread), key=lambda record: record.windows)
    assert best.windows > 2 and best.agrees(solver.config.align.good_score) and not best.agrees(1.0)
    assert best.clear_modules > 0.9
    assert 0.5 < best.events_an_edge < 30.0


def test_events_after_a_silence_are_read(solver):
    events = scene(travel_px=16.0, version=1).events
    scheduler = StreamScheduler([solver], events.width, events.height)
    scheduler.push(events)
    scheduler.step(500_000)
    scheduler.push(replace(events, t=events.t + 500_000))
    records = scheduler.close()
    (read,) = kinds(records, CodeRead)
    assert (read.code, read.reading.text) == (1, "EVQR-07")
    assert read.reading.t_first_us >= 500_000


@pytest.mark.timeout(100)
def test_the_search_goes_on_where_all_events_are_of_a_code_that_is_followed(solver):
    """Else it would begin at their first again, and again: what is left of them is noise where a code was."""
    view = {"width": 160, "height": 112}
    code = scene(
        text="ONE", version=1, module_px=4.0, direction=0.0, preset=SensorConfig(threshold=0.9), **view
    ).events
    few = EventArray(
        np.arange(40) * 300,
        np.full(40, 80, np.uint16),
        np.full(40, 56, np.uint16),
        np.ones(40, np.int8),
        **view,
    )
    records, _ = records_of([joined(code, few)], solver)
    starts = [record.start_us for record in kinds(records, Searched)]
    assert starts == sorted(set(starts))
    assert [record.reading.text for record in kinds(records, CodeRead)] == ["ONE"]


def test_hours_without_events_are_one_step(monkeypatch, solver):
    first = scene(version=1, module_px=4.0, travel_px=8.0, **VIEW).events
    asked, window = [], EventBuffer.window
    monkeypatch.setattr(EventBuffer, "window", lambda *bounds: asked.append(1) or window(*bounds))
    counts = []
    for gap_us in (200_000, 3_600_000_000):
        asked.clear()
        result = read_codes(joined(first, first, gap_us=gap_us))
        assert [reading.text for reading in result.readings] == ["EVQR-07", "EVQR-07"]
        counts.append((len(asked), result.seen.searches, result.seen.windows))
    assert counts[0] == counts[1]
    assert counts[0][0] < 60


@pytest.mark.parametrize("step_us", [700, 30_000])
def test_silence_is_the_same_whether_its_end_is_known_or_not(step_us, solver):
    """Also where events begin again within the shortest window after a code has gone."""
    code = scene(version=1, module_px=4.0, travel_px=8.0, **VIEW).events
    few = noise(30, 40_000, width=VIEW["width"], height=VIEW["height"])
    events = joined(code, few, code, code, gap_us=60_700)
    at_once = records_of([events], solver)
    assert records_of(cut_every(events, step_us), solver) == at_once
    scheduler = StreamScheduler([solver], events.width, events.height)
    scheduler.push(events)
    records = []
    for until in range(0, int(events.t[-1]), step_us):
        records += scheduler.step(until)
    assert (records + scheduler.close(), scheduler.statistics) == at_once


def test_a_stream_without_events(solver):
    scheduler = StreamScheduler([solver], 64, 48)
    assert scheduler.step() == scheduler.step(1_000) == []
    assert not scheduler.finished
    assert scheduler.close() == []
    assert scheduler.finished
    assert scheduler.statistics.events == 0
    with pytest.raises(ValueError, match="closed"):
        scheduler.push(noise(5, 100, width=64, height=48))


def test_events_that_come_too_late_are_refused(solver):
    scheduler = StreamScheduler([solver], 64, 48)
    scheduler.push(noise(5, 100, width=64, height=48))
    scheduler.step(5_000)
    with pytest.raises(ValueError, match="in order of time"):
        scheduler.push(noise(5, 100, width=64, height=48))


def test_memory_is_bounded(solver):
    """A second of noise in which nothing moves: no more is held than the longest window asks for."""
    events = noise(400_000, 1_000_000)
    scheduler = StreamScheduler([solver], events.width, events.height)
    held = []
    for chunk in cut_every(events, 5_000):
        scheduler.push(chunk)
        scheduler.step()
        held.append(len(scheduler._events._held.block))
    assert scheduler.statistics.events == len(events)
    assert max(held) < 0.3 * len(events)


# ---- records


def test_records_are_final(whole):
    """A code is read, and leaves; it may be there again, and leaves again; numbers are given in order."""
    state, numbers = {}, []
    for record in whole[0]:
        if isinstance(record, CodeRead):
            assert record.code not in state
            numbers.append(record.code)
            state[record.code] = "there"
        elif isinstance(record, CodeAgain):
            assert state[record.code] == "left"
            state[record.code] = "there"
        elif isinstance(record, CodeLeft):
            assert state[record.code] == "there"
            state[record.code] = "left"
    assert numbers == list(range(len(numbers)))
    assert set(state.values()) == {"left"}


def test_searches_say_what_came_of_them(whole):
    for record in kinds(whole[0], Searched):
        assert (record.codes == 0) == (record.not_found is not None)
        assert record.end_us >= record.start_us
        if record.codes:
            assert record.end_us > record.start_us


def test_reading_a_recording_is_a_fold_over_the_records(mixed, whole):
    result = read_codes(mixed)
    read, last = kinds(whole[0], CodeRead), {r.code: r.t_last_us for r in kinds(whole[0], CodeLeft)}
    expected = [replace(r.reading, t_last_us=last[r.code]) for r in read]
    assert list(result.readings) == sorted(expected, key=lambda r: r.t_read_us)
    assert result.seen["searches"] == whole[1].searches


def test_codes_in_view_at_once_are_no_more_than_the_settings_say(mixed):
    solver = Solver(ReadConfig(scheduler=SchedulerConfig(codes_a_search=1)))
    records, _ = records_of([mixed], solver)
    assert max(r.codes for r in kinds(records, Searched)) == 1


@pytest.mark.parametrize(("along", "other"), [(0.0, 215.0), (35.0, -60.0)])
def test_belts_that_run_in_different_ways_do_not_mix(along, other):
    """Both are in view from the beginning, so the first window's motion is that of neither."""
    belts = [
        scene(text, travel_px=32.0, version=1, module_px=module_px, direction=direction).events
        for text, module_px, direction in (("BELT 1", 5.0, along), ("BELT 2", 4.0, other))
    ]
    t, y, p = (np.concatenate([getattr(belt, name) for belt in belts]) for name in ("t", "y", "p"))
    width = belts[0].width
    x = np.concatenate([belts[0].x, belts[1].x + np.uint16(width)])
    order = np.argsort(t, kind="stable")
    events = EventArray(t[order], x[order], y[order], p[order], 2 * width, belts[0].height)
    readings = read_codes(events).readings
    assert sorted(reading.text for reading in readings) == ["BELT 1", "BELT 2"]
    for reading in readings:
        angle = np.deg2rad(along if reading.text == "BELT 1" else other)
        expected = 1e3 * SPEED_PX_MS * np.array([np.cos(angle), np.sin(angle)])
        assert np.linalg.norm(reading.motion_px_per_s - expected) < 0.05 * np.linalg.norm(expected)


def test_what_cannot_be_read_is_decoded_ever_less_often_then_given_up_for_half_its_way(monkeypatch):
    width = 330
    events = scene(version=1, module_px=4.0, travel_px=200.0, width=width, height=140, direction=0.0).events
    tried_us = []

    def fails(q, space, **how):
        tried_us.append(scheduler.settled_us)
        return DecodeFailure(reason=Reason.TOO_MANY_ERRORS, detail="", space=space)

    monkeypatch.setattr("evqr.work.decode_grid", fails)
    solver = Solver()
    scheduler = StreamScheduler([solver], events.width, events.height)
    scheduler.push(events)
    records = [*scheduler.step(), *scheduler.close()]
    cfg = solver.config
    first, *others = kinds(records, CodeUnread)
    assert first.windows == cfg.track.good_patience
    assert len(set(tried_us)) < 0.75 * scheduler.statistics.windows
    travel_us = 1e6 * cfg.scheduler.given_up_across * width / first.target.motion.speed
    assert all(
        other.t_first_us > first.t_last_us + 0.9 * travel_us
        for other in others
        if at_one_place(other.target, first.target)
    )
