"""Micro QR codes: what is read, by other programs' symbols, and that neither coins nor QR codes are."""

import collections
import math

import numpy as np
import pytest
import segno
import zxingcpp
from hypothesis import given, settings
from hypothesis import strategies as st

from evqr.config import DecodeConfig
from evqr.reason import Reason
from evqr.symbol import micro_qr
from evqr.symbol.chance import confidence
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded, DecodeFailure
from evqr.symbol.qr_codewords import (
    codeword_layout,
    format_words,
    levels_of,
    mask_signs,
    roles_of,
    symbol_of,
    unmasked,
)
from evqr.symbol.space import Symbology

KINDS = [(version, level) for version in micro_qr.SIZES for level in levels_of(version)]


def make(text, version, level, mask=1):
    symbol = segno.make(text, version=version, error=level, mask=mask, boost_error=False)
    return np.where(np.array(symbol.matrix, dtype=bool), -1, 1).astype(np.int8)


def noisy(grid, rng, sigma=0.3):
    return grid * np.abs(rng.normal(1.0, sigma, grid.shape))


def decode(q, version, **options):
    return decode_grid(q, micro_qr.space(version), **options)


def codewords_of(grid, version, level, mask):
    return np.packbits(unmasked(grid.astype(float), version, level, mask) < 0)


# ---- what is read


def test_versions_and_levels():
    assert KINDS == [
        ("M1", None),
        *(("M2", level) for level in "LM"),
        *(("M3", level) for level in "LM"),
        *(("M4", level) for level in "LMQ"),
    ]


@pytest.mark.parametrize(("version", "level"), KINDS)
@pytest.mark.parametrize("mask", range(4))
def test_every_version_level_and_mask(version, level, mask):
    rng = np.random.default_rng(mask)
    grid = make("40961", version, level, mask)
    result = decode(noisy(grid, rng), version)
    assert isinstance(result, Decoded), result
    assert (result.text, result.data) == ("40961", b"40961")
    assert (result.symbology, result.version) == (Symbology.MICRO_QR_CODE, version)
    assert (result.ec_level, result.mask) == (level, mask)
    assert (result.errors_corrected, result.erasures, result.mirrored) == (0, 0, False)
    np.testing.assert_array_equal(result.modules, grid)
    assert result.confidence > 0.999


@pytest.mark.parametrize(("version", "level"), KINDS)
def test_codewords_are_reed_solomon_words_and_make_the_symbol_again(version, level):
    layout = codeword_layout(version, level)
    (block,) = layout.blocks
    for mask in range(4):
        grid = make("7", version, level, mask)
        codewords = codewords_of(grid, version, level, mask)
        assert not block.code.syndromes(codewords).any()
        np.testing.assert_array_equal(symbol_of(codewords, version, level, mask), grid)
    printed = layout.bits[layout.bits >= 0]
    assert sorted(printed) == np.flatnonzero(roles_of(version).data).tolist()
    if version in ("M1", "M3"):
        assert codewords[block.n_data - 1] & 0x0F == 0
        assert np.count_nonzero(~layout.printed) == 4


@pytest.mark.parametrize(("version", "level"), KINDS[1:])
@pytest.mark.parametrize("mask", range(4))
def test_errors_and_erasures(version, level, mask):
    """As many wrong codewords as can be corrected, all doubtful; then one of them a stain of nothing."""
    rng = np.random.default_rng(mask)
    grid = make("40961", version, level, mask)
    layout = codeword_layout(version, level)
    n = len(layout.bits) // 8
    n_wrong = layout.blocks[0].n_check // 2
    q = noisy(grid, rng, 0.1).ravel()
    wrong = layout.bits.reshape(n, 8)[rng.choice(n, n_wrong, replace=False)]
    for bits in wrong:
        flipped = rng.choice(bits[bits >= 0], 2, replace=False)
        q[flipped] *= -0.1
    result = decode(q.reshape(grid.shape), version)
    assert isinstance(result, Decoded), result
    assert (result.text, result.errors_corrected) == ("40961", n_wrong)
    q[wrong[0][wrong[0] >= 0]] = 0.0
    result = decode(q.reshape(grid.shape), version, effort="full")
    assert isinstance(result, Decoded), result
    assert result.text == "40961"
    np.testing.assert_array_equal(result.modules, grid)


