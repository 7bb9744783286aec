"""The bound on chance readings, against exact tails and simulated coins."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evqr.symbol.chance import confidence, count_pads, log_chance, log_padded_contents, log_tail


def log_chance_contents(agreement, n_data, n_pads):
    return log_chance(agreement, log_padded_contents(n_data, n_pads))


def exact_log_tail(n, n_wrong):
    return math.log(sum(math.comb(n, i) for i in range(n_wrong + 1))) - n * math.log(2.0)


@pytest.mark.parametrize(("n", "n_wrong"), [(208, 0), (208, 1), (208, 4), (352, 30), (352, 100), (800, 200)])
def test_tail_of_equal_weights_bounds_the_binomial_tail_closely(n, n_wrong):
    agreement = np.full(n, 0.7)
    agreement[:n_wrong] *= -1
    exact = exact_log_tail(n, n_wrong)
    assert exact - 1e-9 <= log_tail(agreement) <= exact + 3.5


@given(st.lists(st.integers(0, 64), min_size=1, max_size=10), st.integers(0, 2**10 - 1))
@settings(max_examples=150, deadline=None)
def test_tail_bounds_the_exact_tail_of_any_weights(sixteenths, signs):
    weights = np.array(sixteenths) / 16.0  # sums are exact
    agreement = weights * [(-1) ** (signs >> i & 1) for i in range(len(weights))]
    sums = np.array(list(itertools.product([-1, 1], repeat=len(weights)))) @ weights
    exact = np.mean(sums >= agreement.sum())
    assert log_tail(agreement) >= math.log(exact) - 1e-9


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 100.0))
@settings(max_examples=50, deadline=None)
def test_tail_has_no_unit_and_grows_with_disagreement(seed, unit):
    rng = np.random.default_rng(seed)
    agreement = rng.normal(0.6, 0.5, 208)
    assert log_tail(unit * agreement) == pytest.approx(log_tail(agreement), abs=1e-6)
    worse = np.where(np.arange(208) < 10, -np.abs(agreement), agreement)
    assert log_tail(worse) >= log_tail(agreement) - 1e-6


def test_modules_without_information_prove_nothing():
    assert log_tail(np.zeros(100)) == 0.0
    assert log_tail(np.r_[np.ones(50), np.zeros(50)]) == pytest.approx(-50 * math.log(2.0))
    assert log_tail(-np.ones(10)) == 0.0


def test_contents_that_are_pads_are_fewer():
    agreement = np.ones(208)
    full = log_chance_contents(agreement, n_data=19, n_pads=0)
    assert full == pytest.approx((19 * 8 - 208 + 1) * math.log(2.0))
    padded = log_chance_contents(agreement, n_data=19, n_pads=10)
    assert padded == pytest.approx(full - 80 * math.log(2.0) + math.log(38))
    assert log_chance_contents(agreement, n_data=19, n_pads=1) <= full


def test_two_bits_wrong_of_version_1_l_are_the_last_beyond_one_in_a_billion():
    """The smallest symbol, 19 data and 7 check codewords, with all modules alike and no pads."""
    chance = []
    for n_wrong in range(5):
        agreement = np.ones(208)
        agreement[:n_wrong] = -1
        chance.append(log_chance_contents(agreement, n_data=19, n_pads=0) / math.log(10.0))
    assert chance == sorted(chance)
    assert chance[2] < -10.5 < -9.0 < chance[4]


@pytest.mark.parametrize(
    ("data", "n_pads"),
    [
        ([1, 2, 3], 0),
        ([1, 2, 0xEC], 1),
        ([1, 2, 0x11], 1),
        ([1, 0xEC, 0x11], 2),
        ([1, 0xEC, 0xEC], 1),
        ([0x11, 0xEC, 0x11, 0xEC], 4),
        ([0xEC, 0x11, 7, 0xEC, 0x11, 0xEC], 3),
    ],
)
def test_pads_are_counted_from_the_end(data, n_pads):
    assert count_pads(np.array(data, np.uint8)) == n_pads


def test_confidence_weighs_chance_against_the_prior():
    assert confidence(-math.inf, 1e6) == 1.0
    assert confidence(math.log(1e-6), 1e6) == pytest.approx(0.5)
    assert confidence(math.log(1e-9), 1e6) == pytest.approx(0.999, abs=1e-5)


def test_m1_has_just_the_evidence_that_is_asked_for():
    """51 modules, 4 words, 2 orientations, 111,110 contents: chance.py, "What may be tried in a grid"."""
    contents = math.log(2 * 4 * 111_110)
    agreement = np.ones(51)
    assert confidence(log_chance(agreement, contents), 1e6) > 0.999
    agreement[0] = -1.0
    assert confidence(log_chance(agreement, contents), 1e6) < 0.999
