"""Which readings are of one code."""

import numpy as np
import pytest

from evqr.config import SchedulerConfig
from evqr.fit.detection import Target
from evqr.motion import Motion
from evqr.stream.known import KnownCodes
from evqr.symbol import qr
from evqr.symbol.payload import Payload

SIDE = 21 * 4.0

A, B, C = (Payload(text=text, data=text.encode()) for text in "ABC")


def target(x, time_us, velocity=1000.0, module_px=4.0):
    """A code of version 1 with its corner at (x, 100), moving along x."""
    pose = np.array([[module_px, 0.0, x], [0.0, module_px, 100.0], [0.0, 0.0, 1.0]])
    return Target(qr.space(1), pose, Motion(np.array([velocity, 0.0]), time_us))


@pytest.fixture
def known():
    return KnownCodes(SchedulerConfig(), 640, 480)


@pytest.mark.parametrize("off", [0.0, 0.2 * SIDE, -0.2 * SIDE])
def test_a_code_where_it_must_be_is_the_same(off, known):
    assert known.merge_with_earlier(A, target(100.0, 0)) == (0, False)
    assert known.merge_with_earlier(A, target(200.0 + off, 100_000)) == (0, True)


@pytest.mark.parametrize("off", [0.6 * SIDE, -0.6 * SIDE, -100.0])
def test_a_code_elsewhere_is_another(off, known):
    known.merge_with_earlier(A, target(100.0, 0))
    assert known.merge_with_earlier(A, target(200.0 + off, 100_000)) == (1, False)


def test_a_code_of_another_text_is_another(known):
    known.merge_with_earlier(A, target(100.0, 0))
    assert known.merge_with_earlier(B, target(100.0, 0)) == (1, False)


def test_a_code_is_sought_from_where_it_was_last(known):
    known.merge_with_earlier(A, target(100.0, 0))
    known.moved(0, target(300.0, 100_000, velocity=0.0))
    assert known.merge_with_earlier(A, target(200.0, 100_000)) == (1, False)
    assert known.merge_with_earlier(A, target(300.0, 900_000, velocity=0.0)) == (0, True)


def test_a_code_out_of_the_image_is_forgotten_and_one_in_it_is_not(known):
    known.merge_with_earlier(A, target(100.0, 0))
    known.forget(500_000)
    assert known.merge_with_earlier(A, target(600.0, 500_000)) == (0, True)
    known.forget(1_000_000)
    assert known.merge_with_earlier(A, target(1100.0, 1_000_000)) == (1, False)


def test_forgetting_what_is_out_of_the_image_changes_no_number():
    """No code in the image is where one that left it must be by now."""
    rng = np.random.default_rng(0)
    forgetful, other = (KnownCodes(SchedulerConfig(remembered_codes=1000), 640, 480) for _ in range(2))
    for k in range(100):
        one = target(rng.uniform(0.0, 640.0 - SIDE), 1_000 * k, velocity=rng.uniform(-5_000.0, 5_000.0))
        assert forgetful.merge_with_earlier(A, one) == other.merge_with_earlier(A, one)
        forgetful.forget(1_000 * k)
    assert len(forgetful._known) < len(other._known)


def test_no_more_are_remembered_than_the_settings_say():
    known = KnownCodes(SchedulerConfig(remembered_codes=2), 640, 480)
    for k, code in enumerate((A, B, C)):
        assert known.merge_with_earlier(code, target(100.0, 0, velocity=0.0)) == (k, False)
    assert known.merge_with_earlier(B, target(100.0, 9, velocity=0.0)) == (1, True)
    assert known.merge_with_earlier(A, target(100.0, 9, velocity=0.0)) == (3, False)


def test_codes_are_compared_by_bytes_and_not_by_text(known):
    latin, utf_8 = Payload(text="\u00e9", data=b"\xe9"), Payload(text="\u00e9", data=b"\xc3\xa9")
    gs1 = Payload(text="\u00e9", data=b"\xe9", symbology_identifier="]Q3")
    for number, code in enumerate((latin, utf_8, gs1)):
        assert known.merge_with_earlier(code, target(100.0, 0)) == (number, False)
    again = Payload(text="e with an accent", data=b"\xe9")
    assert known.merge_with_earlier(again, target(100.0, 0)) == (0, True)
