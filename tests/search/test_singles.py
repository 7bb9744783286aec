"""Single finder patterns and the codes that they could belong to."""

import numpy as np
import pytest
from scenes import at, corners, middle_us, motion_at, scene, window_of

from evqr.config import AlignConfig, FinderConfig
from evqr.events.batch import EventBatch
from evqr.search.finder import find_patterns
from evqr.search.models import kinds_of, sizes
from evqr.search.score import score
from evqr.search.singles import QUARTERS, SHIFTS, codes_of_singles
from evqr.simulate import CodePlacement
from evqr.symbology import Symbology

ALIGN, FINDER = AlignConfig(), FinderConfig()
SYMBOLOGIES = (Symbology.QR_CODE, Symbology.MICRO_QR_CODE)  # without heads
TEXTS = {"M1": "40961", "M2": "DEV-55", "M3": "EVQR-07", "M4": "HELLO-EVQR-7"}


def searched(version, angle, workspace, **options):
    """Hypotheses of the best peaks along the true motion, their scores, and the true pose."""
    placement = CodePlacement(
        text=TEXTS[version], symbology="microqr", version=version, ec="L", module_px=5.0, angle=angle
    )
    made = scene(codes=(placement,), **options)
    truth = next(iter(made.truth.values()))
    motion = motion_at(truth, middle_us(made))
    (found,), pyramid = find_patterns(EventBatch.of([window_of(made)]), [motion], FINDER, workspace=workspace)
    which = np.arange(min(len(found.peaks), FINDER.single_patterns))
    window = np.zeros(len(which), np.intp)
    hypotheses, of_each = codes_of_singles(
        found.peaks.table[which],
        which,
        window,
        np.tile(motion.direction, (len(which), 1)),
        pyramid,
        ALIGN,
        SYMBOLOGIES,
        workspace=workspace,
    )
    everyone = np.zeros(len(hypotheses), np.intp)
    np.testing.assert_array_equal(of_each, everyone)
    scores = score(pyramid, everyone, hypotheses.size, hypotheses.pose, ALIGN, workspace=workspace)
    return which, hypotheses, scores, at(truth, "H", middle_us(made))


def test_a_peak_makes_every_size_in_four_directions_about_one_place(workspace):
    which, hypotheses, _, _ = searched("M2", 20.0, workspace)
    single = [k for k in np.flatnonzero(kinds_of(SYMBOLOGIES)) if len(sizes()[k].anchors) == 1]
    assert len(hypotheses) == len(which) * len(single) * QUARTERS * SHIFTS
    for peak in which:
        mine = hypotheses[(hypotheses.peaks == peak).all(axis=1)]
        assert sorted(mine.size) == sorted(single * QUARTERS * SHIFTS)
        anchors = np.array([(sizes()[k].anchors[0].u, sizes()[k].anchors[0].v, 1.0) for k in mine.size])
        places = np.einsum("nij,nj->ni", mine.pose, anchors)
        assert len(np.unique(np.round(places, 4), axis=0)) in (1, SHIFTS)  # where the motion shows its place
        turns = np.round(np.rad2deg(np.arctan2(mine.pose[:, 1, 0], mine.pose[:, 0, 0])), 3)
        assert len(set(turns)) == QUARTERS
        assert (mine.inverted == mine.inverted[0]).all()


@pytest.mark.parametrize("version", TEXTS)
@pytest.mark.parametrize("angle", [20.0, 110.0, 250.0])
def test_timing_and_quiet_zone_tell_size_and_direction(version, angle, workspace):
    _, hypotheses, scores, true = searched(version, angle, workspace)
    best = int(scores.mean(axis=1).argmax())
    space = hypotheses.space(best)
    assert space.version == version
    off = np.abs(corners(hypotheses.pose[best], space.size) - corners(true, space.size)).max()
    assert off < 1.5 * 5.0
    assert scores[best].mean() > FINDER.min_single_match