def test_format_information_with_three_flips():
    rng = np.random.default_rng(0)
    for version, level in KINDS[1:]:
        grid = make("1234", version, level, 2)
        q = noisy(grid, rng, 0.1).ravel()
        q[rng.choice(format_words(version).at, 3, replace=False)] *= -0.3
        result = decode(q.reshape(grid.shape), version)
        assert isinstance(result, Decoded), result
        assert (result.ec_level, result.mask, result.text) == (level, 2, "1234")


@pytest.mark.parametrize("version", micro_qr.SIZES)
def test_mirrored_symbols_take_full_effort(version):
    grid = make("123", version, levels_of(version)[0])
    assert isinstance(decode(grid.T, version), DecodeFailure)
    result = decode(grid.T, version, effort="full")
    assert isinstance(result, Decoded)
    assert (result.text, result.mirrored) == ("123", True)
    np.testing.assert_array_equal(result.modules, grid.T)


@st.composite
def payloads(draw):
    """A text, and the version of the smallest symbol of zxing-cpp's that holds it."""
    kind = draw(st.sampled_from(["digits", "alphanumeric", "bytes"]))
    if kind == "digits":
        return draw(st.text("0123456789", min_size=1, max_size=20))
    if kind == "alphanumeric":
        return draw(st.text("0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ $%*+-./:", min_size=1, max_size=12))
    return draw(st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), min_size=1, max_size=8))


@given(payloads(), st.sampled_from("LM"), st.integers(0, 2**32 - 1))
@settings(max_examples=150, deadline=None)
def test_zxing_cpps_own_symbols(text, level, seed):
    try:
        barcode = zxingcpp.create_barcode(text, zxingcpp.BarcodeFormat.MicroQRCode, ec_level=level)
    except ValueError:  # too long for the level
        return
    image = np.array(zxingcpp.write_barcode_to_image(barcode, scale=1, add_quiet_zones=False))
    grid = np.where(image < 128, -1, 1)
    version = f"M{(len(grid) - 9) // 2}"
    result = decode(noisy(grid, np.random.default_rng(seed)), version)
    assert isinstance(result, Decoded), result
    assert result.text == text
    np.testing.assert_array_equal(result.modules, grid)
    again = zxingcpp.read_barcode(np.where(result.modules < 0, 0, 255).astype(np.uint8), is_pure=True)
    assert again is not None
    assert (again.text, again.extra["Version"]) == (text, version)


@given(st.text("0123456789", min_size=1, max_size=5), st.integers(0, 3))
@settings(max_examples=60, deadline=None)
def test_all_that_m1_can_say(text, mask):
    result = decode(make(text, "M1", None, mask), "M1")
    assert isinstance(result, Decoded), result
    assert result.text == text


# ---- what is refused


def test_m1_is_believed_where_all_agrees_and_nowhere_else():
    """15 modules of format information and 36 of data are just enough for a single grid: chance.py."""
    grid = make("40961", "M1", None).astype(float)
    result = decode(grid, "M1")
    assert isinstance(result, Decoded)
    assert 0.999 < result.confidence < 0.9999
    of_use = np.flatnonzero(~roles_of("M1").known)
    for module in of_use:
        q = grid.ravel().copy()
        q[module] *= -1.0
        assert isinstance(decode(q.reshape(11, 11), "M1", effort="full"), DecodeFailure)
    q = grid.ravel().copy()
    q[of_use[::10]] = 0.0  # what is not known is no evidence
    assert isinstance(decode(q.reshape(11, 11), "M1", effort="full"), DecodeFailure)


