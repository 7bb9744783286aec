"""What is known of a symbol, against segno's own symbols and tables."""

import copy
import pickle
import sys
from subprocess import run

import numpy as np
import pytest
import segno
from segno import consts

from evqr.symbol import micro_qr, qr, symbols
from evqr.symbol.qr_codewords import levels_of, roles_of
from evqr.symbol.space import Anchor, CodeSpace, Landmark, Symbology

VERSIONS = [*range(1, 41), *micro_qr.SIZES]
FINDER_PATTERN = np.where(
    np.array(
        [list(row) for row in ("#######", "#     #", "# ### #", "# ### #", "# ### #", "#     #", "#######")]
    )
    == "#",
    -1,
    1,
)


def space_of(version):
    return symbols.space_of(
        Symbology.QR_CODE if isinstance(version, int) else Symbology.MICRO_QR_CODE, version
    )


def size_of(version):
    return 17 + 4 * version if isinstance(version, int) else 9 + 2 * int(version[1])


def symbol_of(version, text="1", level=None, mask=0):
    return segno.make(text, version=version, error=level, mask=mask, boost_error=False)


@pytest.mark.parametrize("version", VERSIONS)
def test_every_module_has_one_role(version):
    space, roles, size = space_of(version), roles_of(version), size_of(version)
    assert (space.rows, space.columns) == (size, size)
    counts = np.stack([roles.known, roles.format, roles.data]).astype(int)
    assert counts.shape == (3, size, size)
    assert (counts.sum(0) == 1).all()
    micro = isinstance(version, str)
    assert roles.format.sum() == (15 if micro else 30)
    key = consts.MICRO_VERSION_MAPPING[version] if micro else version
    bits = 8 * sum(ec.num_blocks * ec.num_total for ec in next(iter(consts.ECC[key].values())))
    assert roles.data.sum() - bits in ((-4, 0) if micro else range(8))


@pytest.mark.parametrize("version", [1, 2, 6, 7, 14, 40, *micro_qr.SIZES])
def test_known_values_are_those_of_any_symbol(version):
    space = space_of(version)
    seen = set()
    levels = levels_of(version)
    for level, mask, text in [(levels[0], 1, "1"), (levels[-1], 3, "77")]:
        grid = np.where(np.array(symbol_of(version, text, level, mask).matrix, dtype=bool), -1, 1)
        np.testing.assert_array_equal(grid[space.known], space.values[space.known])
        seen.add(grid[roles_of(version).data].tobytes())
    assert not space.values[~space.known].any()
    assert len(seen) == 2  # the data modules did change


@pytest.mark.parametrize("version", [2, "M1", "M4"])
def test_format_modules_are_those_that_level_and_mask_set(version):
    roles = roles_of(version)
    masks = range(8 if version == 2 else 4)
    symbols = np.stack(
        [
            np.array(symbol_of(version, "7", level, mask).matrix, dtype=bool)
            for level in levels_of(version)
            for mask in masks
        ]
    )
    changing = (symbols != symbols[0]).any(0)
    assert not changing[roles.known].any()
    # a version of Micro QR codes has its own part of the words, and what they share does not change
    assert changing[roles.format].sum() >= (30 if version == 2 else 8)


@pytest.mark.parametrize("version", VERSIONS)
def test_anchors_are_where_the_finder_patterns_are(version):
    space = space_of(version)
    far = space.columns - 3.5
    expected = {(3.5, 3.5), (far, 3.5), (3.5, far)} if isinstance(version, int) else {(3.5, 3.5)}
    assert {(anchor.u, anchor.v) for anchor in space.anchors} == expected
    for anchor in space.anchors:
        assert anchor.kind is Landmark.FINDER_PATTERN
        row, column = int(anchor.v - 3), int(anchor.u - 3)
        np.testing.assert_array_equal(space.values[row : row + 7, column : column + 7], FINDER_PATTERN)
    assert (space.values[7, :8] == 1).all()  # separator


def test_what_else_is_known():
    assert qr.space(1).values[13, 8] == -1  # the dark module
    micro = micro_qr.space("M2")
    np.testing.assert_array_equal(micro.values[0, 8:], [-1, 1, -1, 1, -1])  # timing
    np.testing.assert_array_equal(micro.values[8:, 0], [-1, 1, -1, 1, -1])
    assert (qr.space(1).quiet_zone, micro.quiet_zone) == (4, 2)


def test_spaces_are_shared_and_read_only():
    space = qr.space(3)
    assert qr.space(3) is space
    for again in (space, pickle.loads(pickle.dumps(space)), copy.deepcopy(space)):
        for array in (again.known, again.values):
            with pytest.raises(ValueError, match="read-only"):
                array[0, 0] = 0


