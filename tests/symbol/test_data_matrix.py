"""Data Matrix: every size, by zxing-cpp's symbols; what is damaged, mirrored, chance, or nothing."""

import numpy as np
import pytest
import zxingcpp

from evqr.config import DecodeConfig
from evqr.reason import Reason
from evqr.symbol import data_matrix
from evqr.symbol.data_matrix import SIZES, layout_of, symbol_of
from evqr.symbol.data_matrix_tables import TABLE, placement
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded, DecodeFailure
from evqr.symbol.payload import CharsetSource, ContentType, StructuredAppend
from evqr.symbology import Symbology

SQUARE = [name for name, (rows, columns) in SIZES.items() if rows == columns]


def make(text, version, **options):
    number = 1 + list(SIZES).index(version)
    barcode = zxingcpp.create_barcode(text, zxingcpp.BarcodeFormat.DataMatrix, version=number, **options)
    image = np.array(barcode.to_image(scale=1, add_quiet_zones=False))
    return np.where(image < 128, -1, 1).astype(np.int8)


def decode(q, version, **options):
    return decode_grid(q, data_matrix.space(version), **options)


def noisy(grid, rng, sigma=0.3):
    return grid * np.abs(rng.normal(1.0, sigma, grid.shape))


def encoded(data, version):
    """The symbol of data codewords, of a size with one block."""
    return symbol_of(layout_of(version).code.encode(np.array(data, np.uint8)), version)


# ---- what is read


def test_there_are_48_sizes():
    assert (len(SQUARE), len(SIZES)) == (24, 24 + 6 + 18)
    assert SIZES["22x22"] == (22, 22) and SIZES["12x26"] == (12, 26) and SIZES["26x64"] == (26, 64)


@pytest.mark.parametrize("version", SIZES)
def test_every_size_with_errors_and_erasures(version):
    """As many codewords as can be corrected are wrong, but for small ones, which need evidence to spare."""
    rng = np.random.default_rng(list(SIZES).index(version))
    grid, space, layout = make("4096", version), data_matrix.space(version), layout_of(version)
    assert grid.shape == space.shape == SIZES[version]
    np.testing.assert_array_equal(grid[space.known], space.values[space.known])
    bits, left = placement(version)
    everything = np.concatenate([np.flatnonzero(space.known), bits.ravel(), left])
    np.testing.assert_array_equal(np.sort(everything), np.arange(grid.size))
    codewords = np.packbits(grid.ravel()[bits] < 0, axis=1).ravel()
    assert len(codewords) == TABLE[version].n_data + TABLE[version].n_check
    assert not any(layout.code.syndromes(codewords[which]).any() for which in layout.order)
    np.testing.assert_array_equal(symbol_of(codewords, version), grid)

    n_wrong = layout.code.n_check // 2 - (grid.size < 200)
    q = noisy(grid, rng, 0.1).ravel()
    for which in layout.order:
        for word in rng.choice(which, n_wrong, replace=False):
            q[rng.choice(bits[word], 1 if grid.size < 200 else 3, replace=False)] *= -0.1
    result = decode(q.reshape(grid.shape), version)
    assert isinstance(result, Decoded), result
    assert (result.text, result.ec_level, result.mask, result.mirrored) == ("4096", None, None, False)
    assert (result.symbology, result.version) == (Symbology.DATA_MATRIX, version)
    assert result.errors_corrected == n_wrong * len(layout.order)
    np.testing.assert_array_equal(result.modules, grid)
    assert result.confidence > 0.999


@pytest.mark.parametrize("version", SQUARE[::4])
def test_mirror_images_take_full_effort(version):
    """The L stays where it is."""
    grid = make("123", version)
    mirrored = grid[::-1, ::-1].T
    known = data_matrix.space(version).known
    np.testing.assert_array_equal(mirrored[known], grid[known])
    assert isinstance(decode(mirrored, version), DecodeFailure)
    result = decode(mirrored, version, effort="full")
    assert isinstance(result, Decoded)
    assert (result.text, result.mirrored) == ("123", True)
    np.testing.assert_array_equal(result.modules, mirrored)


