"""rMQR codes: every size, by zxing-cpp's symbols; what is damaged, mirrored, chance, or another symbol."""

import numpy as np
import pytest
import segno
import zxingcpp

from evqr.config import DecodeConfig
from evqr.search.models import models, sizes
from evqr.symbol import rmqr
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded, DecodeFailure
from evqr.symbol.payload import CharsetSource, ContentType
from evqr.symbol.qr_codewords import codeword_layout, format_words, roles_of, symbol_of, unmasked
from evqr.symbol.rmqr_tables import SIZES, count_bits
from evqr.symbol.symbols import SYMBOLS
from evqr.symbology import Symbology

EVERY = [(version, level) for version in SIZES for level in "MH"]


def make(text, version, level="M", **options):
    number = 1 + list(SIZES).index(version)
    kind = zxingcpp.BarcodeFormat.RMQRCode
    barcode = zxingcpp.create_barcode(text, kind, version=number, ec_level=level, **options)
    image = np.array(barcode.to_image(scale=1, add_quiet_zones=False))
    return np.where(image < 128, -1, 1).astype(np.int8)


def decode(q, version, **options):
    return decode_grid(q, rmqr.space(version), **options)


def noisy(grid, rng, sigma=0.3):
    return grid * np.abs(rng.normal(1.0, sigma, grid.shape))


# ---- what is read


def test_there_are_32_sizes():
    assert len(SIZES) == 32
    assert next(iter(SIZES.items())) == ("R7x43", (7, 43))
    assert list(SIZES.items())[-1] == ("R17x139", (17, 139))


