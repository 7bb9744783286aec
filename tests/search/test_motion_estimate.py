"""Motion from cold: speed, direction and sign on simulated scenes, and nothing where nothing moves."""

import numpy as np
import pytest
from scenes import joined, noise, scene, window_of

from evqr.config import MotionConfig
from evqr.events.array import EventArray
from evqr.events.buffer import EventBuffer
from evqr.events.window import Window, make_window
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.search.motion_estimate import (
    MotionEstimate,
    QuietSpells,
    estimate_motion,
    estimate_motions,
    find_motion,
    motion_probes,
)
from evqr.workspace import Workspace
from evqr_kernels.registry import get_backend

CONFIG = MotionConfig()

SPEED_TOLERANCE = 0.12
"""Relative.  Over the 3 px of a window, 12 % are 0.2 px on either side of the middle: a part of a module."""

DIRECTION_TOLERANCE_DEG = 10.0
"""Over 2 px of travel, 10 degrees blur by 0.35 px; most of it is seen where code and motion have one axis."""


def find(events, start_us=0, **options):
    return EventBuffer.of(events).answer(find_motion(start_us, CONFIG, **options))


def between_deg(a, b):
    """Angle from one vector to another [deg]."""
    return np.rad2deg(np.arctan2(b[0] * a[1] - b[1] * a[0], a @ b))


def assert_close(found, velocity):
    assert isinstance(found, MotionEstimate)
    motion = found.motion
    assert motion.speed == pytest.approx(np.hypot(*velocity), rel=SPEED_TOLERANCE)
    assert abs(between_deg(motion.velocity, velocity)) < DIRECTION_TOLERANCE_DEG


def small(**options):
    """A small scene and its velocity [px/s]."""
    made = scene(**{"version": 1, "module_px": 4.0, "width": 200, "height": 160, "travel_px": 6.0, **options})
    return made, made.truth["truth"]["velocity"][0]


def joined_in_time(*parts):
    """Events of several recordings, at once."""
    columns = [np.concatenate([getattr(part, name) for part in parts]) for name in ("t", "x", "y", "p")]
    order = np.argsort(columns[0], kind="stable")
    return EventArray(*(column[order] for column in columns), parts[0].width, parts[0].height)


# ---- what is found


@pytest.mark.parametrize("direction", [0.0, 50.0, 135.0, -70.0])
@pytest.mark.parametrize("speed", [0.5, 10.0])
@pytest.mark.parametrize("preset", ["clean", "fast"])
def test_finds_any_direction_and_speed_from_cold(direction, speed, preset, workspace):
    made, velocity = small(direction=direction, speed_px_ms=speed, preset=preset)
    assert_close(find(made.events, workspace=workspace), velocity)


def test_motion_along_the_axis_of_the_code(workspace):
    """Half of the edges lie along the motion and say nothing: only their ends do."""
    made, velocity = small(direction=200.0, angle=20.0)
    assert_close(find(made.events, workspace=workspace), velocity)


