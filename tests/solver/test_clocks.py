"""What a clock shows, as long as it has run, does not matter: times go to the device modulo 2^31 us."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import find, middle_us, scene

from evqr.events.batch import EventBatch
from evqr.events.buffer import EventBuffer
from evqr.fit.detection import Detection
from evqr.motion import Motion
from evqr.search.motion_estimate import MotionEstimate
from evqr.solver import Solver


@pytest.fixture(scope="module")
def solver():
    return Solver()


def seen(solver, shift_us):
    """A code found from cold and followed, on a clock that shows so much more [us]."""
    made = scene(preset="fast")
    buffer = EventBuffer.of(replace(made.events, t=made.events.t + shift_us))
    start = middle_us(made) + shift_us - 500
    moving = buffer.answer(solver.motion_at(start))
    assert isinstance(moving, MotionEstimate)
    motion = Motion(moving.motion.parameters, start + 250)
    detection = find(solver, buffer.window(start, start + 500), motion)
    assert isinstance(detection, Detection)
    later = buffer.window(start + 500, start + 1000)
    (followed,) = solver.follow(EventBatch.of([later]), [detection])
    assert isinstance(followed, Detection)
    return moving, detection, followed


@pytest.mark.parametrize("crossed", [1 << 31, 1 << 32, 0, 10**15])
def test_a_code_is_found_and_followed_as_on_any_clock(crossed, solver):
    """The clock passes the mark in the middle of the window."""
    expected = seen(solver, 0)
    found = seen(solver, crossed - middle_us(scene(preset="fast")) + 250)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.motion.velocity, other.motion.velocity)
    for one, other in zip(found[1:], expected[1:], strict=True):
        np.testing.assert_allclose(one.pose, other.pose, atol=1e-6)
        assert one.score == pytest.approx(other.score, abs=1e-6)
        assert one.space == other.space
