"""Each metric against a case that can be worked out by hand."""

import numpy as np
import pytest

from evqr.paper.dataset.truth import Truth, edges_of
from evqr.paper.evaluate.metrics import (
    Bin,
    Trial,
    binned,
    bit_accuracy,
    calibration,
    false_read_rate,
    image_read_rate,
    max_accuracy,
    mean_to_read,
    median_to_read,
    mode_accuracy,
    mode_of,
    read_rate,
    score,
    wrong_codewords,
    yield_rate,
)

# the top left module is known; three are not
TRUTH = Truth(
    text="A",
    modules=np.array([[-1, 1], [1, -1]], np.int8),
    known=np.array([[True, False], [False, False]]),
)


def grid(*rows):
    return np.array(rows, np.int8)


def test_bit_accuracy_leaves_the_known_module_out():
    assert bit_accuracy(grid([1, 1], [1, -1]), TRUTH) == 1.0
    assert bit_accuracy(grid([-1, -1], [1, -1]), TRUTH) == pytest.approx(2 / 3)


def test_a_module_that_says_nothing_is_wrong():
    assert bit_accuracy(grid([-1, 0], [1, -1]), TRUTH) == pytest.approx(2 / 3)


def test_mode_is_the_majority_and_light_where_it_is_a_tie():
    grids = [grid([-1, 1], [1, -1]), grid([-1, -1], [1, 1])]
    np.testing.assert_array_equal(mode_of(grids), [[-1, 1], [1, 1]])
    np.testing.assert_array_equal(mode_of([*grids, grids[1]]), [[-1, -1], [1, 1]])


def test_mode_accuracy_takes_trials_that_converged():
    right, wrong = TRUTH.modules, -TRUTH.modules
    trials = [
        Trial(modules=right, converged=True),
        Trial(modules=wrong, converged=False),
        Trial(modules=wrong, converged=False),
        Trial(converged=True),
    ]
    assert mode_accuracy(trials, TRUTH) == 1.0
    assert mode_accuracy([Trial(modules=wrong)], TRUTH) is None


def test_max_accuracy_is_of_the_best_iterate_of_any_trial():
    trials = [Trial(best_accuracy=0.5), Trial(best_accuracy=0.75, converged=True), Trial()]
    assert max_accuracy(trials) == 0.75
    assert max_accuracy([Trial()]) is None


def test_time_and_iterations_to_read_are_means_over_trials_that_read_at_some_iterate():
    trials = [
        Trial(seconds_to_read=1.0, iterations_to_read=3),
        Trial(seconds_to_read=2.0, iterations_to_read=6, converged=True),
        Trial(seconds=9.0),
    ]
    assert mean_to_read(trials) == (1.5, 4.5)
    assert mean_to_read([Trial()]) == (None, None)


def test_median_time_does_not_mind_one_that_was_stopped():
    trials = [Trial(seconds_to_read=seconds) for seconds in (1.0, 2.0, 600.0)]
    assert median_to_read([*trials, Trial(seconds=9.0)]) == 2.0
    assert median_to_read([Trial()]) is None
    assert score(trials, TRUTH).median_seconds_to_read == 2.0


def test_a_codeword_is_wrong_with_one_wrong_bit_as_with_eight():
    truth = Truth(text="", modules=np.ones((4, 6), np.int8), known=np.zeros((4, 6), bool))
    bits = np.arange(23, -1, -1)  # three codewords, the last one first
    modules = truth.modules.copy()
    assert wrong_codewords(modules, truth, bits) == 0
    modules.flat[23] = -1
    assert wrong_codewords(modules, truth, bits) == 1
    modules.flat[8:16] = -1
    modules.flat[22] = 0  # says nothing, in the codeword that is wrong already
    assert wrong_codewords(modules, truth, bits) == 2


def test_read_rate_counts_converged_trials_and_yield_counts_all():
    trials = [
        Trial(text="A", converged=True),
        Trial(text=None, converged=True),
        Trial(text="A", converged=False),
        Trial(),
    ]
    assert read_rate(trials, TRUTH) == 0.5
    assert yield_rate(trials, TRUTH) == 0.5
    assert read_rate(trials[2:], TRUTH) == 0.0
    assert read_rate([], TRUTH) is None


def test_image_read_rate_is_of_methods_with_images():
    trials = [Trial(has_image=True, image_text="A"), Trial(has_image=True), Trial(has_image=True)]
    assert image_read_rate(trials, TRUTH) == pytest.approx(1 / 3)
    assert image_read_rate([Trial(text="A")], TRUTH) is None


def test_false_reads_are_wrong_texts_from_modules_or_image():
    trials = [Trial(text="A"), Trial(text="B"), Trial(text="A", image_text="B"), Trial()]
    assert false_read_rate(trials, TRUTH) == 0.5


def test_edges_of_one_dark_module_are_its_four_sides():
    assert edges_of(grid([1, 1, 1], [1, -1, 1], [1, 1, 1])) == 4
    assert edges_of(grid([-1])) == 4
    assert edges_of(grid([-1, -1])) == 6
    assert edges_of(grid([-1, 1], [1, -1])) == 8


def test_bits_against_events_per_edge():
    bins = binned([1.0, 2.0, 4.0, 8.0, 99.0], [0.5, 0.7, 1.0, 1.0, 0.0], [0.0, 3.0, 5.0, 8.0])
    assert bins == [
        Bin(low=0.0, high=3.0, count=2, key=1.5, value=pytest.approx(0.6)),
        Bin(low=3.0, high=5.0, count=1, key=4.0, value=1.0),
        Bin(low=5.0, high=8.0, count=1, key=8.0, value=1.0),
    ]
    assert binned([], [], [0.0, 1.0]) == []


def test_calibration_error_is_the_mean_distance_of_stated_from_true():
    # two readings that say 0.9, one of them right; two that say 1.0, both right
    bins, error = calibration([0.9, 0.9, 1.0, 1.0], [1, 0, 1, 1], [0.8, 0.95, 1.0])
    assert [(b.count, b.key, b.value) for b in bins] == [(2, pytest.approx(0.9), 0.5), (2, 1.0, 1.0)]
    assert error == pytest.approx(0.5 * 0.4)
    assert calibration([], [], [0.0, 1.0]) == ([], 0.0)


def test_score_takes_them_all():
    trials = [
        Trial(
            modules=TRUTH.modules, converged=True, text="A", best_accuracy=1.0, seconds=0.5, windows=3,
            seconds_to_read=0.25, iterations_to_read=2,
        ),
        Trial(seconds=1.5),
    ]  # fmt: skip
    found = score(trials, TRUTH)
    assert (found.trials, found.found) == (2, 1)
    assert (found.mode_accuracy, found.max_accuracy) == (1.0, 1.0)
    assert (found.seconds_to_read, found.iterations_to_read) == (0.25, 2.0)
    assert (found.read_rate, found.yield_rate, found.image_read_rate) == (1.0, 0.5, None)
    assert (found.false_read_rate, found.seconds, found.windows) == (0.0, 1.0, 3.0)
