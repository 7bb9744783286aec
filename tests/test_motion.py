"""Motions: fields of velocities that transport events and advance poses."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evqr.motion import Motion
from evqr_kernels import splat_events

STILL = Motion(np.zeros(2))

numbers = st.floats(-1e4, 1e4)
slopes = st.floats(-30.0, 30.0)
uniform = st.tuples(numbers, numbers)
motions = st.builds(
    lambda parameters, time_us, about: Motion(np.array(parameters), time_us, about),
    st.one_of(uniform, st.tuples(numbers, numbers, *[slopes] * 4)),
    st.integers(0, 10**9),
    st.tuples(st.floats(0.0, 1280.0), st.floats(0.0, 720.0)),
)
POSE = np.array([[4.0, -1.5, 80.0], [1.5, 4.0, 40.0], [8e-4, -5e-4, 1.0]])


def place(pose, u, v):
    x, y, z = pose @ (u, v, 1.0)
    return np.array([x / z, y / z])


def test_motions_are_values():
    one, same = (Motion([3.0, -4.0], 7) for _ in range(2))
    assert one == same == copy.deepcopy(one) == pickle.loads(pickle.dumps(one))
    assert len({one, same, Motion([3.0, -4.0], 8), Motion([3.0, 4.0], 7)}) == 3
    assert Motion([0.0, 1.0]) == Motion([-0.0, 1.0])
    assert hash(Motion([0.0, 1.0])) == hash(Motion([-0.0, 1.0]))
    assert Motion([1.0, 2.0], about=(3.0, 4.0)) == Motion([1.0, 2.0])
    assert one != "motion"
    for motion in (one, pickle.loads(pickle.dumps(one))):
        assert motion.parameters.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            motion.parameters[0] = 1.0


def test_a_motion_owns_its_numbers():
    given_, motion = np.array([3.0, -4.0]), None
    motion = Motion(given_)
    given_[0] = 9.0
    assert motion.speed == 5.0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (np.zeros(3), r"parameters must have shape \(2,\) or \(6,\), got \(3,\)"),
        (np.zeros((1, 2)), r"got \(1, 2\)"),
        ([1.0, np.nan], "parameters must be finite"),
    ],
    ids=["3", "1x2", "nan"],
)
def test_what_is_no_motion_is_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        Motion(wrong)


@given(motions, st.floats(-1e4, 1e4), st.floats(0.0, 1280.0), st.floats(0.0, 720.0))
def test_transport_undoes_advance(motion, after_us, x, y):
    """A point that is seen later was where it started from."""
    later = motion.advance(np.eye(3), motion.time_us + after_us)
    there = place(later, x, y)
    back = motion.transport(*(np.array([value]) for value in (*there, after_us * 1e-6)))
    np.testing.assert_allclose(np.ravel(back), (x, y), atol=1e-6 * max(1.0, *np.abs(there)))


@given(motions, st.floats(0.0, 1280.0), st.floats(0.0, 720.0))
def test_the_velocity_is_how_fast_poses_advance(motion, x, y):
    pose = np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
    ahead, behind = (place(motion.advance(pose, motion.time_us + dt), 0.0, 0.0) for dt in (1.0, -1.0))
    velocity = motion.velocity_at((x, y))
    np.testing.assert_allclose((ahead - behind) / 2e-6, velocity, atol=1e-4 * (1.0 + np.abs(velocity).max()))
    assert motion.speed == pytest.approx(np.hypot(*motion.velocity_at(motion.about)))


@given(motions)
def test_at_its_own_time_nothing_has_moved(motion):
    np.testing.assert_array_equal(motion.advance(POSE, motion.time_us), POSE)
    assert motion.at(motion.time_us) is motion
    assert motion.turned(0.0) is motion


@given(motions, st.floats(-4.0, 4.0))
def test_turning_turns_every_velocity(motion, angle):
    point = np.array([300.0, 200.0])
    cos, sin = np.cos(angle), np.sin(angle)
    expected = np.array([[cos, -sin], [sin, cos]]) @ motion.velocity_at(point)
    turned = motion.turned(angle)
    np.testing.assert_allclose(turned.velocity_at(point), expected, atol=1e-8 * (1 + np.abs(expected).max()))
    assert (turned.time_us, turned.uniform) == (motion.time_us, motion.uniform)


@given(motions, st.tuples(st.floats(0.0, 1e4), st.floats(0.0, 1e4)))
def test_lags_and_time_constants_belong_together(motion, tau_us):
    assert motion.lag_px(tau_us) == pytest.approx(tuple(motion.speed * 1e-6 * tau for tau in tau_us))
    if motion.speed > 1e-3:
        assert motion.tau_us(motion.lag_px(tau_us)) == pytest.approx(tau_us)


@pytest.mark.parametrize("parameters", [(3000.0, -1000.0), (3000.0, -1000.0, 20.0, -5.0, 8.0, 12.0)], ids=len)
def test_it_moves_as_the_kernels_do(parameters):
    """One event, transported by the motion or by `splat_events`: the centre of mass of its splat."""
    height, width, t = 48, 64, 2e-3
    motion = Motion(parameters, about=(width / 2 - 0.5, height / 2 - 0.5))
    x, y = np.array([40.0]), np.array([20.0])
    image = splat_events(
        x, y, np.array([t]), np.ones(1), np.array([0, 1], np.int32), motion.parameters[None],
        shape=(height, width), backend="numpy",
    )[0]  # fmt: skip
    rows, columns = np.mgrid[:height, :width]
    mean = np.array([(columns * image).sum(), (rows * image).sum()]) / image.sum()
    np.testing.assert_allclose(mean, np.ravel(motion.transport(x, y, np.array([t]))), atol=0.02)


def test_windows_are_as_long_as_the_travel_takes():
    def length(speed, travel_px):
        return Motion([0.6 * speed, 0.8 * speed]).window_us(travel_px, longest_us=50_000)

    assert length(4000.0, 2.0) == 500
    assert length(1000.0, 3.0) == 3000
    assert length(0.0, 2.0) == 50_000
    assert length(1.0, 2.0) == 50_000
    assert 1 <= length(1e12, 2.0) <= 100


def test_travel_and_its_time_belong_together():
    motion = Motion([300.0, 400.0])
    assert motion.travel_time_us(2.0) == pytest.approx(4000.0)
    assert motion.travel_px(4000.0) == pytest.approx(2.0)
    np.testing.assert_allclose(motion.displacement(4000.0), [1.2, 1.6])
    assert STILL.travel_px(1e6) == 0.0 < STILL.travel_time_us(1.0) < np.inf
    np.testing.assert_array_equal(STILL.direction, 0.0)
