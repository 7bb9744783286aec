"""What is known of a symbol, against segno's own symbols and tables."""

import sys
from subprocess import run

import numpy as np
import pytest
import segno
from segno import consts

from evqr.symbol.space import code_space, size_of, version_of

VERSIONS = range(1, 41)


@pytest.mark.parametrize("version", VERSIONS)
def test_every_module_has_one_role(version):
    space = code_space(version)
    assert space.size == 17 + 4 * version
    roles = np.stack([space.known, space.format, space.data]).astype(int)
    assert roles.shape == (3, space.size, space.size)
    assert (roles.sum(0) == 1).all()
    assert space.format.sum() == 30
    codewords = sum(ec.num_blocks * ec.num_total for ec in consts.ECC[version][consts.ERROR_LEVEL_L])
    assert 0 <= space.data.sum() - 8 * codewords <= 7


@pytest.mark.parametrize("version", [1, 2, 6, 7, 14, 40])
def test_known_values_are_those_of_any_symbol(version):
    space = code_space(version)
    seen = set()
    for level, mask, text in [("L", 1, "1"), ("H", 6, "EVQR")]:
        symbol = segno.make(text, version=version, error=level, mask=mask, boost_error=False, micro=False)
        grid = np.where(np.array(symbol.matrix, dtype=bool), -1, 1)
        np.testing.assert_array_equal(grid[space.known], space.values[space.known])
        seen.add(grid[space.data].tobytes())
    assert not space.values[~space.known].any()
    assert len(seen) == 2  # the data modules did change


def test_format_modules_are_those_that_level_and_mask_set():
    space = code_space(2)

    def grid(level, mask):
        symbol = segno.make("7", version=2, error=level, mask=mask, boost_error=False, micro=False)
        return np.array(symbol.matrix, dtype=bool)

    symbols = np.stack([grid(level, mask) for level in "LMQH" for mask in range(8)])
    changing = (symbols != symbols[0]).any(0)
    assert (changing & space.known).sum() == 0
    assert changing[space.format].all()


def test_finder_patterns_are_where_they_belong():
    values = code_space(1).values
    rows = ["#######", "#     #", "# ### #", "# ### #", "# ### #", "#     #", "#######"]
    finder = np.array([list(row) for row in rows])
    expected = np.where(finder == "#", -1, 1)
    for corner in (values[:7, :7], values[:7, -7:], values[-7:, :7]):
        np.testing.assert_array_equal(corner, expected)
    assert (values[7, :8] == 1).all() and values[13, 8] == -1  # separator, dark module


def test_arrays_are_shared_and_read_only():
    space = code_space(3)
    assert code_space(3) is space
    for name in ("known", "values", "format", "data"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(space, name)[0, 0] = 0


@pytest.mark.parametrize("version", VERSIONS)
def test_size_and_version_are_inverse(version):
    assert version_of(size_of(version)) == version


@pytest.mark.parametrize("size", [0, 17, 20, 22, 23, 24, 178, 181, -3])
def test_sizes_that_no_version_has(size):
    with pytest.raises(ValueError, match=f"got {size}"):
        version_of(size)


@pytest.mark.parametrize("version", [0, 41, -1])
def test_versions_that_do_not_exist(version):
    for function in (size_of, code_space):
        with pytest.raises(ValueError, match=f"version must be 1 to 40, got {version}"):
            function(version)


def test_import_does_not_load_segno():
    code = "import sys, evqr.symbol.space; sys.exit('segno' in sys.modules)"
    assert run([sys.executable, "-c", code], check=False).returncode == 0
