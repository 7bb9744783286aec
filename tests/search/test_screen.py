"""Screening of hypotheses: the right one comes first."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import at, corners, middle_us, motion_at, moved, scene, window_of

from evqr.config import AlignConfig, FinderConfig
from evqr.search.finder import find_hypotheses
from evqr.search.hypothesis import Hypothesis, Layout
from evqr.search.screen import batches, screen
from evqr.symbol import qr

CONFIG = AlignConfig()


def searched(made, workspace):
    """The pyramid of a search along the true motion, what it found, and the true pose."""
    truth = made.truth["truth"]
    motion = motion_at(truth, middle_us(made))
    found = find_hypotheses(window_of(made), motion, FinderConfig(), workspace=workspace)
    return found.pyramid, found.hypotheses(Layout.THREE_CORNERS), at(truth, "H", middle_us(made))


def modules_off(candidate, pose, size, module_px):
    return np.abs(corners(candidate.pose, size) - corners(pose, size)).max() / module_px


@pytest.mark.parametrize(
    ("version", "module_px", "preset"),
    [(1, 6.0, "clean"), (2, 5.0, "clean"), (2, 5.0, "fast"), (4, 4.0, "clean"), (7, 4.0, "clean")],
)
def test_the_right_hypothesis_of_a_search_comes_first(version, module_px, preset, workspace):
    made = scene(version=version, module_px=module_px, angle=30.0, width=320, height=320, preset=preset)
    pyramid, hypotheses, pose = searched(made, workspace)
    candidates, iterations = screen(hypotheses, pyramid, CONFIG, workspace=workspace)
    size = 17 + 4 * version
    assert candidates[0].space.version == version
    assert modules_off(candidates[0], pose, size, module_px) < 0.6
    assert iterations > 0


def test_an_inverted_code_is_screened_alike(workspace):
    made = scene(invert=True)
    pyramid, hypotheses, pose = searched(made, workspace)
    candidates, _ = screen(hypotheses, pyramid, CONFIG, workspace=workspace)
    assert candidates[0].space.version == 2
    assert modules_off(candidates[0], pose, 25, 5.0) < 0.6


def test_without_a_clear_one_every_hypothesis_is_a_candidate_and_the_best_come_first(workspace):
    pyramid, hypotheses, _ = searched(scene(), workspace)
    never = replace(CONFIG, clear_score=2.0)
    candidates, _ = screen(hypotheses, pyramid, never, workspace=workspace)
    assert len(candidates) == len(hypotheses)
    assert (np.diff([c.score for c in candidates]) <= 0).all()
    assert sorted(c.space.version for c in candidates) == sorted(h.space.version for h in hypotheses)


def test_a_clear_triple_ends_the_screening_with_all_its_versions(workspace):
    pyramid, _, pose = searched(scene(), workspace)
    right = Hypothesis(qr.space(2), moved(pose, 25, shift=(0.3, 0.2)), 2.0, False, 0)
    neighbour = Hypothesis(qr.space(3), moved(pose, 25, scale=25 / 29), 2.0, False, 0)
    wrong = Hypothesis(qr.space(2), moved(pose, 25, turn_deg=90.0), 1.0, False, 1)
    candidates, _ = screen([neighbour, right, wrong], pyramid, CONFIG, workspace=workspace)
    assert [c.space.version for c in candidates] == [2, 3]
    assert candidates[0].score >= CONFIG.clear_score > candidates[1].score
    every, _ = screen([wrong, right, neighbour], pyramid, CONFIG, workspace=workspace)
    assert [c.space.version for c in every if c.score >= CONFIG.clear_score] == [2]
    assert len(every) == 3


@pytest.mark.parametrize(
    ("triples", "lengths"),
    [
        ("", []),
        ("00", [2]),
        ("00112", [4, 1]),
        ("000000122", [6, 3]),
        ("01222223", [7, 1]),
        ("012345", [4, 2]),
    ],
)
def test_hypotheses_are_split_between_triples_only(triples, lengths):
    hypotheses = [Hypothesis(qr.space(2), np.eye(3), 1.0, False, int(triple)) for triple in triples]
    found = batches(hypotheses, 4)
    assert [len(batch) for batch in found] == lengths
    assert [guess for batch in found for guess in batch] == hypotheses


def test_a_rough_pose_among_wrong_ones_is_refined_and_wins(workspace):
    pyramid, _, pose = searched(scene(), workspace)
    rough = moved(pose, 25, shift=(0.3, -0.4), turn_deg=3.0, scale=1.05)
    wrong = [moved(pose, 25, turn_deg=90.0), moved(pose, 25, shift=(6.0, 0.0)), moved(pose, 25, scale=0.7)]
    hypotheses = [Hypothesis(qr.space(2), p, 1.0, False) for p in (*wrong, rough)]
    hypotheses.append(Hypothesis(qr.space(3), moved(pose, 25, scale=25 / 29), 1.0, False))
    candidates, _ = screen(hypotheses, pyramid, CONFIG, workspace=workspace)
    assert candidates[0].space.version == 2
    assert modules_off(candidates[0], pose, 25, 5.0) < 0.6


def test_nothing_to_screen(workspace):
    pyramid, _, _ = searched(scene(), workspace)
    assert screen([], pyramid, CONFIG, workspace=workspace) == ([], 0)
