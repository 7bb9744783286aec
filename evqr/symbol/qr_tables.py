"""What segno knows of QR and Micro QR codes (ISO/IEC 18004), so that the standard's tables are not repeated.

A version is 1 to 40 or M1 to M4.  `evqr.symbol.rmqr_tables` tells the same of rMQR codes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evqr.symbol.space import Version

ErrorLevel = Literal["L", "M", "Q", "H"]
LEVELS: tuple[ErrorLevel, ...] = ("L", "M", "Q", "H")

DARK_MODULE = (-8, 8)
"""Row and column of the module beside the lower left finder pattern that is dark in all QR codes."""

_EMPTY = 2
"""segno's mark of a module to fill."""


def levels_of(version: Version) -> tuple[ErrorLevel | None, ...]:
    """Return the error correction levels of a version, the weakest first; M1 has one without a name."""
    from segno import consts

    shapes = consts.ECC[_segno_version(version)]
    levels: tuple[ErrorLevel | None, ...] = (None, *LEVELS)
    return tuple(level for level in levels if _segno_level(level) in shapes)


def function_patterns(version: Version) -> tuple[NDArray[np.int8], NDArray[np.bool_]]:
    """Return the function patterns (r, r), -1 dark, +1 light, 0 elsewhere, and where the format is told."""
    from segno import encoder  # here: it takes 20 ms to import

    # as segno makes a symbol, but for what makes it slow: codewords, masks and which of them is the best
    number = _segno_version(version)
    size = encoder.calc_matrix_size(number)
    matrix = encoder.make_matrix(size, size)
    encoder.add_finder_patterns(matrix, size, size)
    encoder.add_alignment_patterns(matrix, size, size)
    encoder.add_version_info(matrix, number)
    is_data = _array(matrix) == _EMPTY
    _add_format(matrix, version, levels_of(version)[0], 0)  # with it comes the dark module
    only_format = encoder.make_matrix(size, size, reserve_regions=False, add_timing=False)
    _add_format(only_format, version, levels_of(version)[0], 0)
    is_format = _array(only_format) != _EMPTY
    if not isinstance(version, str):
        is_format[DARK_MODULE] = False
    values = np.where(_array(matrix) == 1, -1, 1) * ~(is_format | is_data)
    return values.astype(np.int8), is_format


def format_signs(
    version: Version, level: ErrorLevel | None, mask: int, is_format: NDArray[np.bool_]
) -> NDArray[np.int8]:
    """Return the modules of a word of format information, -1 dark, +1 light, as they lie in the grid."""
    matrix = [bytearray(len(is_format)) for _ in is_format]
    _add_format(matrix, version, level, mask)
    return np.where(_array(matrix)[is_format], -1, 1).astype(np.int8)


def block_shapes(version: Version, level: ErrorLevel | None) -> list[tuple[int, int]]:
    """Return data and check codewords of each block."""
    from segno import consts

    return [
        (ec.num_data, ec.num_total - ec.num_data)
        for ec in consts.ECC[_segno_version(version)][_segno_level(level)]
        for _ in range(ec.num_blocks)
    ]


def masks_of(version: Version, data: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which data modules each mask inverts, (8, r, r) or (4, r, r)."""
    from segno import encoder

    rows, columns = np.indices(data.shape)
    functions = encoder.get_data_mask_functions(is_micro=isinstance(version, str))
    return np.array([inverts(rows, columns) & data for inverts in functions])


def placement(version: Version, data: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the flat module index of each bit, in the order in which codewords are placed."""
    from segno import encoder

    # we let segno fill in the number of the bit instead of the bit
    matrix = np.where(data, _EMPTY, 0).tolist()
    first = _EMPTY + 1
    encoder.add_codewords(matrix, range(first, first + np.count_nonzero(data)), _segno_version(version))
    order = np.argsort(np.array(matrix).ravel())
    return order[-np.count_nonzero(data) :]


def _array(matrix: Sequence[bytearray]) -> NDArray[np.uint8]:
    """Return segno's matrix as an array (r, r)."""
    return np.frombuffer(b"".join(matrix), np.uint8).reshape(len(matrix), -1)


def _add_format(matrix: Sequence[bytearray], version: Version, level: ErrorLevel | None, mask: int) -> None:
    """Write format information, and the dark module of a QR code, into segno's matrix."""
    from segno import encoder

    encoder.add_format_info(matrix, _segno_version(version), _segno_level(level), mask)


def _segno_version(version: Version) -> int:
    from segno import consts

    return consts.MICRO_VERSION_MAPPING[version] if isinstance(version, str) else version


def _segno_level(level: ErrorLevel | None) -> int | None:
    from segno import consts

    return None if level is None else consts.ERROR_MAPPING[level]
