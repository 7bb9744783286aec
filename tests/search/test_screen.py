"""Screening of hypotheses: the right one agrees best, and comes out refined."""

import numpy as np
import pytest
from scenes import at, corners, middle_us, motion_at, moved, scene, window_of

from evqr.config import AlignConfig, FinderConfig
from evqr.events.batch import EventBatch
from evqr.search.finder import find_patterns
from evqr.search.hypothesis import Hypotheses
from evqr.search.models import sizes
from evqr.search.score import score
from evqr.search.screen import screen
from evqr.search.triples import codes_of_triples

ALIGN, FINDER = AlignConfig(), FinderConfig()


def searched(made, workspace):
    """The pyramid of a search along the true motion, the hypotheses of its triples, and the true pose."""
    truth = made.truth["truth"]
    motion = motion_at(truth, middle_us(made))
    (found,), pyramid = find_patterns(EventBatch.of([window_of(made)]), [motion], FINDER, workspace=workspace)
    hypotheses = codes_of_triples(found.peaks.table, found.triples, FINDER)
    return pyramid, hypotheses, at(truth, "H", middle_us(made))


def at_poses(versions, poses):
    """Hypotheses without finder patterns of their own."""
    of_version = {size.version: k for k, size in enumerate(sizes())}
    count = len(versions)
    return Hypotheses.of(
        np.array([of_version[version] for version in versions]),
        np.array(poses),
        np.zeros((count, 3), np.intp),
        np.zeros(count, bool),
    )


def modules_off(pose, true, size, module_px):
    return np.abs(corners(pose, size) - corners(true, size)).max() / module_px


@pytest.mark.parametrize(
    ("version", "module_px", "preset"),
    [(1, 6.0, "clean"), (2, 5.0, "clean"), (2, 5.0, "fast"), (4, 4.0, "clean"), (7, 4.0, "clean")],
)
@pytest.mark.parametrize("invert", [False, True])
def test_the_right_hypothesis_matches_best_and_is_refined(version, module_px, preset, invert, workspace):
    """What all symbols of a size show tells the code from every other hypothesis, before any is aligned."""
    made = scene(
        version=version, module_px=module_px, angle=30.0, width=320, height=320, preset=preset, invert=invert
    )
    pyramid, hypotheses, true = searched(made, workspace)
    window = np.zeros(len(hypotheses), np.intp)
    scores = score(pyramid, window, hypotheses.size, hypotheses.pose, ALIGN, workspace=workspace)
    match = scores.mean(axis=1)
    best, size = int(match.argmax()), 17 + 4 * version
    assert hypotheses.space(best).version == version
    assert modules_off(hypotheses.pose[best], true, size, module_px) < 1.5
    assert match[best] > FINDER.clear_match
    near = [k for k in range(len(match)) if modules_off(hypotheses.pose[k], true, size, module_px) < 6.0]
    assert np.delete(match, near).max(initial=-1.0) < match[best] - 0.05
    (candidate,) = screen(hypotheses[best : best + 1], [0], pyramid, ALIGN, workspace=workspace)
    assert candidate.space.version == version
    assert modules_off(candidate.pose, true, size, module_px) < 0.6
    assert candidate.score > 0.75
    assert candidate.iterations > 0


def test_a_rough_pose_among_wrong_ones_is_refined_and_wins(workspace):
    pyramid, _, true = searched(scene(), workspace)
    rough = moved(true, 25, shift=(0.3, -0.4), turn_deg=3.0, scale=1.05)
    wrong = [moved(true, 25, turn_deg=90.0), moved(true, 25, shift=(6.0, 0.0)), moved(true, 25, scale=0.7)]
    guesses = at_poses([2, 2, 2, 2, 3], [*wrong, rough, moved(true, 25, scale=25 / 29)])
    candidates = screen(guesses, [0] * 5, pyramid, ALIGN, workspace=workspace)
    assert [candidate.space.version for candidate in candidates] == [2, 2, 2, 2, 3]
    scores = [candidate.score for candidate in candidates]
    assert scores.index(max(scores)) == 3
    assert modules_off(candidates[3].pose, true, 25, 5.0) < 0.6


def test_scores_do_not_depend_on_what_else_is_scored(workspace):
    pyramid, hypotheses, _ = searched(scene(), workspace)
    window = np.zeros(len(hypotheses), np.intp)
    every = score(pyramid, window, hypotheses.size, hypotheses.pose, ALIGN, workspace=workspace)
    for some in (hypotheses[:1], hypotheses[3:80]):
        start = 0 if len(some) == 1 else 3
        alone = score(pyramid, window[: len(some)], some.size, some.pose, ALIGN, workspace=workspace)
        np.testing.assert_array_equal(alone, every[start : start + len(some)])
