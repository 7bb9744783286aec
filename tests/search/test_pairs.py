"""Symbols of whose finder patterns one was not found."""

import numpy as np
import pytest
from scenes import at, find, middle_us, motion_at, scene, window_of

from evqr.config import FinderConfig
from evqr.fit.detection import Detection
from evqr.geometry import inverse, outline
from evqr.search.models import sizes
from evqr.search.pairs import PATTERNS, codes_of_pairs
from evqr.solver import Solver
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded
from evqr.symbology import Symbology

CONFIG = FinderConfig()


def peaks_of(version, degrees, module_px, response=0.5):
    """Pose of a symbol, and its finder patterns as a search finds them: corner, along u, along v."""
    turn, size = np.deg2rad(degrees), 17 + 4 * version
    cos, sin = module_px * np.cos(turn), module_px * np.sin(turn)
    pose = np.array([[cos, -sin, 150.0], [sin, cos, 90.0], [0.0, 0.0, 1.0]])
    far = size - 3.5
    centres = np.array([(3.5, 3.5, 1.0), (far, 3.5, 1.0), (3.5, far, 1.0)])
    x, y, _ = np.einsum("ij,nj->in", pose, centres)
    angle = np.full(3, turn % (0.5 * np.pi))
    return pose, np.stack([np.full(3, response), x, y, np.full(3, module_px), angle], 1).astype(np.float32)


@pytest.mark.parametrize("degrees", [0.0, 33.0, 45.0, 200.0])
@pytest.mark.parametrize("missing", [0, 1, 2])
def test_two_patterns_tell_where_the_third_is(missing, degrees):
    pose, peaks = peaks_of(3, degrees, 5.0, response=-0.5)
    seen = np.delete(peaks, missing, axis=0)
    seen[0, 4] += 0.15  # an angle is known to half a step of the search
    (made,) = codes_of_pairs([seen], CONFIG)
    right = [k for k in range(len(made)) if sizes()[made.size[k]].version == 3]
    off = [np.abs(outline(made.pose[k], (29, 29)) - outline(pose, (29, 29))).max() for k in right]
    assert min(off) < 1e-3
    assert made.inverted.all()
    assert not made.single and made.peaks.max() == 1
    assert {sizes()[k].symbology for k in made.size.tolist()} == {Symbology.QR_CODE}
    assert len(made) <= 3 * 18  # six symbols, in the sizes beside, each in three lengths


def test_what_does_not_agree_is_no_pair():
    _, peaks = peaks_of(2, 10.0, 4.0)
    two = peaks[:2]
    assert len(codes_of_pairs([two], CONFIG)[0])
    for column, value in ((0, -two[1, 0]), (3, 1.6 * two[1, 3]), (4, two[1, 4] + 0.4)):
        other = two.copy()
        other[1, column] = value
        assert not len(codes_of_pairs([other], CONFIG)[0])
    assert not len(codes_of_pairs([two[:1]], CONFIG)[0])


def test_each_window_has_its_own_the_strongest_first():
    rng = np.random.default_rng(5)
    tables = []
    for _ in range(5):
        _, peaks = peaks_of(2, rng.uniform(0, 90), 5.0, response=rng.uniform(0.4, 0.9))
        noise = peaks[rng.integers(0, 3, 20)] * rng.uniform(0.9, 1.1, (20, 5)).astype(np.float32)
        table = np.concatenate([peaks, noise])
        tables.append(table[np.argsort(-table[:, 0])])
    tables[2] = tables[2][:0]
    together = codes_of_pairs(tables, CONFIG)
    for table, made in zip(tables, together, strict=True):
        (alone,) = codes_of_pairs([table], CONFIG)
        np.testing.assert_array_equal(made.table, alone.table)
        strength = np.abs(table[made.peaks[:, :2], 0]).sum(axis=1) if len(made) else np.zeros(0)
        assert (np.diff(strength) <= 1e-6).all()
        assert made.peaks.max(initial=0) < PATTERNS
    assert [len(made) > 0 for made in together] == [True, True, False, True, True]


@pytest.fixture(scope="module")
def solver():
    return Solver(backend="warp")


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_a_code_is_read_that_shows_two_of_its_patterns(missing, solver):
    """Without a single event of the third."""
    made = scene()
    window, truth, time = window_of(made), made.truth["truth"], middle_us(made)
    motion = motion_at(truth, time)
    x, y = motion.transport(window.x, window.y, window.t)
    pose = inverse(at(truth, "H", time))
    u, v, w = (row[0] * x + row[1] * y + row[2] for row in pose)
    u, v = u / w, v / w
    size = len(truth["modules"])
    near_u, near_v = [(u < 8, v < 8), (u > size - 8, v < 8), (u < 8, v > size - 8)][missing]
    found = find(solver, window.keep(~(near_u & near_v & (abs(u - size / 2) < size / 2 + 1))), motion)
    assert isinstance(found, Detection) and found.space.version == 2
    (estimate,) = solver.solve([found])
    outcome = decode_grid(estimate.q, found.space)
    assert isinstance(outcome, Decoded) and outcome.text == "EVQR-07"
