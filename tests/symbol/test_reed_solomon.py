"""The Reed-Solomon codec: the laws of the codes, two other implementations, threads."""

import functools
import itertools
from concurrent.futures import ThreadPoolExecutor

import galois
import numpy as np
import pytest
import reedsolo
from hypothesis import given, settings
from hypothesis import strategies as st

from evqr.symbol.reed_solomon import ReedSolomon, galois_field

# polynomial and first root: QR, Data Matrix, Aztec with 4, 6, 10 and 12 bits (8 are Data Matrix's)
CODES = [(0x11D, 0), (0x12D, 1), (0x13, 1), (0x43, 1), (0x409, 1), (0x1069, 1)]


@st.composite
def words(draw, codes=tuple(CODES), n_check=tuple(range(1, 25))):
    """A code, a valid word and what was received of it, with erasures; often beyond what can be corrected."""
    polynomial, first_root = draw(st.sampled_from(codes))
    order = galois_field(polynomial).order
    code = ReedSolomon(
        polynomial=polynomial, n_check=min(draw(st.sampled_from(n_check)), order - 1), first_root=first_root
    )
    n = draw(st.integers(code.n_check + 1, min(order, 80)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    dtype = np.uint8 if order < 256 else np.uint16
    word = code.encode(rng.integers(0, order + 1, n - code.n_check).astype(dtype))
    n_erased = draw(st.integers(0, code.n_check))
    n_wrong = draw(st.integers(0, (code.n_check - n_erased) // 2 + 2))
    places = rng.permutation(n)[: n_erased + n_wrong]
    received = word.copy()
    received[places[:n_erased]] = rng.integers(0, order + 1, n_erased)
    received[places[n_erased:]] ^= rng.integers(1, order + 1, len(places[n_erased:])).astype(dtype)
    return code, word, received, places[:n_erased].tolist()


def within_reach(code, word, received, erased):
    """Whether a word is valid and 2 errors + erasures <= check symbols."""
    n_errors = len(set(np.flatnonzero(word != received).tolist()).difference(erased))
    return not code.syndromes(word).any() and 2 * n_errors + len(erased) <= code.n_check


@given(words())
@settings(max_examples=200, deadline=None)
def test_what_is_within_reach_is_corrected_and_nothing_else_is_returned(case):
    code, word, received, erased = case
    assert not code.syndromes(word).any()
    given_word = received.copy()
    result = code.correct(received, erased)
    np.testing.assert_array_equal(received, given_word)
    if within_reach(code, word, received, erased):
        np.testing.assert_array_equal(result, word)
    elif result is not None:
        assert result.dtype == word.dtype
        assert within_reach(code, result, received, erased)


@given(words(n_check=range(1, 13)))
@settings(max_examples=60, deadline=None)
def test_reedsolo_agrees(case):
    code, word, received, erased = case
    m = code.polynomial.bit_length() - 1
    other = reedsolo.RSCodec(
        code.n_check, nsize=len(word), fcr=code.first_root, prim=code.polynomial, c_exp=m
    )
    data = word[: -code.n_check].tolist()
    assert list(other.encode(data)) == word.tolist()
    result = code.correct(received, erased)
    try:
        expected = np.array(other.decode(received.tolist(), erase_pos=erased)[1], word.dtype)
    except (reedsolo.ReedSolomonError, ZeroDivisionError):
        assert result is None
    else:  # with erasures it goes one error further, to words that may be others
        assert result is not None or not within_reach(code, expected, received, erased)
        assert result is None or (result == expected).all()


@functools.cache
def galois_code(code):
    order = galois_field(code.polynomial).order
    field = galois.GF(
        order + 1,
        irreducible_poly=galois.Poly.Int(code.polynomial),
        primitive_element=2,
        compile="python-calculate",  # half a minute less than compiling each field
    )
    return galois.ReedSolomon(order, order - code.n_check, field=field, c=code.first_root)


@given(words(codes=CODES[:-1], n_check=[2, 7]))
@settings(max_examples=40, deadline=None)
def test_galois_agrees(case):
    code, word, received, erased = case
    other = galois_code(code)
    np.testing.assert_array_equal(np.asarray(other.encode(word[: -code.n_check].astype(object))), word)
    mask = np.zeros(len(word), bool)
    mask[erased] = True
    corrected = other.decode(other.field(received.astype(object)), erasures=mask, output="codeword")
    expected = np.asarray(corrected).astype(word.dtype)
    result = code.correct(received, erased)
    if within_reach(code, expected, received, erased):
        np.testing.assert_array_equal(result, expected)
    else:  # what it returns when it fails
        assert result is None


@pytest.mark.parametrize("erased", [[], [1], [0, 3], [0, 1, 2]])
def test_every_word_of_a_small_code(erased):
    """All 4096 words of GF(8) with two check symbols, against a search through the 64 valid ones."""
    code = ReedSolomon(polynomial=0xB, n_check=2, first_root=1)
    everything = np.array(list(itertools.product(range(8), repeat=4)), np.uint8)
    valid = np.array([code.encode(np.array(d, np.uint8)) for d in itertools.product(range(8), repeat=2)])
    kept = [i for i in range(4) if i not in erased]
    for received in everything:
        wrong = (valid[:, kept] != received[kept]).sum(1)
        near = valid[2 * wrong + len(erased) <= 2]
        result = code.correct(received, erased)
        if len(near):
            np.testing.assert_array_equal(result, near[0])
        else:
            # a valid word needs no correction, whatever is said to be erased
            assert result is None or (valid == received).all(1).any()


def test_threads_on_two_fields_get_what_one_alone_gets():
    rng = np.random.default_rng(0)
    codes = [ReedSolomon(polynomial=p, n_check=10, first_root=r) for p, r in CODES[:2]]
    tasks = []
    for number in range(400):
        code = codes[number % 2]
        word = code.encode(rng.integers(0, 256, 20).astype(np.uint8))
        received = word.copy()
        received[rng.permutation(30)[:5]] ^= 0x5A
        tasks.append((code, received, word))
    with ThreadPoolExecutor(4) as pool:
        results = list(pool.map(lambda task: task[0].correct(task[1]), tasks))
    assert all((result == word).all() for result, (_, _, word) in zip(results, tasks, strict=True))


def test_syndromes_that_are_known_need_not_be_computed_again():
    code = ReedSolomon(polynomial=0x11D, n_check=4)
    word = code.encode(np.arange(10, dtype=np.uint8))
    received = word.copy()
    received[[2, 7]] ^= 1
    np.testing.assert_array_equal(code.correct(received, [2], syndromes=code.syndromes(received)), word)


def test_more_erasures_than_check_symbols():
    code = ReedSolomon(polynomial=0x11D, n_check=4)
    word = code.encode(np.arange(10, dtype=np.uint8))
    word[0] ^= 1
    assert code.correct(word, [0, 1, 2, 3, 4]) is None


@pytest.mark.parametrize("polynomial", [p for p, _ in CODES])
def test_tables_of_the_fields(polynomial):
    field = galois_field(polynomial)
    assert galois_field(polynomial) is field
    m = polynomial.bit_length() - 1
    other = galois.GF(2**m, irreducible_poly=galois.Poly.Int(polynomial), compile="python-calculate")
    rng = np.random.default_rng(m)
    for a, b in [(0, 0), (0, 3), (5, 0), *rng.integers(0, field.order + 1, (50, 2)).tolist()]:
        assert field.power[field.log[a] + field.log[b]] == field.powers[field.logs[a] + field.logs[b]]
        assert field.power[field.log[a] + field.log[b]] == int(other(a) * other(b))
    with pytest.raises(ValueError, match="read-only"):
        field.power[0] = 0


@pytest.mark.parametrize(
    ("polynomial", "message"),
    [
        (0x11B, "polynomial must be primitive, got 0x11b"),  # irreducible, but 2 has order 51
        (0x100, "polynomial must be primitive, got 0x100"),
        (0x3, "degree of 2 to 16, got 0x3"),
        (1 << 17, "degree of 2 to 16, got 0x20000"),
    ],
)
def test_polynomials_without_a_field(polynomial, message):
    with pytest.raises(ValueError, match=message):
        galois_field(polynomial)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n_check": 0}, "n_check must be 1 to 14, got 0"),
        ({"n_check": 15}, "n_check must be 1 to 14, got 15"),
        ({"n_check": 2, "first_root": 15}, "first_root must be 0 to 14, got 15"),
    ],
)
def test_codes_that_do_not_exist(arguments, message):
    with pytest.raises(ValueError, match=message):
        ReedSolomon(polynomial=0x13, **arguments)


@pytest.mark.parametrize("n", [2, 16])
def test_words_of_a_length_that_the_code_has_not(n):
    code = ReedSolomon(polynomial=0x13, n_check=2)
    with pytest.raises(ValueError, match=f"a word must have 3 to 15 symbols, got {n}"):
        code.correct(np.ones(n, np.uint8))


def test_words_of_larger_codes_are_known():
    """A word is also one of each smaller code; how many further check words it has is said up to three."""
    rng = np.random.default_rng(5)
    for polynomial, first in ((0x11D, 0), (0x43, 1), (0x12D, 1)):
        small = ReedSolomon(polynomial=polynomial, n_check=7, first_root=first)
        for more in (0, 1, 2, 5):
            large = ReedSolomon(polynomial=polynomial, n_check=7 + more, first_root=first)
            word = large.encode(rng.integers(0, 64, 20, dtype=np.uint8))
            assert not small.syndromes(word).any()
            assert small.further_roots(word) >= min(more, 3)
            assert more or small.further_roots(word) < 3