@pytest.mark.parametrize(
    ("text", "identifier", "content", "eci", "source"),
    [
        ("1234567890", "]d1", ContentType.TEXT, (), CharsetSource.GUESSED),
        ("IN PASSING 8 PX A MS", "]d1", ContentType.TEXT, (), CharsetSource.GUESSED),  # C40
        ("in passing, 8 px a ms", "]d1", ContentType.TEXT, (), CharsetSource.GUESSED),  # Text
        ("8 à 10 px dépassés", "]d1", ContentType.TEXT, (), CharsetSource.GUESSED),  # Base 256
        ("点茗", "]d1", ContentType.TEXT, (26,), CharsetSource.ECI),
        ("[)>\x1e06\x1d1T42\x1e\x04", "]d1", ContentType.ISO15434, (), CharsetSource.GUESSED),  # macro 06
    ],
)
def test_what_is_said(text, identifier, content, eci, source):
    payload = decode(make(text, "24x24"), "24x24").payload
    assert payload.text == text and payload.symbology_identifier == identifier
    assert (payload.content_type, payload.eci, payload.charset_source) == (content, eci, source)
    assert payload.structured_append is None


def test_gs1():
    payload = decode(make("(01)09506000134352(10)A1", "20x20", gs1=True), "20x20").payload
    assert (payload.symbology_identifier, payload.content_type) == ("]d2", ContentType.GS1)
    elements = [(element.ai, element.value) for element in payload.gs1]
    assert elements == [("01", "09506000134352"), ("10", "A1")]


def test_parts_of_a_message():
    """ISO/IEC 16022, 5.6: the mark, position and 17 - parts, two numbers of the message, then the content."""
    result = decode(encoded([233, 2 << 4 | 17 - 5, 3, 7, 66], "12x12"), "12x12")
    assert isinstance(result, Decoded) and result.text == "A"
    assert result.payload.structured_append == StructuredAppend(index=2, count=5, parity=3 * 256 + 7)


# ---- what is not


def test_the_smallest_is_believed_where_nearly_all_agrees():
    """64 modules against three codewords: one wrong module is corrected, but two are no evidence any more."""
    grid = make("1234", "10x10").astype(float)
    assert isinstance(decode(grid, "10x10"), Decoded)
    bits, _ = placement("10x10")
    for flipped, read in (([0], True), ([0, 20], False)):
        q = grid.ravel().copy()
        q[bits.ravel()[flipped]] *= -1.0
        result = decode(q.reshape(10, 10), "10x10", effort="full")
        assert isinstance(result, Decoded) is read
        if not read:
            assert result.reason is Reason.POSSIBLY_CHANCE


@pytest.mark.parametrize("version", ["10x10", "12x12", "8x18", "8x32", "12x26"])
def test_nothing_is_read_into_random_grids(version):
    rng = np.random.default_rng(1)
    for number in range(600):
        q = rng.normal(0.0, 1.0, SIZES[version])
        q = np.sign(q) if number % 2 else q
        assert isinstance(decode(q, version, effort="full" if number % 6 == 0 else "quick"), DecodeFailure)


@pytest.mark.parametrize("version", ["10x10", "12x12", "8x18"])
def test_the_number_of_chance_readings_stays_below_its_bound(version):
    """With one chance content in 30 grids allowed, 600 give 20, and no more."""
    rng = np.random.default_rng(9)
    config = DecodeConfig(min_confidence=1.0 - 1.0 / 30.0, wrong_grids=1.0)
    grids = rng.choice([-1.0, 1.0], (600, *SIZES[version]))
    assert sum(isinstance(decode(q, version, config=config), Decoded) for q in grids) <= 30


def test_noise_over_symbols_gives_the_right_text_or_none():
    rng = np.random.default_rng(4)
    read = 0
    for version in list(SIZES)[::3]:
        grid = make("4096", version)
        for _ in range(8):
            result = decode(grid + rng.normal(0.0, rng.uniform(0.3, 0.9), grid.shape), version)
            assert isinstance(result, DecodeFailure) or result.text == "4096"
            read += isinstance(result, Decoded)
    assert 40 < read < 110


@pytest.mark.parametrize("version", ["10x10", "14x14", "32x32", "8x18"])
def test_textures_are_no_symbols(version):
    rows, columns = np.indices(SIZES[version])
    textures = [
        np.ones_like(rows),
        *(np.where(k % n < n // 2, 1, -1) for k in (rows, columns, rows + columns) for n in (2, 4, 6)),
    ]
    for texture in textures:
        for sign in (1.0, -1.0):
            assert isinstance(decode(sign * texture, version, effort="full"), DecodeFailure)


def test_a_region_of_a_symbol_is_no_symbol():
    """A quarter of 32 x 32 has the borders of 16 x 16."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        grid = make("".join(rng.choice(list("abcdef0123"), 30)), "32x32")
        for row in (0, 16):
            for column in (0, 16):
                part = grid[row : row + 16, column : column + 16]
                assert isinstance(decode(part, "16x16", effort="full"), DecodeFailure)
