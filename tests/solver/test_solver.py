"""The stages in order: a code found from cold, and followed."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import at, corners, middle_us, noise, scene, window_of

from evqr.config import ReadConfig
from evqr.events.array import EventArray
from evqr.events.window import make_window
from evqr.fit.modules import solve_modules
from evqr.search.motion_estimate import Motion
from evqr.solver import Sighting, Solver, Unseen
from evqr.symbol import qr
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded


@pytest.fixture(scope="module")
def solver():
    return Solver()


def true_motion(made, time=None):
    velocity = at(made.truth["truth"], "velocity", middle_us(made) if time is None else time)
    return Motion(velocity, 1.0)


def modules_off(sighting, made, time=None):
    """Worst corner of a sighting against the truth [modules]."""
    pose = at(made.truth["truth"], "H", sighting.time_us if time is None else time)
    seen = sighting.pose if time is None else sighting.pose_at(time)
    off = np.abs(corners(seen, sighting.size) - corners(pose, sighting.size)).max()
    return off / made.scene.codes[0].module_px


def text_of(sighting, solver):
    q = solve_modules(sighting.weighted, solver.config.stage_two, workspace=solver.workspace).q
    outcome = decode_grid(q, qr.space(sighting.version))
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
    motion = solver.motion_in(window)
    sighting = solver.look(window, motion)
    assert isinstance(sighting, Sighting)
    assert sighting.version == 2
    assert sighting.size == 25
    assert sighting.time_us == window.middle_us
    assert modules_off(sighting, made) < 0.3
    assert solver.config.stage_one.min_score < sighting.score <= 1.0
    assert sighting.noise > 0.0
    assert all(lag >= 0.0 for lag in sighting.lag_us)
    assert text_of(sighting, solver) == "EVQR-07"


def test_a_large_code_is_not_taken_for_one_two_versions_off(solver):
    """Version 26 agrees with version 24 to 0.82, and small modules look larger than they are."""
    made = scene(
        "24", version=24, module_px=3.5, angle=30.0, direction=0.0, width=640, height=600, travel_px=4.0
    )
    sighting = solver.look(window_of(made), true_motion(made))
    assert isinstance(sighting, Sighting)
    assert sighting.version == 24
    assert text_of(sighting, solver) == "24"


def test_wrong_motion_by_a_tenth_does_no_harm(solver):
    """The middle of the window is the reference: a wrong motion blurs, but does not move the code."""
    made = scene()
    velocity = true_motion(made).velocity
    for factor in (0.9, 1.1):
        sighting = solver.look(window_of(made), Motion(factor * velocity, 1.0))
        assert modules_off(sighting, made) < 0.2


def test_lags_that_are_known_are_not_estimated(solver):
    made = scene(preset="fast")
    sighting = solver.look(window_of(made), true_motion(made), lag_us=(100.0, 300.0))
    assert sighting.lag_us == (100.0, 300.0)
    fixed = Solver(ReadConfig(lag_us=(50.0, 80.0)))
    assert fixed.look(window_of(made), true_motion(made), lag_us=(100.0, 300.0)).lag_us == (50.0, 80.0)


def test_looking_again_in_between_changes_nothing(solver):
    """Nothing of a window is left in the buffers for the next one."""
    made, other = scene(), scene(preset="fast", angle=45.0)
    first = solver.look(window_of(made), true_motion(made))
    solver.look(window_of(other), true_motion(other))
    solver.look(window_of(other, 5.0), true_motion(other))
    again = solver.look(window_of(made), true_motion(made))
    fresh = Solver().look(window_of(made), true_motion(made))
    for sighting in (again, fresh):
        np.testing.assert_array_equal(sighting.pose, first.pose)
        np.testing.assert_array_equal(sighting.equations.rhs, first.equations.rhs)
        np.testing.assert_array_equal(sighting.equations.stencil, first.equations.stencil)
        assert sighting.lag_us == first.lag_us


@pytest.mark.parametrize("count", [0, 300, 20_000])
def test_a_window_without_a_code_gives_a_reason(count, solver):
    window = make_window(noise(count, 1000), 0, 1000)
    unseen = solver.look(window, Motion(np.array([3000.0, -1000.0]), 1.0))
    assert isinstance(unseen, Unseen)
    assert len(unseen.reason.split()) > 3
    assert 0.0 <= unseen.closest < solver.config.stage_one.min_score


def test_what_does_not_move_cannot_be_seen(solver):
    assert solver.look(window_of(scene()), Motion(np.zeros(2), 1.0)) == Unseen("nothing moves")


def test_times_of_the_stages_add_up():
    timed = Solver()
    made = scene()
    timed.look(window_of(made), true_motion(made))
    total = timed.clock.total()
    assert {"finder", "pose", "stage_one"} <= set(total)
    assert min(total.values()) >= 0.0
    assert total["total"] == pytest.approx(sum(ms for stage, ms in total.items() if stage != "total"))


# ---- following


@pytest.fixture(scope="module")
def sighting(solver):
    made = scene(travel_px=20.0)
    return solver.look(window_of(made, middle=500), true_motion(made, 500))


def test_a_pose_moves_with_the_velocity(sighting):
    later = sighting.pose_at(sighting.time_us + 2000)
    moved = corners(later, 25) - corners(sighting.pose, 25)
    np.testing.assert_allclose(moved, np.broadcast_to(sighting.velocity * 2e-3, (4, 2)), atol=1e-6)
    np.testing.assert_array_equal(sighting.pose_at(sighting.time_us), sighting.pose)


@pytest.mark.parametrize("after_us", [500, 2000, 4000])
def test_a_code_is_found_again_where_it_should_be_by_now(after_us, sighting, solver):
    """2 and 8 px of travel, the steps of the reader, and twice that."""
    made = scene(travel_px=20.0)
    window = window_of(made, middle=500 + after_us)
    seen = replace(sighting, velocity=true_motion(made).velocity)
    again = solver.follow(window, seen)
    assert again is not None
    assert modules_off(again, made) < 0.15
    assert (again.version, again.time_us, again.lag_us) == (2, window.middle_us, sighting.lag_us)
    assert text_of(again, solver) == "EVQR-07"


def test_following_corrects_a_pose_that_is_wrong_by_half_a_module(sighting, solver):
    made = scene(travel_px=20.0)
    shifted = sighting.pose @ np.array([[1.0, 0.0, 0.35], [0.0, 1.0, -0.3], [0.0, 0.0, 1.0]])
    seen = replace(sighting, pose=shifted, velocity=true_motion(made).velocity)
    assert modules_off(solver.follow(window_of(made, middle=1000), seen), made) < 0.15


def test_a_code_that_is_not_there_is_lost(sighting, solver):
    made = scene(travel_px=20.0)
    elsewhere = replace(
        sighting, pose=sighting.pose @ np.array([[1.0, 0.0, 9.0], [0.0, 1.0, 9.0], [0.0, 0.0, 1.0]])
    )
    assert solver.follow(window_of(made, middle=1000), elsewhere) is None
    assert solver.follow(make_window(noise(5_000, 2000), 750, 1250), sighting) is None
    nothing = EventArray(*(np.zeros(0, d) for d in (np.int64, np.uint16, np.uint16, np.int8)), 320, 240)
    assert solver.follow(make_window(nothing, 750, 1250), sighting) is None
