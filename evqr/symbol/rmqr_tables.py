"""The tables of rMQR codes: sizes, function patterns, format words, blocks and placement.

Numbers are those of ISO/IEC 23941:2022, tables 1, 3, 6 and 8, as public implementations repeat them; all
sizes are tested against zxing-cpp's symbols.  `evqr.symbol.qr_tables` tells the same of other codes.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from evqr.symbol.qr_tables import ErrorLevel
from evqr.symbol.space import Version

_WIDTHS: Mapping[int, tuple[int, ...]] = MappingProxyType(
    {
        7: (43, 59, 77, 99, 139),
        9: (43, 59, 77, 99, 139),
        11: (27, 43, 59, 77, 99, 139),
        13: (27, 43, 59, 77, 99, 139),
        15: (43, 59, 77, 99, 139),
        17: (43, 59, 77, 99, 139),
    }
)
SIZES: Mapping[str, tuple[int, int]] = MappingProxyType(
    {f"R{rows}x{columns}": (rows, columns) for rows, widths in _WIDTHS.items() for columns in widths}
)
"""Rows and columns; the number of a size in format information is its place here."""

ALIGNMENT_COLUMNS: Mapping[int, tuple[int, ...]] = MappingProxyType(
    {27: (), 43: (21,), 59: (19, 39), 77: (25, 51), 99: (23, 49, 75), 139: (27, 55, 83, 111)}
)
"""Columns of the inner timing patterns, which end in alignment patterns, by columns of the symbol."""

FORMAT_GENERATOR = 0x1F25
"""Of the (18, 6) code of format information."""

FORMAT_MASKS = (0x1FAB2, 0x20A7B)
"""Of format information beside the finder pattern, and beside the finder sub pattern."""

_LEVELS: tuple[ErrorLevel, ...] = ("M", "H")
_CODEWORDS = (
    13, 21, 32, 44, 68,  21, 33, 49, 66, 99,  15, 31, 47, 67, 89, 132,
    21, 41, 60, 85, 113, 166,  51, 74, 103, 136, 199,  61, 88, 122, 160, 232,
)  # fmt: skip
_DATA: Mapping[ErrorLevel, tuple[int, ...]] = MappingProxyType(
    {
        "M": (
            6, 12, 20, 28, 44,  12, 21, 31, 42, 63,  7, 19, 31, 43, 57, 84,
            12, 27, 38, 53, 73, 106,  33, 48, 67, 88, 127,  39, 56, 78, 100, 152,
        ),
        "H": (
            3, 7, 10, 14, 24,  7, 11, 17, 22, 33,  5, 11, 15, 23, 29, 42,
            7, 13, 20, 29, 35, 54,  15, 26, 31, 48, 69,  21, 28, 38, 56, 76,
        ),
    }
)  # fmt: skip
_BLOCKS: Mapping[ErrorLevel, tuple[int, ...]] = MappingProxyType(
    {
        "M": (
            1, 1, 1, 1, 1,  1, 1, 1, 1, 2,  1, 1, 1, 1, 2, 2,  1, 1, 1, 2, 2, 3,  1, 1, 2, 2, 3,
            1, 2, 2, 3, 4,
        ),
        "H": (
            1, 1, 1, 1, 2,  1, 1, 2, 2, 3,  1, 1, 2, 2, 2, 3,  1, 1, 2, 2, 3, 4,  2, 2, 3, 4, 5,
            2, 2, 3, 4, 6,
        ),
    }
)  # fmt: skip


def levels_of(version: Version) -> tuple[ErrorLevel | None, ...]:
    """Return the error correction levels, the weaker first."""
    return _LEVELS


def function_patterns(version: Version) -> tuple[NDArray[np.int8], NDArray[np.bool_]]:
    """Return the function patterns (V, U), -1 dark, +1 light, 0 elsewhere, and where the format is told."""
    rows, columns = SIZES[str(version)]
    values = np.zeros((rows, columns), np.int8)
    turn = np.where(np.arange(columns) % 2, 1, -1)
    values[0], values[-1] = turn, turn  # timing along all edges: dark where the number is even
    values[:, 0], values[:, -1] = turn[:rows], turn[:rows]
    for column in ALIGNMENT_COLUMNS[columns]:
        values[:, column] = turn[:rows]
        for top in (0, rows - 3):
            values[top : top + 3, column - 1 : column + 2] = -1
            values[top + 1, column] = 1
    values[:2, -2:], values[-2:, :2] = ((-1, -1), (1, -1)), ((-1, 1), (-1, -1))  # corner finder patterns
    values[0, -3:] = values[-1, :3] = -1
    for edge, value in enumerate((-1, 1, -1)):
        values[rows - 5 + edge : rows - edge, columns - 5 + edge : columns - edge] = value
    values[:8, :8] = 1  # separator, as far as the symbol reaches
    for edge, value in enumerate((-1, 1, -1)):
        values[edge : 7 - edge, edge : 7 - edge] = value
    is_format = np.zeros(values.shape, np.bool_)
    is_format.flat[_format_at(version)] = True
    return values, is_format


def _format_at(version: Version) -> NDArray[np.intp]:
    """Return the flat module index of the 18 bits of both copies (36,), bit 0 first."""
    rows, columns = SIZES[str(version)]
    near = [(1 + k % 5, 8 + k // 5) for k in range(18)]
    far = [(rows - 6 + k % 5, columns - 8 + k // 5) for k in range(15)]
    far += [(rows - 6, columns - 5 + k) for k in range(3)]
    return np.array([row * columns + column for row, column in near + far], np.intp)


def format_signs(
    version: Version, level: ErrorLevel | None, mask: int, is_format: NDArray[np.bool_]
) -> NDArray[np.int8]:
    """Return the modules of a word of format information, -1 dark, +1 light, as they lie in the grid."""
    word = list(SIZES).index(str(version)) + 32 * _LEVELS.index(level or "M") << 12
    rest = word
    for bit in range(17, 11, -1):
        if rest >> bit & 1:
            rest ^= FORMAT_GENERATOR << bit - 12
    ones = np.array([(word | rest) ^ masked for masked in FORMAT_MASKS])[:, None] >> np.arange(18) & 1
    signs = np.ones(is_format.shape, np.int8)
    signs.flat[_format_at(version)] = np.where(ones, -1, 1).ravel()
    return signs[is_format]


def block_shapes(version: Version, level: ErrorLevel | None) -> list[tuple[int, int]]:
    """Return data and check codewords of each block; the last ones are longer where they differ."""
    number, name = list(SIZES).index(str(version)), level or "M"
    count, n_data = _BLOCKS[name][number], _DATA[name][number]
    n_check = (_CODEWORDS[number] - n_data) // count
    return [(n_data // count + (b >= count - n_data % count), n_check) for b in range(count)]


def count_bits(version: Version) -> dict[int, int]:
    """Return the bits in which characters are counted, by QR codes' number of the mode (table 3).

    They are the fewest that count all that the weaker level holds.
    """
    room = 8 * _DATA["M"][list(SIZES).index(str(version))] - 3
    return {
        mode: next(n for n in range(1, 16) if (room - n) * characters // bits < 1 << n)
        for mode, characters, bits in ((1, 3, 10), (2, 2, 11), (4, 1, 8), (8, 1, 13))
    }


def masks_of(version: Version, data: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which data modules the only mask inverts, (1, V, U)."""
    rows, columns = np.indices(data.shape)
    return ((rows // 2 + columns // 3) % 2 == 0)[None] & data


def placement(version: Version, data: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the flat module index of each bit, in the order in which codewords are placed.

    In pairs of columns from the right, which begin beside the timing pattern there, up and down in turn.
    """
    rows, columns = data.shape
    order = []
    for pair, right in enumerate(range(columns - 2, 0, -2)):
        for row in range(rows)[:: 1 if pair % 2 else -1]:
            order += [row * columns + column for column in (right, right - 1) if data[row, column]]
    return np.array(order, np.intp)
