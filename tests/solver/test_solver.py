"""The stages in order: a code found from cold, and followed."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scenes import at, corners, find, middle_us, motion_at, noise, scene, window_of

from evqr.config import AlignConfig, FinderConfig, ReadConfig
from evqr.events.array import EventArray
from evqr.events.batch import EventBatch
from evqr.events.window import make_window
from evqr.fit.detection import Detection, NotFound
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.solver import Solver
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded


@pytest.fixture(scope="module")
def solver():
    return Solver()


def true_motion(made, time=None):
    return motion_at(made.truth["truth"], middle_us(made) if time is None else time)


def modules_off(detection, made):
    """Worst corner of a detection against the truth [modules]."""
    pose = at(made.truth["truth"], "H", detection.time_us)
    size = detection.space.size
    return np.abs(detection.target.outline() - corners(pose, size)).max() / made.scene.codes[0].module_px


def follow(solver, window, detection):
    (found,) = solver.follow(EventBatch.of([window]), [detection])
    return found


def text_of(detection, solver):
    outcome = decode_grid(solver.solve([detection])[0].q, detection.space)
    return outcome.text if isinstance(outcome, Decoded) else None


# ---- from cold


@pytest.mark.parametrize(
    "options",
    [{}, {"angle": 45.0}, {"preset": "fast"}, {"preset": "hard"}, {"invert": True}, {"tilt": 10.0}],
    ids=str,
)
def test_a_code_is_found_in_one_window(options, solver):
    made = scene(**options)
    window = window_of(made)
    detection = find(solver, window, solver.motion_in(window).motion)
    assert isinstance(detection, Detection)
    assert (detection.space.version, detection.space.size) == (2, 25)
    assert detection.time_us == window.middle_us
    assert modules_off(detection, made) < 0.3
    assert solver.config.align.min_score < detection.score <= 1.0
    assert detection.noise > 0.0
    assert all(tau >= 0.0 for tau in detection.tau_us)
    assert text_of(detection, solver) == "EVQR-07"


def test_a_large_code_is_not_taken_for_one_two_versions_off(solver):
    """Version 26 agrees with version 24 to 0.82, and small modules look larger than they are."""
    made = scene(
        "24", version=24, module_px=3.5, angle=30.0, direction=0.0, width=640, height=600, travel_px=4.0
    )
    detection = find(solver, window_of(made), true_motion(made))
    assert isinstance(detection, Detection)
    assert detection.space.version == 24
    assert text_of(detection, solver) == "24"


def test_wrong_motion_by_a_tenth_does_no_harm(solver):
    """The middle of the window is the reference: a wrong motion blurs, but does not move the code."""
    made = scene()
    velocity = true_motion(made).velocity
    for factor in (0.9, 1.1):
        detection = find(solver, window_of(made), Motion(factor * velocity))
        assert modules_off(detection, made) < 0.2


def test_lags_that_are_known_are_not_estimated(solver):
    made = scene(preset="fast")
    detection = find(solver, window_of(made), true_motion(made), tau_us=(100.0, 300.0))
    assert detection.tau_us == (100.0, 300.0)
    fixed = Solver(ReadConfig(lag_us=(50.0, 80.0)))
    found = find(fixed, window_of(made), true_motion(made), tau_us=(100.0, 300.0))
    assert found.tau_us == (50.0, 80.0)


def test_searching_again_in_between_changes_nothing(solver):
    """Nothing of a window is left in the buffers for the next one."""
    made, other = scene(), scene(preset="fast", angle=45.0)
    first = find(solver, window_of(made), true_motion(made))
    find(solver, window_of(other), true_motion(other))
    find(solver, window_of(other, 5.0), true_motion(other))
    again = find(solver, window_of(made), true_motion(made))
    fresh = find(Solver(), window_of(made), true_motion(made))
    assert again == first == fresh
    assert hash(again) == hash(first)
    assert pickle.loads(pickle.dumps(first)) == first


@pytest.mark.parametrize("count", [0, 300, 20_000])
def test_a_window_without_a_code_gives_a_reason(count, solver):
    window = make_window(noise(count, 1000), 0, 1000)
    unseen = find(solver, window, Motion([3000.0, -1000.0]))
    assert isinstance(unseen, NotFound)
    assert unseen.reason in (Reason.NO_FINDER_PATTERNS, Reason.DISAGREES)
    assert str(unseen).startswith(unseen.reason.text)
    assert 0.0 <= unseen.closest < solver.config.align.min_score


@pytest.mark.parametrize(
    "config",
    [
        ReadConfig(align=AlignConfig(min_score=1.0, good_score=1.0)),
        ReadConfig(align=AlignConfig(coarse_score=1.0)),
        ReadConfig(finder=FinderConfig(min_match=1.0, hidden_hypotheses=0, single_patterns=0)),
    ],
    ids=["refined", "screened", "scored"],
)
def test_what_came_closest_is_told_however_far_it_was_looked_at(config):
    made = scene()
    window = window_of(made)
    unseen = find(Solver(config), window, true_motion(made))
    assert isinstance(unseen, NotFound)
    assert unseen.reason is Reason.DISAGREES
    assert 0.2 < unseen.closest < 1.0
    assert str(unseen).startswith(f"{Reason.DISAGREES.text}: {unseen.closest:.2f}, the best of")
    assert unseen.nearest is not None
    pose = at(made.truth["truth"], "H", window.middle_us)
    off_px = np.abs(unseen.nearest.outline() - corners(pose, unseen.nearest.space.size)).max()
    assert off_px < 2.0 * made.scene.codes[0].module_px


def test_what_does_not_move_cannot_be_seen(solver):
    assert find(solver, window_of(scene()), Motion([0.0, 0.0])) == NotFound(Reason.NOTHING_MOVES)


def test_results_say_how_long_their_stages_took(solver):
    made = scene(travel_px=20.0)
    window = window_of(made, middle=500)
    moving = solver.motion_in(window)
    found = find(solver, window, moving.motion)
    nothing = find(solver, make_window(noise(0, 1000), 0, 1000), moving.motion)
    followed = follow(solver, window_of(made, middle=1000), found)
    assert set(moving.timings_ms) - {"one_time"} == {"motion"}
    assert {"finder", "pose", "stage_one"} <= set(found.timings_ms)
    assert {"finder"} <= set(nothing.timings_ms) - {"one_time"} <= {"finder", "pose"}
    assert set(followed.timings_ms) - {"one_time"} == {"stage_one"}
    kept = dict(found.timings_ms)
    find(solver, window, moving.motion)
    assert found.timings_ms == kept
    assert all(ms > 0.0 for result in (moving, found, nothing, followed) for ms in result.timings_ms.values())


# ---- following


@pytest.fixture(scope="module")
def detection(solver):
    made = scene(travel_px=20.0)
    return find(solver, window_of(made, middle=500), true_motion(made, 500))


def test_a_pose_moves_with_the_velocity(detection):
    later = detection.at(detection.time_us + 2000)
    assert later.time_us == detection.time_us + 2000
    moved = later.outline() - detection.target.outline()
    np.testing.assert_allclose(moved, np.broadcast_to(detection.motion.velocity * 2e-3, (4, 2)), atol=1e-6)
    np.testing.assert_allclose(
        later.centre - detection.centre, detection.motion.displacement(2000), atol=1e-6
    )
    assert detection.at(detection.time_us) is detection.target


def off_by(detection, u, v):
    """A detection whose pose is wrong by some modules."""
    wrong = detection.pose @ np.array([[1.0, 0.0, u], [0.0, 1.0, v], [0.0, 0.0, 1.0]])
    return replace(detection, target=replace(detection.target, pose=wrong))


@pytest.mark.parametrize("after_us", [500, 2000, 4000])
def test_a_code_is_found_again_where_it_should_be_by_now(after_us, detection, solver):
    """2 and 8 px of travel, the steps of the reader, and twice that."""
    made = scene(travel_px=20.0)
    window = window_of(made, middle=500 + after_us)
    seen = detection.moving(true_motion(made))
    again = follow(solver, window, seen)
    assert isinstance(again, Detection)
    assert modules_off(again, made) < 0.15
    assert (again.space, again.time_us, again.tau_us) == (seen.space, window.middle_us, seen.tau_us)
    assert text_of(again, solver) == "EVQR-07"


def test_following_corrects_a_pose_that_is_wrong_by_half_a_module(detection, solver):
    made = scene(travel_px=20.0)
    seen = off_by(detection.moving(true_motion(made)), 0.35, -0.3)
    assert modules_off(follow(solver, window_of(made, middle=1000), seen), made) < 0.15


def test_a_code_that_is_not_there_is_lost(detection, solver):
    made = scene(travel_px=20.0)
    lost = [
        follow(solver, window_of(made, middle=1000), off_by(detection, 9.0, 9.0)),
        follow(solver, make_window(noise(5_000, 2000), 750, 1250), detection),
    ]
    nothing = EventArray(*(np.zeros(0, d) for d in (np.int64, np.uint16, np.uint16, np.int8)), 320, 240)
    lost.append(follow(solver, make_window(nothing, 750, 1250), detection))
    for found in lost:
        assert isinstance(found, NotFound)
        assert found.reason is Reason.DISAGREES
        assert found.closest < solver.config.align.min_score
