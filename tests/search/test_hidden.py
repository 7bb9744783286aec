"""QR codes of which one finder pattern is not seen."""

import math

import numpy as np
import pytest
from any_motion import moving_code, similarity
from hypothesis import given
from hypothesis import strategies as st

from evqr import ReadConfig, read_codes, read_windows
from evqr.config import FinderConfig
from evqr.events.array import EventArray
from evqr.search.pairs import codes_of_pairs
from evqr.symbol import qr
from evqr.symbol.space import without
from evqr.symbology import Symbology

QR = (Symbology.QR_CODE,)
ANGLE = 0.4


def without_pattern(modules):
    """Nothing printed in place of the finder pattern along u, but something like one where there is none."""
    blank = modules.copy()
    blank[:8, -8:] = 0
    blank[-8:, -8:] = modules[-8:, :8][:, ::-1]
    blank[-6:-3, -6:-1] = 0
    return blank


def passing(damage, *, mirrored=False, invert=False, duration_us=1_000):
    def pose(t_us):
        at = similarity((110 + 2e-3 * (t_us - 500), 90 + 3e-3 * (t_us - 500)), 25, 5.0, ANGLE)
        return at @ np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]) if mirrored else at

    events = moving_code(pose, duration_us, text="TWO OF 3", ec="H", damage=damage)
    if not invert:
        return events
    return EventArray(events.t, events.x, events.y, -events.p, events.width, events.height)


@pytest.mark.parametrize(("mirrored", "invert"), [(False, False), (True, True)])
def test_a_code_is_not_where_a_third_pattern_is_that_is_none(mirrored, invert):
    events = passing(without_pattern, mirrored=mirrored, invert=invert)
    texts = []
    for config in (FinderConfig(), FinderConfig(hidden_hypotheses=0)):
        (window,) = read_windows(events, config=ReadConfig(max_windows=1, symbologies=QR, finder=config))
        texts.append([code.text for code in window.codes if code.text])
    assert texts == [["TWO OF 3"], []]


def test_a_stain_over_a_third_of_a_code_with_one_of_its_patterns():
    v, u = np.indices((25, 25))
    stain = np.hypot(u - 18.5, v - 6.5) < 8.6
    events = passing(lambda modules: np.where(stain, 1, modules), duration_us=3_000)
    assert 0.25 < stain.mean() < 0.35
    assert [reading.text for reading in read_codes(events).readings] == ["TWO OF 3"]


@given(
    version=st.integers(1, 40), hidden=st.integers(0, 2), angle=st.floats(0.0, 6.28), module=st.floats(3, 9)
)
def test_two_patterns_give_pose_and_size(version, hidden, angle, module):
    space = without(qr.space(version), hidden)
    pose = similarity((300.0, 200.0), space.rows, module, angle)
    seen = np.array([(anchor.u, anchor.v, 1.0) for anchor in space.anchors]) @ pose.T
    peaks = np.zeros((2, 5), np.float32)
    peaks[:, 0], peaks[:, 1:3] = (0.8, 0.7), seen[:, :2]
    peaks[:, 3:] = module, angle % (0.5 * math.pi)
    (made,) = codes_of_pairs([peaks], FinderConfig(), hidden=True)
    right = [k for k in range(len(made)) if np.allclose(made.pose[k], pose, atol=0.05 * module)]
    assert [made.space(k) for k in right].count(space) == 1
    assert not made.single


def test_what_is_hidden_is_one_pattern_and_its_separator():
    whole = qr.space(7)
    for hidden in range(3):
        part = without(whole, hidden)
        missing = whole.known & ~part.known
        assert part != whole and part == without(whole, hidden) and missing.sum() == 64
        assert len(part.anchors) == 2 and not (part.known & ~whole.known).any()
        v, u = np.argwhere(missing).mean(axis=0) + 0.5
        assert math.hypot(u - whole.anchors[hidden].u, v - whole.anchors[hidden].v) < 1.0
