"""Module grid -> payload: what is read, what is refused, and that nothing is read into chance."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
import segno
import zxingcpp
from hypothesis import given, settings
from hypothesis import strategies as st

from evqr.config import DecodeConfig
from evqr.reason import Reason
from evqr.symbol import data_matrix, micro_qr, qr, rmqr
from evqr.symbol.decode import are_valid
from evqr.symbol.decode import decode_grid as decode_space
from evqr.symbol.decoded import Decoded, DecodeFailure
from evqr.symbol.qr_codewords import codeword_layout, format_words, levels_of, mask_signs, roles_of, symbol_of
from evqr.symbol.qr_tables import LEVELS


def decode_grid(q, **options):
    return decode_space(q, qr.space(qr.version_of(len(q))), **options)


def grid_of(symbol):
    return np.where(np.array(symbol.matrix, dtype=bool), -1, 1).astype(np.int8)


def make(text, version, level, mask=3, **options):
    options = {"boost_error": False, "micro": False} | options
    return grid_of(segno.make(text, version=version, error=level, mask=mask, **options))


def noisy(grid, rng, sigma=0.3):
    """Soft estimates without a wrong sign."""
    return grid * np.abs(rng.normal(1.0, sigma, grid.shape)).astype(np.float32)


def spoil(q, version, level, n_wrong, rng, n_bits=2, strength=1.0):
    """Flip n_bits bits in n_wrong codewords of every block."""
    q = q.astype(np.float64).ravel()
    layout = codeword_layout(version, level)
    for block in layout.blocks:
        n = block.n_data + block.n_check
        bits = layout.bits[block.bits].reshape(n, 8)
        for codeword in rng.choice(n, n_wrong, replace=False):
            q[bits[codeword, rng.choice(8, n_bits, replace=False)]] *= -strength
    side = qr.size_of(version)
    return q.reshape(side, side)


def zxing_reads(grid):
    image = np.where(grid > 0, 255, 0).astype(np.uint8)
    barcode = zxingcpp.read_barcode(image, is_pure=True)
    return barcode is not None and barcode.valid


# ---- what is read


@pytest.mark.parametrize("version", [1, 2, 3, 5, 7, 10, 14, 21, 27, 32, 40])
@pytest.mark.parametrize("level", LEVELS)
def test_clean_symbol_of_any_version_and_level(version, level):
    rng = np.random.default_rng(version)
    grid = make("EVQR 42", version, level, mask=version % 8)
    result = decode_grid(noisy(grid, rng))
    assert isinstance(result, Decoded)
    assert (result.text, result.data, result.symbology) == ("EVQR 42", b"EVQR 42", "QRCode")
    assert (result.version, result.ec_level, result.mask) == (version, level, version % 8)
    assert (result.errors_corrected, result.erasures, result.mirrored) == (0, 0, False)
    assert result.spare == min(b.n_check for b in codeword_layout(version, level).blocks)
    np.testing.assert_array_equal(result.modules, grid)
    assert result.modules.dtype == np.int8
    assert 0.999 < result.confidence <= 1.0
    assert result.log10_chance < -9.0


@pytest.mark.parametrize(
    ("version", "level", "n_wrong"),
    [(1, "M", 3), (1, "Q", 5), (1, "H", 7), (2, "L", 4), (2, "M", 7), (2, "H", 14), (3, "Q", 8), (4, "H", 7)],
)
@pytest.mark.parametrize("effort", ["quick", "full"])
def test_wrong_codewords_are_corrected_and_counted(version, level, n_wrong, effort):
    rng = np.random.default_rng(10 * version + n_wrong)
    grid = make("EVQR-17", version, level)
    q = spoil(noisy(grid, rng, 0.1), version, level, n_wrong, rng)
    result = decode_grid(q, effort=effort)
    assert isinstance(result, Decoded), result.reason
    layout = codeword_layout(version, level)
    assert result.text == "EVQR-17"
    assert (result.errors_corrected, result.erasures) == (n_wrong * len(layout.blocks), 0)
    assert result.spare == layout.blocks[0].n_check - 2 * n_wrong
    np.testing.assert_array_equal(result.modules, grid)


def test_erasures_read_what_plain_correction_cannot():
    """A stain without information over 20 of the 44 codewords of 2-H, which corrects 14."""
    rng = np.random.default_rng(5)
    grid = make("EVQR-0001", 2, "H")
    q = noisy(grid, rng).ravel()
    stained = codeword_layout(2, "H").bits.reshape(44, 8)[rng.choice(44, 20, replace=False)].ravel()
    q[stained] = rng.normal(0.0, 0.05, len(stained))
    q = q.reshape(25, 25)
    assert not zxing_reads(q)
    for effort in ("quick", "full"):
        result = decode_grid(q, effort=effort)
        assert isinstance(result, Decoded)
        assert result.text == "EVQR-0001"
        assert result.erasures >= 12
        assert result.errors_corrected > 14
        assert result.spare >= 0
        np.testing.assert_array_equal(result.modules, grid)


def test_full_effort_reads_more_than_quick_and_quick_more_than_plain():
    rng = np.random.default_rng(8)
    grid = make("EVQR-0001", 2, "H")
    plain, read = 0, {"quick": 0, "full": 0}
    for _ in range(60):
        q = grid + rng.normal(0.0, 0.64, grid.shape)
        plain += zxing_reads(np.where(roles_of(2).data, q, grid))
        for effort in read:
            result = decode_grid(q, effort=effort)
            read[effort] += isinstance(result, Decoded) and result.text == "EVQR-0001"
    assert 1.3 * plain < read["quick"] <= read["full"]


@pytest.mark.parametrize(
    ("content", "options"),
    [
        ("0123456789012345", {}),
        ("HTTPS://EVQR.EXAMPLE/A", {}),
        ("Grüße aus Köln", {}),
        ("Ωμέγα ≠ 終わり", {"encoding": "utf-8"}),
        ("Ωμέγα", {"encoding": "iso-8859-7", "eci": True}),
        ("点字茗荷", {"mode": "kanji"}),
    ],
)
def test_payloads(content, options):
    rng = np.random.default_rng(1)
    q = spoil(noisy(make(content, 4, "M", **options), rng), 4, "M", 3, rng)
    result = decode_grid(q)
    assert isinstance(result, Decoded)
    assert result.text == content


@given(st.binary(min_size=1, max_size=40), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_any_bytes_come_back(content, seed):
    rng = np.random.default_rng(seed)
    symbol = segno.make(content, mode="byte", micro=False)
    result = decode_grid(noisy(grid_of(symbol), rng))
    assert isinstance(result, Decoded)
    assert result.data == content


@given(st.integers(0, 2**32 - 1), st.sampled_from([2.0**-40, 2.0**-3, 8.0, 2.0**60]))
@settings(max_examples=30, deadline=None)
def test_the_estimate_has_no_unit(seed, unit):
    rng = np.random.default_rng(seed)
    grid = make("EVQR-0001", 2, "M")
    q = grid + rng.normal(0.0, 0.5, grid.shape)
    one, other = decode_grid(q), decode_grid(unit * q)
    assert type(one) is type(other)
    if isinstance(one, Decoded) and isinstance(other, Decoded):
        assert one.text == other.text == "EVQR-0001"
        assert one.log10_chance == pytest.approx(other.log10_chance)


@pytest.mark.parametrize("seed", range(8))
def test_format_with_three_flips_a_copy(seed):
    rng = np.random.default_rng(seed)
    level, mask = LEVELS[seed % 4], seed
    grid = make("EVQR", 2, level, mask)
    # The copies by place: the 15 modules around the upper left finder pattern, and the others.
    rows, columns = np.nonzero(roles_of(2).format)
    first = (rows < 9) & (columns < 9)
    assert first.sum() == 15
    q = noisy(grid, rng)
    for copy in (np.flatnonzero(first), np.flatnonzero(~first)):
        flipped = rng.choice(copy, 3, replace=False)
        q[rows[flipped], columns[flipped]] *= -1
    result = decode_grid(q)
    assert isinstance(result, Decoded)
    assert (result.ec_level, result.mask) == (level, mask)
    np.testing.assert_array_equal(result.modules, grid)


def test_second_candidate_of_the_format_is_tried():
    words = format_words(2).signs
    grid = make("EVQR", 2, "M", 5)
    q = grid.astype(float)
    true = grid[roles_of(2).format]
    other = words[np.argsort(-(words @ true), kind="stable")[1]]
    # What the words agree in stays; of the rest, a little more speaks for the wrong one.
    q[roles_of(2).format] = np.where(true == other, true, 0.05 * other)
    result = decode_grid(q)
    assert isinstance(result, Decoded)
    assert (result.text, result.ec_level, result.mask) == ("EVQR", "M", 5)


def test_function_patterns_of_the_estimate_are_not_needed():
    grid = make("EVQR", 7, "Q")
    q = grid.astype(np.float32)
    q[roles_of(7).known] = -5.0
    assert isinstance(decode_grid(q), Decoded)


def test_mirrored_symbols_take_full_effort():
    grid = make("EVQR-0001", 2, "M")
    q = noisy(grid, np.random.default_rng(3)).T
    assert isinstance(decode_grid(q, effort="quick"), DecodeFailure)
    result = decode_grid(q, effort="full")
    assert isinstance(result, Decoded)
    assert result.mirrored
    assert result.text == "EVQR-0001"
    np.testing.assert_array_equal(result.modules, grid.T)


def test_threads_decode_alike():
    rng = np.random.default_rng(0)
    grid = make("EVQR-0001", 2, "H")
    grids = [grid + rng.normal(0.0, 0.55, grid.shape) for _ in range(40)]

    def outcome(q):
        result = decode_grid(q)
        return (result.text, result.errors_corrected) if isinstance(result, Decoded) else result

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(outcome, grids)) == [outcome(q) for q in grids]


# ---- what is refused


def failure(q, **options):
    result = decode_grid(q, **options)
    assert isinstance(result, DecodeFailure), result
    assert "\n" not in str(result)
    return result


def test_unreadable_format_information():
    q = make("EVQR", 2, "M").astype(float)
    q[roles_of(2).format] = 0.0
    result = failure(q)
    assert result.reason is Reason.FORMAT_UNREADABLE
    assert (result.space.version, result.ec_level, result.mask) == (2, None, None)


def test_too_many_errors():
    rng = np.random.default_rng(0)
    q = spoil(np.sign(make("EVQR", 4, "H")), 4, "H", 12, rng, n_bits=4)
    result = failure(q)
    assert str(result) == (
        "error correction failed: too many of 25 codewords wrong for 16 check codewords "
        "(level H, mask 3, block 4 of 4)"
    )
    assert (result.space.version, result.ec_level, result.mask) == (4, "H", 3)


def test_correction_that_may_be_chance():
    """Three wrong codewords of 1-L in disagreement with strong modules: zxing-cpp reads it, we must not."""
    rng = np.random.default_rng(0)
    grid = make("seventeen letters", 1, "L")
    q = spoil(grid, 1, "L", 3, rng, n_bits=3)
    assert zxing_reads(q)
    result = failure(q)
    assert str(result).startswith("possibly chance: 10^-")
    assert "(level L, mask 3, block 1 of 1)" in str(result)


def test_doubtful_modules_may_be_wrong_where_certain_ones_may_not():
    rng = np.random.default_rng(0)
    grid = make("seventeen letters", 1, "L")
    q = spoil(grid.astype(float), 1, "L", 3, rng, n_bits=3, strength=0.05)
    result = decode_grid(q)
    assert isinstance(result, Decoded)
    assert (result.text, result.errors_corrected, result.spare) == ("seventeen letters", 3, 1)


def test_pads_are_evidence():
    """The same damage to a symbol that is mostly pads leaves no doubt."""
    rng = np.random.default_rng(0)
    q = spoil(make("ab", 1, "L"), 1, "L", 3, rng, n_bits=3)
    result = decode_grid(q)
    assert isinstance(result, Decoded)
    assert result.text == "ab"


def test_confidence_is_compared_with_the_floor():
    rng = np.random.default_rng(0)
    q = spoil(make("seventeen letters", 1, "L"), 1, "L", 3, rng, n_bits=2)
    assert isinstance(decode_grid(q), DecodeFailure)
    config = DecodeConfig(min_confidence=0.5, wrong_grids=1.0)
    result = decode_grid(q, config=config)
    assert isinstance(result, Decoded)
    assert result.text == "seventeen letters"
    assert result.confidence == pytest.approx(1.0 / (1.0 + 10.0**result.log10_chance))
    assert isinstance(decode_grid(q, config=DecodeConfig(min_confidence=1 - 1e-9)), DecodeFailure)


@pytest.mark.parametrize("start", [0xF0, 0x00, 0x40])  # no such mode; terminator; no letter
def test_data_that_is_no_payload(start):
    data = bytes([start]) + bytes(15)
    codewords = codeword_layout(2, "H").blocks[0].code.encode(np.frombuffer(data, np.uint8))
    result = failure(symbol_of(codewords, 2, "H", 4))
    assert str(result) == "error correction succeeded, but the data is empty or malformed: level H, mask 4"


# ---- what is not there


def random_grids(version, n, rng):
    """Random signs, every other one with the function patterns and format information of a symbol."""
    roles = roles_of(version)
    for number in range(n):
        q = rng.normal(0.0, 1.0, roles.known.shape)
        if number % 3 == 0:
            q = np.sign(q)
        if number % 2:
            words = format_words(version).signs
            q[roles.known] = roles.values[roles.known]
            q[roles.format] = words[rng.integers(32)]
        yield q


@pytest.mark.parametrize(("version", "n"), [(1, 4000), (2, 2000), (3, 1000), (4, 1000)])
@pytest.mark.parametrize("effort", ["quick", "full"])
def test_nothing_is_read_into_random_grids(version, n, effort):
    n = n if effort == "quick" else n // 50
    rng = np.random.default_rng(version)
    read = [
        r for q in random_grids(version, n, rng) if isinstance(r := decode_grid(q, effort=effort), Decoded)
    ]
    assert read == []


def test_the_number_of_chance_readings_stays_below_its_bound():
    """With one chance content in a thousand grids allowed, 2000 grids may give a few readings, not more."""
    rng = np.random.default_rng(9)
    config = DecodeConfig(min_confidence=0.999, wrong_grids=1.0)
    grids = random_grids(1, 2000, rng)
    assert sum(isinstance(decode_grid(q, config=config), Decoded) for q in grids) <= 9


def test_noise_over_symbols_gives_the_right_text_or_none():
    """The chance hypothesis leaves out that a wrong content may be near the right one: so check it."""
    rng = np.random.default_rng(4)
    cases = [
        ("seventeen letters", 1, "L"),
        ("ab", 1, "M"),
        ("EVQR", 1, "H"),
        ("two blocks", 3, "Q"),
        ("x", 4, "H"),
    ]
    seen = {True: 0, False: 0}
    for text, version, level in cases:
        grid = make(text, version, level)
        for number in range(300):
            q = grid + rng.normal(0.0, rng.uniform(0.3, 0.9), grid.shape)
            if number % 2:  # a part that is not of the symbol
                rows = rng.integers(0, len(grid), 2)
                q[min(rows) : max(rows)] = rng.choice([-1.0, 1.0], (abs(rows[1] - rows[0]), len(grid)))
            result = decode_grid(q)
            assert isinstance(result, DecodeFailure) or result.text == text
            seen[isinstance(result, Decoded)] += 1
    assert min(seen.values()) > 200


@pytest.mark.parametrize("version", [1, 2, 4, 7, 10])
def test_textures_are_no_symbols(version):
    """Stripes, checks and plain areas, those that equal a mask among them, whatever the format says."""
    roles = roles_of(version)
    rows, columns = np.indices(roles.known.shape)
    masks = mask_signs(version).reshape(8, *roles.known.shape)
    textures = [
        *masks,
        np.ones_like(rows),
        *(np.where(k % n < n // 2, 1, -1) for k in (rows, columns) for n in (4, 6)),
    ]
    words = format_words(version).signs
    for texture in textures:
        for word in words[::3]:
            for sign in (1, -1):
                q = sign * texture.astype(float)
                q[roles.format] = word
                failure(q)
        failure(texture.astype(float))


def test_a_grid_without_information():
    failure(np.zeros((25, 25)))
    q = make("EVQR", 2, "M").astype(float)
    q[roles_of(2).data] = 0.0
    for effort in ("quick", "full"):
        failure(q, effort=effort)


# ---- misuse


@pytest.mark.parametrize(
    ("q", "message"),
    [
        (np.zeros((25, 21)), r"q must have shape \(25, 25\) for QRCode 2, got \(25, 21\)"),
        (np.zeros(625), r"q must have shape \(25, 25\) for QRCode 2, got \(625,\)"),
        (np.full((25, 25), np.nan), "q must be finite"),
    ],
)
def test_grids_that_are_none(q, message):
    with pytest.raises(ValueError, match=message):
        decode_space(q, qr.space(2))


def test_unknown_effort():
    with pytest.raises(ValueError, match="effort must be 'quick' or 'full', got 'most'"):
        decode_grid(np.zeros((25, 25)), effort="most")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("min_confidence", 0.0),
        ("min_confidence", 1.0),
        ("wrong_grids", 0.5),
        ("format_candidates", 0),
        ("format_candidates", 33),
        ("quick_tries", 0),
        ("min_check", 0),
    ],
)
def test_config_out_of_range(name, value):
    with pytest.raises(ValueError, match=f"{name} must be .*, got {value}"):
        DecodeConfig(**{name: value})


def test_results_are_frozen():
    result = decode_grid(make("EVQR", 1, "L"))
    assert isinstance(result, Decoded)
    with pytest.raises(FrozenInstanceError):
        result.text = ""  # pyright: ignore[reportAttributeAccessIssue]


def test_readings_are_values():
    grid = make("EVQR", 1, "L")
    result, again = decode_grid(grid), decode_grid(2.0 * grid)
    assert result == again == pickle.loads(pickle.dumps(result))
    assert hash(result) == hash(again)
    assert result != decode_grid(make("EVQR", 1, "M"))
    assert isinstance(result, Decoded)
    with pytest.raises(ValueError, match="read-only"):
        result.modules[0, 0] = 0


def test_numbers_are_plain():
    result = decode_grid(make("EVQR", 1, "L"))
    assert isinstance(result, Decoded)
    assert type(result.log10_chance) is type(result.confidence) is float
    assert type(result.errors_corrected) is type(result.spare) is int


# ---- many at once


def test_grids_without_errors_are_told_all_at_once():
    """Of several sizes and levels, one block and many, some with a wrong codeword in one block only."""
    rng, grids, wrong = np.random.default_rng(5), [], []
    for version, level in ((1, "L"), (5, "Q"), (5, "H"), (14, "M")):
        for k in range(6):
            q = noisy(make(f"{version}{level}{k}", version, level, mask=k), rng)
            if k % 3 == 1:
                block = codeword_layout(version, level).blocks[k % 2 - 1]
                bits = codeword_layout(version, level).bits[block.bits]
                q.ravel()[bits[rng.integers(len(bits))]] *= -1.0
            grids.append(q)
            wrong.append(k % 3 == 1)
    valid = are_valid(grids, [qr.space(qr.version_of(len(q))) for q in grids])
    assert valid == [not one for one in wrong]
    for q, one in zip(grids, valid, strict=True):
        assert (decode_grid(q).errors_corrected == 0) == one
    order = rng.permutation(len(grids))
    mixed = are_valid([grids[k] for k in order], [qr.space(qr.version_of(len(grids[k]))) for k in order])
    assert mixed == [valid[k] for k in order]


def test_what_cannot_be_told_at_once_is_not_said_to_be_without_errors():
    square = data_matrix.space("10x10")
    rng = np.random.default_rng(0)
    assert are_valid([rng.normal(size=(10, 10))], [square]) == [False]
    assert are_valid([np.ones((3, 3))], [qr.space(1)]) == [False]  # `decode_grid` says what is wrong
    assert are_valid([], []) == []


@pytest.mark.parametrize("version", ["M1", "M3", "M4", "R7x43", "R13x77"])
def test_small_and_rectangular_symbols_are_told_too(version):
    space = (micro_qr if version[0] == "M" else rmqr).space(version)
    level = levels_of(version)[0]
    layout = codeword_layout(version, level)
    data = np.random.default_rng(1).integers(0, 256, len(layout.bits) // 8, dtype=np.uint8)
    if layout.printed is not None:
        data &= np.packbits(layout.printed)
    words = np.concatenate([b.code.encode(data[b.codewords][: b.n_data]) for b in layout.blocks])
    right = symbol_of(words, version, level, 0).astype(np.float64)
    one_off = right.copy()
    one_off.ravel()[layout.bits[3]] *= -1.0
    assert are_valid([right, one_off, right], [space] * 3) == [True, False, True]