def test_two_windows_that_are_read_apart_prove_what_one_does_not():
    """Their logarithms add, where the noise of one is not that of the other: chance.py."""
    grid = make("40961", "M1", None).astype(float)
    lenient = DecodeConfig(min_confidence=0.9, wrong_grids=1.0)
    total = 0.0
    for module in (20, 100):
        q = grid.ravel().copy()
        q[module] *= -1.0
        q = q.reshape(11, 11)
        assert isinstance(decode(q, "M1", effort="full"), DecodeFailure)
        result = decode(q, "M1", config=lenient)
        assert isinstance(result, Decoded)
        assert result.text == "40961"
        total += result.log10_chance
    assert confidence(total * math.log(10.0), DecodeConfig().wrong_grids) > 0.999


def test_contents_that_no_encoder_writes_are_none_of_m1():
    """Zxing-cpp reads some of them."""
    code = codeword_layout("M1", None).blocks[0].code
    for bits in (
        "001" + "0001" + "000" + "0000000001",  # 1, then something behind the terminator
        "001" + "1100" + "000" + "0000000000",  # a digit 12
        "000" + "00000000000000000",  # nothing
        "110" + "00000000010000000",  # six digits, which do not fit
    ):
        data = np.packbits(np.array(list(bits + "0000"), int))
        grid = symbol_of(code.encode(data), "M1", None, 2)
        result = decode(grid, "M1")
        assert isinstance(result, DecodeFailure)
        assert result.reason is Reason.NO_CONTENT


def test_bits_that_are_not_printed_are_zero():
    """A valid word with something in the missing half of M3's last data codeword is not one of M3's."""
    (block,) = codeword_layout("M3", "L").blocks
    grid = make("1234567", "M3", "L")
    data = codewords_of(grid, "M3", "L", 1)[: block.n_data]
    data[-1] |= 1
    impossible = symbol_of(block.code.encode(data), "M3", "L", 1)
    result = decode(impossible, "M3", effort="full")
    assert isinstance(result, DecodeFailure)


def test_versions_are_told_apart_by_their_format_information():
    """A larger symbol's corner is a smaller one's, finder pattern, timing and all."""
    for version, level in KINDS:
        grid = make("123", version, level)
        for other, (rows, columns) in micro_qr.SIZES.items():
            if rows < len(grid):
                assert isinstance(decode(grid[:rows, :columns], other, effort="full"), DecodeFailure)


