"""One block of soft bits, over any field: packing, erasures, what counts as evidence."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evqr.config import DecodeConfig
from evqr.reason import Reason
from evqr.symbol.chance import log_chance
from evqr.symbol.correct import Corrected, Doubt, bits_of, correct_block, words_of
from evqr.symbol.reed_solomon import ReedSolomon

FIELDS = [0x13, 0x43, 0x11D, 0x12D, 0x409, 0x1069]
CODE = ReedSolomon(polynomial=0x43, n_check=12, first_root=1)
N_DATA = 10
LIMIT = math.log(1e-9)


@given(st.sampled_from(FIELDS), st.integers(1, 40), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_words_and_bits_are_the_same_thing(polynomial, n, seed):
    code = ReedSolomon(polynomial=polynomial, n_check=2)
    words = np.random.default_rng(seed).integers(0, code.field.order + 1, n).astype(code.field.power.dtype)
    bits = bits_of(words, code)
    assert bits.dtype == bool and len(bits) == n * code.width
    again = words_of(bits, code)
    assert again.dtype == words.dtype
    np.testing.assert_array_equal(again, words)
    assert [int("".join(str(int(b)) for b in row), 2) for row in bits.reshape(n, -1)] == words.tolist()


def block(rng):
    """A word of a code with symbols of six bits, and its modules."""
    words = CODE.encode(rng.integers(0, 64, N_DATA).astype(np.uint8))
    return words, np.where(bits_of(words, CODE), -1.0, 1.0)


def correct(soft, effort="full", log_limit=LIMIT, **options):
    return correct_block(
        soft,
        CODE,
        lambda words: 6 * N_DATA * math.log(2.0),
        log_limit=log_limit,
        config=DecodeConfig(),
        effort=effort,
        **options,
    )


def test_a_block_of_six_bit_words():
    rng = np.random.default_rng(0)
    words, soft = block(rng)
    result = correct(soft)
    assert isinstance(result, Corrected)
    np.testing.assert_array_equal(result.words, words)
    assert (result.changed, result.erased, result.spare) == (0, 0, 12)
    assert result.log_chance == pytest.approx((6 * N_DATA - 6 * 22) * math.log(2.0))


def test_what_is_right_as_it_came_counts_every_module_that_says_anything_alike():
    rng = np.random.default_rng(4)
    words, soft = block(rng)
    soft *= rng.uniform(0.1, 3.0, soft.size)
    blank = np.flatnonzero(soft > 0.0)[:5]  # what says nothing is taken for light
    soft[blank] = 0.0
    known = {"received": words, "syndromes": CODE.syndromes(words)}
    for more in ({}, known, {**known, "beside": np.array([0.5, 0.0, 2.0])}):
        result = correct(soft, **more)
        assert isinstance(result, Corrected)
        coins = soft.size - 5 + 2 * ("beside" in more)
        assert result.log_chance == pytest.approx((6 * N_DATA - coins) * math.log(2.0))
        np.testing.assert_array_equal(result.words, words)
        agreement = np.abs(np.concatenate([soft, more.get("beside", [])]))
        assert result.log_chance == pytest.approx(log_chance(agreement, 6 * N_DATA * math.log(2.0)))


def test_a_valid_word_that_is_no_better_than_chance_is_not_taken():
    _, soft = block(np.random.default_rng(5))
    result = correct(soft, log_limit=-math.log(2.0) * 6 * 22)
    assert isinstance(result, Doubt) and result.reason is Reason.POSSIBLY_CHANCE


def test_the_least_certain_words_are_erased():
    """Nine words of noise, where six errors are the most; they are the weak ones."""
    rng = np.random.default_rng(1)
    words, soft = block(rng)
    soft = soft.reshape(-1, 6)
    weak = rng.choice(len(words), 9, replace=False)
    soft[weak] = rng.normal(0.0, 0.1, (9, 6))
    result = correct(soft.ravel(), log_limit=math.log(1e-5))
    assert isinstance(result, Corrected)
    np.testing.assert_array_equal(result.words, words)
    assert result.erased >= 6 and result.spare >= 0


def test_modules_beside_a_block_are_evidence_for_and_against_it():
    rng = np.random.default_rng(2)
    _, soft = block(rng)
    alone = correct(soft)
    with_them = correct(soft, beside=np.ones(15))
    assert isinstance(alone, Corrected) and isinstance(with_them, Corrected)
    assert with_them.log_chance == pytest.approx(alone.log_chance - 15 * math.log(2.0))
    against = correct(soft, beside=-np.ones(3))
    assert isinstance(against, Corrected)
    assert against.log_chance > alone.log_chance


def test_bits_that_are_not_printed_are_neither_evidence_nor_doubtful():
    rng = np.random.default_rng(3)
    data = rng.integers(0, 64, N_DATA).astype(np.uint8)
    data[-1] &= 0b110000
    words = CODE.encode(data)
    printed = np.ones((22, 6), bool)
    printed[9, 2:] = False
    soft = np.where(bits_of(words, CODE), -1.0, 1.0) * printed.ravel()
    result = correct(soft, printed=printed.ravel())
    assert isinstance(result, Corrected)
    np.testing.assert_array_equal(result.words, words)
    assert result.log_chance == pytest.approx((6 * N_DATA - (6 * 22 - 4)) * math.log(2.0))
    printed[9, :2] = False  # where they would have to be dark, there is no such symbol
    dark = data.copy()
    dark[-1] = 0b110000
    soft = np.where(bits_of(CODE.encode(dark), CODE), -1.0, 1.0) * printed.ravel()
    assert isinstance(correct(soft, printed=printed.ravel()), Doubt)


def test_why_not():
    rng = np.random.default_rng(4)
    _, soft = block(rng)
    hopeless = correct(rng.normal(0.0, 1.0, len(soft)))
    assert isinstance(hopeless, Doubt)
    assert hopeless.reason is Reason.TOO_MANY_ERRORS
    assert hopeless.detail == "too many of 22 codewords wrong for 12 check codewords"
    doubtful = correct(soft, log_limit=math.log(1e-30))
    assert isinstance(doubtful, Doubt)
    assert doubtful.reason is Reason.POSSIBLY_CHANCE
    assert doubtful.detail == "10^-21.7 contents would agree as well, 10^-30.0 allowed"