@pytest.mark.parametrize(
    ("angle", "direction", "speed", "module"),
    [(30.0, 10.0, 4.0, 5.0), (63.0, 200.0, 8.0, 4.5), (45.0, 320.0, 2.0, 4.0), (20.0, 20.0, 0.5, 6.0)],
)
def test_speeds_are_not_biased(angle, direction, speed, module, workspace):
    """Edges of the other sign, a module away, are seen on one side of the peak alone where shifts are few."""
    made, velocity = small(
        angle=angle, direction=direction, speed_px_ms=speed, module_px=module, preset="clean",
        width=240, height=240, travel_px=16.0,
    )  # fmt: skip
    last_us = int(made.events.t[-1]) - round(4000.0 / speed)
    found = [find(made.events, start, workspace=workspace) for start in range(0, last_us, last_us // 12)]
    along = [one.motion.velocity @ velocity / (velocity @ velocity) for one in found]
    assert np.median(along) == pytest.approx(1.0, abs=0.01)


def test_a_guess_of_the_speed_leads_to_the_same_motion(workspace):
    made, velocity = small(direction=50.0)
    for guess in (0.7, 1.0, 1.4):
        assert_close(find(made.events, workspace=workspace, guess=Motion(guess * velocity)), velocity)


def test_one_window_of_fixed_length_is_enough(workspace):
    made, velocity = small(direction=50.0)
    for travel in (1.5, 2.0, 4.0):
        assert_close(estimate_motion(window_of(made, travel), CONFIG, workspace=workspace), velocity)


def test_more_travel_than_the_fine_look_reaches(workspace):
    """Halves 5 px apart: ``reach_px`` is 3, and is raised."""
    made, velocity = small(direction=50.0, travel_px=12.0)
    assert_close(estimate_motion(window_of(made, 10.0), CONFIG, workspace=workspace), velocity)


def test_the_sign_comes_from_the_order_of_time(workspace):
    made, velocity = small(direction=50.0)
    window = window_of(made)
    e = window.events
    t = window.start_us + window.end_us - e.t
    backwards = Window(
        EventArray(t[::-1], e.x[::-1], e.y[::-1], -e.p[::-1], e.width, e.height),
        window.start_us,
        window.end_us,
    )
    assert_close(estimate_motion(window, CONFIG, workspace=workspace), velocity)
    assert_close(estimate_motion(backwards, CONFIG, workspace=workspace), -velocity)


def test_contrast_of_the_other_sign_changes_nothing(workspace):
    made, _ = small(direction=50.0)
    window = window_of(made)
    e = window.events
    other = Window(EventArray(e.t, e.x, e.y, -e.p, e.width, e.height), window.start_us, window.end_us)
    ours, theirs = (estimate_motion(w, CONFIG, workspace=workspace) for w in (window, other))
    np.testing.assert_allclose(ours.motion.velocity, theirs.motion.velocity, rtol=1e-6)
    assert ours.correlation == pytest.approx(theirs.correlation)


def test_hot_pixels_do_not_fool_it(workspace):
    """100 pixels that fire every 2 us: they outnumber an edge's pixels by far, and stand still."""
    made, velocity = small(direction=50.0)
    rng, events = np.random.default_rng(3), made.events
    count, duration = 100, int(events.t[-1]) + 1
    each = duration // 2
    t = np.concatenate([events.t, rng.integers(0, duration, count * each)])
    x = np.concatenate([events.x, np.repeat(rng.integers(0, events.width, count), each).astype(np.uint16)])
    y = np.concatenate([events.y, np.repeat(rng.integers(0, events.height, count), each).astype(np.uint16)])
    p = np.concatenate([events.p, np.ones(count * each, np.int8)])
    order = np.argsort(t, kind="stable")
    hot = EventArray(t[order], x[order], y[order], p[order], events.width, events.height)
    assert_close(find(hot, workspace=workspace), velocity)


def test_motion_at_a_later_time_of_a_stream_in_chunks(workspace):
    made, velocity = small(direction=135.0)
    events, start = made.events, 700
    buffer = EventBuffer(events.width, events.height)
    for k in range(0, len(events), 5000):
        buffer.push(events.cut(k, k + 5000))
    buffer.close()
    found = buffer.answer(find_motion(start, CONFIG, workspace=workspace))
    assert_close(found, velocity)
    assert found == find(events, start, workspace=workspace)


def test_the_search_for_motion_asks_for_longer_windows_one_by_one(workspace):
    """From cold with too few events to say anything: each begins at the same place, four times as long."""
    events, asked = noise(150, 60_000), []
    asking, buffer = find_motion(100, CONFIG, workspace=workspace), EventBuffer.of(events)
    bounds = next(asking)
    with pytest.raises(StopIteration) as end:
        while True:
            asked.append(bounds)
            bounds = asking.send(buffer.window(*bounds))
    assert end.value.value is Reason.NOTHING_MOVES
    assert asked == [(100, 1_100), (100, 4_100), (100, 16_100), (100, 50_100)]


@pytest.mark.parametrize("since_us", [None, 0, 90_000, 99_900])
def test_longer_windows_may_end_with_the_shortest(since_us):
    """So that nothing is waited for where nothing moves; as long as a stream is young there are none."""
    cfg, start_us, probes = MotionConfig(), 100_000, []
    asking = motion_probes(start_us, cfg, since_us=since_us)
    with pytest.raises(StopIteration) as end:
        probes.append(next(asking))
        while True:
            probes.append(asking.send(Reason.NOTHING_MOVES))
    assert end.value.value is Reason.NOTHING_MOVES
    lengths = [probe.end_us - probe.start_us for probe in probes]
    last_us = start_us + cfg.probe_us
    there = [length for length in (1_000, 4_000, 16_000, 50_000) if length <= last_us - (since_us or 0)]
    assert lengths == there
    for probe, length in zip(probes, lengths, strict=True):
        assert probe.start_us == (start_us if since_us is None else last_us - length)


def test_what_is_slow_is_seen_in_events_that_are_here():
    cfg = MotionConfig()
    asking = motion_probes(100_000, cfg, since_us=0)
    next(asking)
    coarse = asking.send(Reason.NOTHING_MOVES)
    slow = Motion(np.array([300.0, 0.0]), coarse.end_us)  # 3 px in 10 ms
    fine = asking.send(MotionEstimate(slow, 0.5))
    assert (fine.start_us, fine.end_us, fine.reduction) == (91_000, 101_000, 1)


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_many_windows_together_give_what_each_gives_alone(backend):
    """Of two sensors, with few events, many, none, and noise; some reach further than others."""
    here = Workspace(get_backend(backend), "cpu")
    first, second = small(direction=50.0)[0], small(direction=-70.0, width=120, height=176)[0]
    windows = [
        window_of(first, 2.0), window_of(second, 3.0), make_window(noise(150, 1000), 0, 1000),
        window_of(first, 6.0), make_window(noise(0, 1000), 0, 1000), make_window(noise(9000, 1000), 0, 1000),
    ]  # fmt: skip
    for reduction in (1, 4):
        together = estimate_motions(windows, CONFIG, workspace=here, reduction=reduction)
        alone = [estimate_motion(one, CONFIG, workspace=here, reduction=reduction) for one in windows]
        assert together == alone
        assert [isinstance(one, MotionEstimate) for one in together] == [
            True,
            True,
            False,
            True,
            False,
            False,
        ]
    assert estimate_motions([], CONFIG, workspace=here) == []


def test_some_of_the_events_are_enough_and_all_are_taken_where_they_are_not(workspace):
    made, velocity = small(direction=50.0)
    window, few = window_of(made), MotionConfig(most_events=2000)
    assert len(window) > 2 * few.most_events
    hidden = joined_in_time(made.events, noise(200_000, int(made.events.t[-1]) + 1, width=200, height=160))
    hidden_window = make_window(hidden, window.start_us, window.end_us)
    assert_close(estimate_motion(window, few, workspace=workspace), velocity)
    assert_close(estimate_motion(hidden_window, few, workspace=workspace), velocity)
    (hasty,) = estimate_motions([hidden_window], few, workspace=workspace, thorough=False)
    assert hasty != estimate_motion(hidden_window, CONFIG, workspace=workspace)


def test_pixels_that_fire_once_show_a_motion_too(workspace):
    """Counts of such pixels are spread as those of noise are, though what they show is not."""
    made, velocity = small(direction=50.0, preset="fast")
    window = window_of(made)
    e, late = window.events, window.t >= 0.0
    _, first = np.unique(e.x + 1000 * (e.y + 1000 * late.astype(np.int64)), return_index=True)
    once = np.zeros(len(window), bool)
    once[first] = True
    (found,) = estimate_motions([window.keep(once)], CONFIG, workspace=workspace, thorough=False)
    assert_close(found, velocity)


def test_long_windows_that_showed_nothing_are_not_looked_at_again_soon(workspace):
    events = noise(60_000, 120_000)
    buffer, quiet = EventBuffer.of(events), QuietSpells()
    asked = []
    for start in (0, 2_000, 4_000, 3_000, 12_500, 1_000):
        asking = find_motion(start, CONFIG, workspace=workspace, quiet=quiet)
        bounds, lengths = next(asking), []
        with pytest.raises(StopIteration):
            while True:
                lengths.append((bounds[1] - bounds[0]) // 1000)
                bounds = asking.send(buffer.window(*bounds))
        asked.append(lengths)
    every = [1, 4, 16, 50]
    assert asked == [every, [1, 4], [1, 4, 16], [1, 4, 16], every, every]


def test_what_comes_late_in_a_long_window_is_left_to_shorter_ones(workspace):
    made, _ = small(direction=50.0, travel_px=20.0, speed_px_ms=1.5)
    before = noise(6_000, 20_000, width=200, height=160)
    buffer, quiet = EventBuffer.of(joined(before, made.events, before, before)), QuietSpells()
    (coarse,) = estimate_motions(
        [buffer.window(0, 50_000)], CONFIG, workspace=workspace, reduction=4, thorough=False
    )
    assert isinstance(coarse, MotionEstimate)
    assert buffer.answer(find_motion(0, CONFIG, workspace=workspace, quiet=quiet)) is Reason.NOTHING_MOVES
    assert quiet.covers(1, 50_000)


def test_an_answer_is_the_same_every_time(workspace):
    made, _ = small(direction=50.0)
    first, second = (find(made.events, workspace=workspace) for _ in range(2))
    assert first == second


# ---- what is not


@pytest.mark.parametrize("count", [5_000, 50_000, 400_000])
def test_noise_does_not_move(count, workspace):
    events = noise(count, 60_000)
    assert isinstance(find(events, workspace=workspace), Reason)
    still = estimate_motion(make_window(events, 0, 20_000), CONFIG, workspace=workspace)
    assert isinstance(still, Reason)


@pytest.mark.parametrize("count", [0, 1, 150])
def test_too_few_events_say_nothing(count, workspace):
    few = estimate_motion(make_window(noise(count, 1000), 0, 1000), CONFIG, workspace=workspace)
    assert few is (Reason.TOO_FEW_EVENTS if count else Reason.NO_EVENTS)
    if count:
        assert isinstance(find(noise(count, 1000), workspace=workspace), Reason)


def test_events_of_the_second_half_alone_say_nothing(workspace):
    made, _ = small(direction=50.0)
    window = window_of(made)
    half = estimate_motion(window.keep(window.t > 0.0), CONFIG, workspace=workspace)
    assert half is Reason.TOO_FEW_EVENTS


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_where_events_end_early_the_time_in_which_there_are_any_is_halved(share, workspace):
    made, velocity = small(direction=50.0)
    window = window_of(made, 5.0)
    until = window.start_us + round(share * (window.end_us - window.start_us))
    early = estimate_motion(window.keep(window.events.t < until), CONFIG, workspace=workspace)
    assert isinstance(early, MotionEstimate)
    assert np.hypot(*(early.motion.velocity - velocity)) < 0.1 * np.hypot(*velocity)