@pytest.mark.parametrize(("version", "level"), EVERY)
def test_every_size_and_level_with_errors_and_erasures(version, level):
    """As many codewords as can be corrected are wrong, half of them visibly; then one more is a stain."""
    rng = np.random.default_rng(list(SIZES).index(version))
    grid, space = make("4096", version, level), rmqr.space(version)
    assert grid.shape == space.shape == SIZES[version]
    np.testing.assert_array_equal(grid[space.known], space.values[space.known])
    layout, roles = codeword_layout(version, level), roles_of(version)
    codewords = np.packbits(unmasked(grid.astype(float), version, level, 0) < 0)
    assert not any(syndromes.any() for syndromes in layout.syndromes(codewords))
    np.testing.assert_array_equal(symbol_of(codewords, version, level, 0), grid)
    unused = roles.data.sum() - len(layout.bits)
    assert 0 <= unused < 8 and len(set(layout.bits)) == len(layout.bits)

    q, wrong = noisy(grid, rng, 0.1).ravel(), 0
    for block in layout.blocks:
        words = layout.bits[block.bits].reshape(-1, 8)
        for bits in words[rng.choice(len(words), block.n_check // 2, replace=False)]:
            q[rng.choice(bits, 3, replace=False)] *= -0.1
        wrong += block.n_check // 2
    flipped = rng.choice(format_words(version).at, 4, replace=False)
    q[flipped] *= -0.3
    result = decode(q.reshape(grid.shape), version)
    assert isinstance(result, Decoded), result
    assert (result.text, result.ec_level, result.mask) == ("4096", level, None)
    assert (result.symbology, result.version) == (Symbology.RMQR_CODE, version)
    assert (result.errors_corrected, result.mirrored) == (wrong, False)
    np.testing.assert_array_equal(result.modules, grid)
    assert result.confidence > 0.999


@pytest.mark.parametrize(
    ("text", "options", "identifier", "content", "source"),
    [
        ("1234567890", {}, "]Q1", ContentType.TEXT, CharsetSource.MODE),
        ("EVQR-07", {}, "]Q1", ContentType.TEXT, CharsetSource.MODE),
        ("in passing", {}, "]Q1", ContentType.TEXT, CharsetSource.GUESSED),
        ("点茗", {}, "]Q1", ContentType.TEXT, CharsetSource.MODE),
        ("(01)09506000134352(10)A1", {"gs1": True}, "]Q3", ContentType.GS1, CharsetSource.MODE),
    ],
)
def test_what_is_said_beside_the_characters(text, options, identifier, content, source):
    result = decode(make(text, "R13x59", **options), "R13x59")
    assert isinstance(result, Decoded), result
    payload = result.payload
    assert payload.symbology_identifier == identifier and payload.content_type is content
    assert payload.charset_source is source
    if not options:
        assert result.text == text
    else:
        elements = [(element.ai, element.value) for element in payload.gs1]
        assert elements == [("01", "09506000134352"), ("10", "A1")]


def test_bits_of_character_counts_are_those_of_table_3():
    """Of some sizes, as the standard prints them: numeric, alphanumeric, byte, kanji."""
    table = {"R7x43": (4, 3, 3, 2), "R9x139": (8, 7, 6, 6), "R13x99": (8, 7, 7, 6), "R17x139": (9, 8, 8, 7)}
    assert {version: tuple(count_bits(version).values()) for version in table} == table


def test_timing_is_what_the_sizes_show():
    for size in sizes():
        known = SYMBOLS[size.symbology].space(size.version)
        for line in SYMBOLS[size.symbology].timing(size.version):
            first = (int(line.v), int(line.u))
            along = (0, 1) if line.along_u else (1, 0)
            at = tuple(start + step * np.arange(line.count) for start, step in zip(first, along, strict=True))
            shown = np.where(np.arange(line.count) % 2, 1, -1)
            shown[list(line.dark)] = -1
            assert line.count % 2 == 1
            np.testing.assert_array_equal(known.values[at], shown, err_msg=f"{known} {line}")
    assert np.isfinite(models().points).all()


# ---- what is not


def test_sizes_are_told_apart():
    """The format information says the size: a part of a larger symbol is no smaller one."""
    rng = np.random.default_rng(0)
    for version in ("R13x77", "R17x139"):
        grid = noisy(make("4096", version), rng)
        for other, (rows, columns) in SIZES.items():
            if other != version and rows <= grid.shape[0] and columns <= grid.shape[1]:
                assert isinstance(decode(grid[:rows, :columns], other, effort="full"), DecodeFailure)


@pytest.mark.parametrize("version", ["R7x43", "R11x27", "R13x27", "R9x59"])
def test_nothing_is_read_into_random_grids(version):
    rng = np.random.default_rng(1)
    words = format_words(version)
    for number in range(600):
        q = rng.normal(0.0, 1.0, SIZES[version])
        q = np.sign(q) if number % 2 else q
        if number % 3 == 0:
            q.ravel()[words.at] = words.signs[rng.integers(2)]
        effort = "full" if number % 6 == 0 else "quick"
        assert isinstance(decode(q, version, effort=effort), DecodeFailure)


@pytest.mark.parametrize("version", ["R7x43", "R11x27"])
def test_the_number_of_chance_readings_stays_below_its_bound(version):
    """The weakest check there is: with one chance content in 30 grids allowed, 600 give 20 and no more."""
    rng = np.random.default_rng(9)
    words = format_words(version)
    config = DecodeConfig(min_confidence=1.0 - 1.0 / 30.0, wrong_grids=1.0)
    grids = rng.choice([-1.0, 1.0], (600, *SIZES[version]))
    grids.reshape(600, -1)[:, words.at] = words.signs[0]
    read = sum(isinstance(decode(q, version, config=config, effort="full"), Decoded) for q in grids)
    assert read <= 30


def test_noise_over_symbols_gives_the_right_text_or_none():
    rng = np.random.default_rng(4)
    read = 0
    for version, level in EVERY[::3]:
        grid = make("4096", version, level)
        for _ in range(6):
            result = decode(grid + rng.normal(0.0, rng.uniform(0.3, 1.1), grid.shape), version)
            assert isinstance(result, DecodeFailure) or result.text == "4096"
            read += isinstance(result, Decoded)
    assert 40 < read < 130


def test_nothing_is_read_into_qr_codes():
    """Their finder patterns look alike; what is beside them is no rMQR code."""
    rng = np.random.default_rng(2)
    for _ in range(10):
        text = "".join(rng.choice(list("abcdefghij0123456789"), rng.integers(1, 8)))
        symbol = segno.make(text, version=int(rng.integers(7, 12)), micro=False, mask=int(rng.integers(8)))
        grid = np.where(np.array(symbol.matrix, dtype=bool), -1, 1)
        for turn in range(4):
            for mirrored in (np.rot90(grid, turn), np.rot90(grid, turn).T):
                for version, (rows, columns) in SIZES.items():
                    if columns <= grid.shape[1]:
                        assert isinstance(decode(mirrored[:rows, :columns], version), DecodeFailure)
