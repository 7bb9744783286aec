"""Grades of prints: thresholds, what each fault costs, and a reading's grade beside that of its print."""

import numpy as np
import pytest
from scenes import scene

from evqr.grade import Grade, GradedPart, contrast_of, grade_of
from evqr.offline import read_codes
from evqr.symbol import data_matrix, qr

SPACE = qr.space(2)
FLAT = np.diag([5.0, 5.0, 1.0])


def modules():
    exact = np.random.default_rng(0).choice(np.array([-1, 1], np.int8), SPACE.shape)
    exact[SPACE.known] = SPACE.values[SPACE.known]
    return exact


def grade(q, pose=FLAT, *, contrast=0.9, unused=1.0, check=28, exact=None, space=SPACE):
    exact = modules() if exact is None else exact
    return grade_of(q, exact, space, pose, contrast=contrast, unused=unused, check=check)


def part(of, name):
    return next(each for each in of.parts if each.name == name)


def test_a_flawless_print():
    best = grade(modules().astype(float))
    assert (best.letter, str(best)) == ("A", "A") and {each.letter for each in best.parts} == {"A"}
    assert best.to_dict()["parts"]["contrast"] == {"value": 0.9, "grade": 4, "letter": "A"}


@pytest.mark.parametrize(
    ("given", "name", "letters"),
    [
        ("contrast", "contrast", {0.7: "A", 0.69: "B", 0.4: "C", 0.2: "D", 0.19: "F"}),
        ("unused", "unused correction", {0.62: "A", 0.5: "B", 0.37: "C", 0.25: "D", 0.24: "F"}),
    ],
)
def test_thresholds(given, name, letters):
    for value, letter in letters.items():
        graded = grade(modules().astype(float), **{given: value})
        assert part(graded, name).letter == graded.letter == letter
        assert letter == "A" or name in str(graded)


@pytest.mark.parametrize(
    ("level", "letter"), [(0.55, "A"), (0.45, "B"), (0.35, "C"), (0.25, "D"), (0.1, "F")]
)
def test_modulation_is_of_what_error_correction_does_not_bear(level, letter):
    faint = level * modules()
    assert part(grade(faint), "modulation").letter == letter
    q = modules().astype(float)
    free = np.flatnonzero(~SPACE.known)
    q.ravel()[free[:5]] *= 0.1  # five of 28 check words' 14: 64 % are left
    assert part(grade(q), "modulation").letter == "A"
    q.ravel()[free[:8]] *= 0.1
    assert part(grade(q), "modulation").letter == "C"


@pytest.mark.parametrize("space", [SPACE, data_matrix.space("16x16")])
def test_damage_of_fixed_patterns_counts_by_quarters(space):
    exact = np.where(space.known, space.values, 1).astype(np.int8)
    q = exact.astype(float)
    known = np.argwhere(space.known & (np.indices(space.shape).sum(axis=0) < min(space.shape) // 2))
    q[tuple(known[0])] *= -1.0
    assert part(grade(q, exact=exact, space=space), "fixed pattern damage").letter == "B"
    q[tuple(known.T)] = -exact[tuple(known.T)]
    assert part(grade(q, exact=exact, space=space), "fixed pattern damage").letter == "F"


def test_what_is_not_square_or_not_even():
    q = modules().astype(float)
    stretched = grade(q, np.diag([5.0, 5.5, 1.0]))
    assert part(stretched, "axial non-uniformity").value == pytest.approx(0.5 / 5.25)
    assert (stretched.letter, part(stretched, "grid non-uniformity").letter) == ("C", "A")
    tilted = FLAT.copy()
    tilted[2, 0] = 0.01
    assert part(grade(q, tilted), "grid non-uniformity").value > 0.3
    turned = np.array([[3.0, -4.0, 7.0], [4.0, 3.0, -2.0], [0.0, 0.0, 1.0]])
    assert grade(q, turned).letter == "A"


def test_contrast_follows_events():
    assert contrast_of(0.0) == 0.0 and contrast_of(10.0) == pytest.approx(1.0 - np.exp(-2.0))


def test_the_lowest_part_is_the_grade():
    some = Grade(
        (GradedPart("decode", 1.0, 4), GradedPart("modulation", 0.45, 3), GradedPart("contrast", 0.6, 3))
    )
    assert (some.number, some.letter, str(some)) == (3, "B", "B (modulation 0.45, contrast 0.60)")


def test_a_reading_has_the_grade_of_its_print():
    """Clean is A; the same with little contrast is not, and says why."""
    clean = read_codes(scene(preset="clean").events, threads=1).readings[0].grade
    assert clean.letter == "A", clean