@pytest.mark.parametrize(("version", "n"), [("M1", 2400), ("M2", 1200), ("M3", 500), ("M4", 500)])
@pytest.mark.parametrize("effort", ["quick", "full"])
def test_nothing_is_read_into_random_grids(version, n, effort):
    rng = np.random.default_rng(1)
    words = format_words(version)
    for number in range(n if effort == "quick" else n // 20):
        q = rng.normal(0.0, 1.0, micro_qr.SIZES[version])
        if number % 2:
            q = np.sign(q)
        if number % 3 == 0:
            q.ravel()[words.at] = words.signs[rng.integers(len(words.signs))]
        assert isinstance(decode(q, version, effort=effort), DecodeFailure)


@pytest.mark.parametrize("version", ["M1", "M2"])
def test_the_number_of_chance_readings_stays_below_its_bound(version):
    """With one chance content in thirty grids allowed, 3000 grids may give about a hundred, not more."""
    rng = np.random.default_rng(9)
    config = DecodeConfig(min_confidence=1.0 - 1.0 / 30.0, wrong_grids=1.0)
    grids = rng.choice([-1.0, 1.0], (3000, *micro_qr.SIZES[version]))
    assert sum(isinstance(decode(q, version, config=config), Decoded) for q in grids) <= 130


def test_noise_over_symbols_gives_the_right_text_or_none():
    rng = np.random.default_rng(4)
    seen = collections.Counter()
    for version, level in KINDS:
        grid = make("40961", version, level)
        for _ in range(150):
            q = grid + rng.normal(0.0, rng.uniform(0.2, 0.9), grid.shape)
            result = decode(q, version)
            assert isinstance(result, DecodeFailure) or result.text == "40961"
            seen[isinstance(result, Decoded)] += 1
    assert min(seen.values()) > 200


@pytest.mark.parametrize("version", micro_qr.SIZES)
def test_textures_are_no_symbols(version):
    """Stripes, checks and plain areas, those that equal a mask among them, whatever the format says."""
    words = format_words(version)
    shape = micro_qr.SIZES[version]
    rows, columns = np.indices(shape)
    textures = [
        *mask_signs(version).reshape(4, *shape),
        np.ones_like(rows),
        *(np.where(k % n < n // 2, 1, -1) for k in (rows, columns, rows + columns) for n in (2, 4, 6)),
    ]
    for texture in textures:
        for sign in (1.0, -1.0):
            assert isinstance(decode(sign * texture, version), DecodeFailure)
            for word in words.signs:
                q = (sign * texture).ravel()
                q[words.at] = word
                assert isinstance(decode(q.reshape(shape), version), DecodeFailure)


# ---- a QR code's finder pattern taken for a Micro QR code's


def corners_of_a_qr_code(grid, size):
    """What a search could take for Micro QR codes: a size about each finder pattern, in four rotations.

    Around the symbol everything is light; 0 in the grid stays 0.
    """
    for turn in range(4):
        turned = np.pad(np.rot90(grid, turn), 20, constant_values=1)
        far = 20 + len(grid) - 7
        for row in (20, far):
            for column in (20, far):
                if (turned[row, column : column + 7] == -1).all() and turned[row + 3, column + 3] == -1:
                    if (turned[row : row + 7, column] == -1).all():
                        yield turned[row : row + size, column : column + size]


@pytest.mark.parametrize(("version", "throws"), [("M1", 1.5), ("M2", 1.5), ("M3", 2.5), ("M4", 10.0)])
def test_a_qr_codes_format_information_is_none_of_a_micro_qr_codes(version, throws):
    """What format information is worth as evidence against QR codes, exactly.

    Their data modules are coins, their function patterns and format information are what they are.  Over all
    that a search could take for an M1 of one QR code, a valid word is about as likely as in one throw of
    15 coins, 4 in 2^15; the others, where it is a little more, have evidence to spare.
    """
    words = format_words(version)
    total = []
    for qr_version in (1, 2, 7):
        roles, formats = roles_of(qr_version), format_words(qr_version)
        for signs in formats.signs:
            grid = np.where(roles.known, roles.values, 0).ravel().astype(float)
            grid[formats.at] = signs
            total.append(0.0)
            places = list(corners_of_a_qr_code(grid.reshape(roles.known.shape), micro_qr.SIZES[version][0]))
            assert len(places) == 12
            for place in places:
                for oriented in (place, place.T):
                    stands = oriented.ravel()[words.at]
                    fixed = stands != 0
                    matches = (words.signs[:, fixed] == stands[fixed]).all(1).sum()
                    total[-1] += matches * 2.0 ** -np.count_nonzero(~fixed)
    assert np.mean(total) <= throws * len(words.signs) / 2**15


@pytest.mark.parametrize("version", micro_qr.SIZES)
def test_nothing_is_read_into_the_corners_of_qr_codes(version):
    rng = np.random.default_rng(2)
    for _ in range(25):
        text = "".join(rng.choice(list("abcdefghij0123456789"), rng.integers(1, 8)))
        symbol = segno.make(text, version=int(rng.integers(1, 8)), micro=False, mask=int(rng.integers(8)))
        grid = np.where(np.array(symbol.matrix, dtype=bool), -1, 1)
        for place in corners_of_a_qr_code(grid, micro_qr.SIZES[version][0]):
            assert isinstance(decode(place, version, effort="full"), DecodeFailure)