def test_spaces_are_equal_where_kind_and_size_are():
    space = micro_qr.space("M3")
    again = pickle.loads(pickle.dumps(space))
    assert again is not space and again == space and hash(again) == hash(space)
    np.testing.assert_array_equal(again.values, space.values)
    assert len({*map(space_of, VERSIONS), again}) == len(VERSIONS)
    assert str(space) == "MicroQRCode M3"
    assert repr(space) == "CodeSpace(symbology=<Symbology.MICRO_QR_CODE: 'MicroQRCode'>, version='M3')"


def test_spaces_may_be_rectangles():
    values = np.zeros((2, 3), np.int8)
    values[0] = -1
    space = CodeSpace(
        symbology=Symbology.RMQR_CODE,
        version="R2x3",
        known=values != 0,
        values=values,
        anchors=(Anchor(Landmark.FINDER_PATTERN, 1.0, 1.0),),
        quiet_zone=2,
    )
    assert (space.rows, space.columns) == (2, 3)
    for known, message in [
        (np.zeros((3, 2), bool), r"one shape \(V, U\), got \(3, 2\), \(2, 3\)"),
        (np.zeros((2, 3), bool), "values must be -1 or"),
    ]:
        with pytest.raises(ValueError, match=message):
            CodeSpace(
                symbology=Symbology.RMQR_CODE,
                version="R2x3",
                known=known,
                values=values,
                anchors=(),
                quiet_zone=2,
            )


@pytest.mark.parametrize(
    ("name", "symbology"),
    [
        ("QRCode", Symbology.QR_CODE),
        ("qr", Symbology.QR_CODE),
        ("QR Code", Symbology.QR_CODE),
        ("microqr", Symbology.MICRO_QR_CODE),
        ("MICRO_QR_CODE", Symbology.MICRO_QR_CODE),
        ("rMQR", Symbology.RMQR_CODE),
        ("data-matrix", Symbology.DATA_MATRIX),
        ("aztec", Symbology.AZTEC),
    ],
)
def test_names_of_symbologies_in_any_case(name, symbology):
    assert Symbology.parse(name) is symbology
    assert Symbology.parse(symbology.value) is symbology


@pytest.mark.parametrize("name", ["", "code", "QRC", "MaxiCode"])
def test_names_of_no_symbology(name):
    with pytest.raises(ValueError, match=f"QRCode, MicroQRCode, .*, got {name!r}"):
        Symbology.parse(name)


def test_names_are_zxing_cpps():
    import zxingcpp

    for symbology in Symbology:
        formats = zxingcpp.barcode_formats_from_str(symbology.value)
        assert getattr(zxingcpp.BarcodeFormat, symbology.value) in formats


@pytest.mark.parametrize("version", range(1, 41))
def test_size_and_version_are_inverse(version):
    assert qr.version_of(qr.size_of(version)) == version


@pytest.mark.parametrize("size", [0, 17, 20, 22, 23, 24, 178, 181, -3])
def test_sizes_that_no_version_has(size):
    with pytest.raises(ValueError, match=f"got {size}"):
        qr.version_of(size)


@pytest.mark.parametrize("version", [0, 41, -1])
def test_versions_that_do_not_exist(version):
    for function in (qr.size_of, qr.space):
        with pytest.raises(ValueError, match=f"version must be 1 to 40, got {version}"):
            function(version)


@pytest.mark.parametrize("version", ["M0", "M5", "m1"])
def test_micro_versions_that_do_not_exist(version):
    with pytest.raises(ValueError, match=f"version must be one of M1, M2, M3, M4, got {version}"):
        micro_qr.space(version)


def test_symbologies_that_cannot_be_read():
    with pytest.raises(ValueError, match=r"symbology must be one of QRCode, .*, got MaxiCode"):
        symbols.space_of("MaxiCode", "1")


@pytest.mark.parametrize("symbology", symbols.SYMBOLS)
def test_sizes_of_all_versions(symbology):
    symbol = symbols.SYMBOLS[symbology]
    for version in list(symbol.sizes)[:: max(1, len(symbol.sizes) // 4)]:
        space = symbol.space(version)
        assert (space.symbology, space.version) == (symbology, version)
        assert (space.rows, space.columns) == symbol.sizes[version]


def test_import_does_not_load_segno():
    code = "import sys, evqr.symbol.symbols; sys.exit('segno' in sys.modules)"
    assert run([sys.executable, "-c", code], check=False).returncode == 0
