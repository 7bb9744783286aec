"""Aztec: every size, by zxing-cpp's symbols; what is damaged, mirrored, chance, or nothing."""

import numpy as np
import pytest
import zxingcpp

from evqr.config import DecodeConfig
from evqr.symbol import aztec
from evqr.symbol.aztec import SIZES, code_of, modes_of, symbol_of
from evqr.symbol.aztec_tables import TABLE, placement
from evqr.symbol.correct import words_of
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded, DecodeFailure
from evqr.symbol.payload import CharsetSource, ContentType
from evqr.symbology import Symbology


def make(text, version, **options):
    number = 1 + list(SIZES).index(version)
    barcode = zxingcpp.create_barcode(text, zxingcpp.BarcodeFormat.Aztec, version=number, **options)
    image = np.array(barcode.to_image(scale=1, add_quiet_zones=False))
    return np.where(image < 128, -1, 1).astype(np.int8)


def decode(q, version, **options):
    return decode_grid(q, aztec.space(version), **options)


def noisy(grid, rng, sigma=0.3):
    return grid * np.abs(rng.normal(1.0, sigma, grid.shape))


def long_text(version):
    """Half of what a version holds: so that there are not check codewords only."""
    return "0123456789" * (TABLE[version].n_bits // 2 // 40) or "01"


# ---- what is read


def test_there_are_36_sizes():
    assert len(SIZES) == 4 + 32
    assert (SIZES["C1"], SIZES["C2"], SIZES["F1"]) == ((15, 15), (19, 19), (19, 19))
    assert (SIZES["F4"], SIZES["F32"]) == ((31, 31), (151, 151))


@pytest.mark.parametrize("version", SIZES)
def test_every_size_with_errors(version):
    """A fifth of the check codewords' number, and a tenth of the mode message, are wrong."""
    rng = np.random.default_rng(list(SIZES).index(version))
    text, space, size = long_text(version), aztec.space(version), TABLE[version]
    grid, modes, at = make(text, version), modes_of(version), placement(version)
    assert grid.shape == space.shape == SIZES[version]
    np.testing.assert_array_equal(grid[space.known], space.values[space.known])
    everything = np.concatenate([np.flatnonzero(space.known), modes.at, at])
    np.testing.assert_array_equal(np.sort(everything), np.arange(grid.size))
    (word,) = np.flatnonzero((modes.signs == grid.ravel()[modes.at]).all(axis=1))
    code = code_of(version, word + 1)
    codewords = words_of(grid.ravel()[at[size.n_bits % size.width :]] < 0, code)
    assert len(codewords) == size.n_codewords and not code.syndromes(codewords).any()
    np.testing.assert_array_equal(symbol_of(codewords, version, word + 1), grid)

    n_wrong = min(code.n_check // 5, 40)
    q = noisy(grid, rng, 0.1).ravel()
    of_words = at[size.n_bits % size.width :].reshape(-1, size.width)
    for which in rng.choice(len(of_words), n_wrong, replace=False):
        q[rng.choice(of_words[which], 2, replace=False)] *= -0.2
    q[rng.choice(modes.at, len(modes.at) // 10, replace=False)] *= -0.3
    result = decode(q.reshape(grid.shape), version)
    assert isinstance(result, Decoded), result
    assert (result.text, result.ec_level, result.mask, result.mirrored) == (text, None, None, False)
    assert (result.symbology, result.version) == (Symbology.AZTEC, version)
    assert (result.errors_corrected, result.erasures) == (n_wrong, 0)
    np.testing.assert_array_equal(result.modules, grid)
    assert result.confidence > 0.999


@pytest.mark.parametrize("version", ["C1", "C4", "F1", "F5"])
def test_a_stain_is_erased(version):
    """More codewords than could be corrected are unknown, not wrong."""
    rng = np.random.default_rng(5)
    grid, size = make(long_text(version), version), TABLE[version]
    of_words = placement(version)[size.n_bits % size.width :].reshape(-1, size.width)
    modes = modes_of(version)
    (word,) = np.flatnonzero((modes.signs == grid.ravel()[modes.at]).all(axis=1))
    n_check = size.n_codewords - word - 1
    n_stained = n_check // 2 + 2 if n_check > 12 else n_check // 2
    q = noisy(grid, rng, 0.1).ravel()
    q[of_words[-n_stained:]] *= rng.choice([-1e-3, 1e-3], (n_stained, size.width))
    result = decode(q.reshape(grid.shape), version, effort="full")
    assert isinstance(result, Decoded), result
    np.testing.assert_array_equal(result.modules, grid)


@pytest.mark.parametrize("version", ["C1", "C3", "F2", "F12"])
def test_mirror_images_take_full_effort(version):
    grid = make("123", version)
    assert isinstance(decode(grid.T, version), DecodeFailure)
    result = decode(grid.T, version, effort="full")
    assert isinstance(result, Decoded)
    assert (result.text, result.mirrored) == ("123", True)
    np.testing.assert_array_equal(result.modules, grid.T)


@pytest.mark.parametrize(
    ("text", "options", "identifier", "content", "eci", "source"),
    [
        ("1234567890", {}, "]z0", ContentType.TEXT, (), CharsetSource.GUESSED),
        ("In passing, 8 PX/ms", {}, "]z0", ContentType.TEXT, (), CharsetSource.GUESSED),
        ("dépassé", {}, "]z0", ContentType.TEXT, (), CharsetSource.GUESSED),
        ("点茗", {}, "]z0", ContentType.TEXT, (26,), CharsetSource.ECI),
        ("(01)09506000134352(10)A1", {"gs1": True}, "]z1", ContentType.GS1, (), CharsetSource.GUESSED),
    ],
)
def test_what_is_said(text, options, identifier, content, eci, source):
    payload = decode(make(text, "C4", **options), "C4").payload
    assert payload.symbology_identifier == identifier
    assert (payload.content_type, payload.eci, payload.charset_source) == (content, eci, source)
    if options:
        assert [(each.ai, each.value) for each in payload.gs1] == [("01", "09506000134352"), ("10", "A1")]
    else:
        assert payload.text == text


# ---- what is not


@pytest.mark.parametrize("version", ["C1", "C2", "F1"])
def test_nothing_is_read_into_random_grids(version):
    rng = np.random.default_rng(1)
    modes = modes_of(version)
    for number in range(400):
        q = rng.normal(0.0, 1.0, SIZES[version])
        q = np.sign(q) if number % 2 else q
        if number % 3 == 0:
            q.ravel()[modes.at] = modes.signs[rng.integers(len(modes.signs))]
        assert isinstance(decode(q, version, effort="full" if number % 6 == 0 else "quick"), DecodeFailure)


@pytest.mark.parametrize("version", ["C1", "F1"])
def test_the_number_of_chance_readings_stays_below_its_bound(version):
    """With one chance content in 30 grids allowed, 600 give 20, and no more, whatever the mode message."""
    rng = np.random.default_rng(9)
    modes = modes_of(version)
    config = DecodeConfig(min_confidence=1.0 - 1.0 / 30.0, wrong_grids=1.0)
    grids = rng.choice([-1.0, 1.0], (600, *SIZES[version]))
    assert sum(isinstance(decode(q, version, config=config), Decoded) for q in grids) <= 20
    grids.reshape(600, -1)[:, modes.at] = modes.signs[-1]  # hardly any check: 600 lucky mode messages
    assert sum(isinstance(decode(q, version), Decoded) for q in grids) == 0


def test_noise_over_symbols_gives_the_right_text_or_none():
    rng = np.random.default_rng(4)
    read = 0
    for version in list(SIZES)[:12]:
        text = long_text(version)
        grid = make(text, version)
        for _ in range(8):
            result = decode(grid + rng.normal(0.0, rng.uniform(0.3, 1.0), grid.shape), version)
            assert isinstance(result, DecodeFailure) or result.text == text
            read += isinstance(result, Decoded)
    assert 30 < read < 90


@pytest.mark.parametrize("version", ["C1", "C3", "F2"])
def test_textures_are_no_symbols(version):
    rows, columns = np.indices(SIZES[version])
    textures = [
        np.ones_like(rows),
        *(np.where(k % n < n // 2, 1, -1) for k in (rows, columns, rows + columns) for n in (2, 4, 6)),
    ]
    for texture in textures:
        for sign in (1.0, -1.0):
            assert isinstance(decode(sign * texture, version, effort="full"), DecodeFailure)


def test_compact_and_full_range_are_told_apart():
    """They have sizes in common."""
    for one, other in (("C2", "F1"), ("C3", "F2"), ("C4", "F3")):
        assert SIZES[one] == SIZES[other]
        assert isinstance(decode(make("4096", one), other, effort="full"), DecodeFailure)
        assert isinstance(decode(make("4096", other), one, effort="full"), DecodeFailure)


@pytest.mark.parametrize("version", ["C2", "F2", "F5"])
def test_check_words_are_not_read_as_data(version):
    """A mode message that says more data than there is leaves a valid word, of a smaller code: not a text."""
    grid = make("1234", version)
    true = modes_of(version)
    right = int((grid.ravel()[true.at] * true.signs).sum(axis=1).argmax())
    for wrong in (right + 2, right + 5):
        q = grid.astype(float)
        q.ravel()[true.at] = true.signs[wrong]
        q.ravel()[true.at[[1, 11, 21]]] *= -0.5  # misread, it has modules of its own that are wrong
        result = decode_grid(q, aztec.space(version), effort="full")
        assert isinstance(result, DecodeFailure) or result.text == "1234"
