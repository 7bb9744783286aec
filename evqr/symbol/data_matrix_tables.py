"""Sizes, function patterns and placement of Data Matrix symbols: ECC 200, and DMRE.

Sizes and check codewords are those of ISO/IEC 16022:2006, table 7, and ISO/IEC 21471:2020, as public
implementations repeat them; placement is the first one's annex F.  All are tested against zxing-cpp's.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from evqr.symbol.space import closed


@dataclass(frozen=True, kw_only=True)
class Size:
    """One size of a symbol.

    Attributes
    ----------
    rows, columns : int [modules]
        With the borders of its regions.
    down, across : int
        Data regions.
    n_check : int
        Check codewords.
    blocks : int
        Reed-Solomon blocks.
    """

    rows: int
    columns: int
    down: int = 1
    across: int = 1
    n_check: int
    blocks: int = 1

    @property
    def mapping(self) -> tuple[int, int]:
        """Rows and columns of modules within borders."""
        return self.rows - 2 * self.down, self.columns - 2 * self.across

    @property
    def n_data(self) -> int:
        """Data codewords."""
        rows, columns = self.mapping
        return rows * columns // 8 - self.n_check


def _square(side: int, regions: int, n_check: int, blocks: int = 1) -> Size:
    return Size(rows=side, columns=side, down=regions, across=regions, n_check=n_check, blocks=blocks)


def _rectangle(rows: int, columns: int, across: int, n_check: int) -> Size:
    return Size(rows=rows, columns=columns, across=across, n_check=n_check)


_SQUARE = (
    _square(10, 1, 5), _square(12, 1, 7), _square(14, 1, 10), _square(16, 1, 12), _square(18, 1, 14),
    _square(20, 1, 18), _square(22, 1, 20), _square(24, 1, 24), _square(26, 1, 28), _square(32, 2, 36),
    _square(36, 2, 42), _square(40, 2, 48), _square(44, 2, 56), _square(48, 2, 68), _square(52, 2, 84, 2),
    _square(64, 4, 112, 2), _square(72, 4, 144, 4), _square(80, 4, 192, 4), _square(88, 4, 224, 4),
    _square(96, 4, 272, 4), _square(104, 4, 336, 6), _square(120, 6, 408, 6), _square(132, 6, 496, 8),
    _square(144, 6, 620, 10),
)  # fmt: skip
_RECTANGULAR = (
    _rectangle(8, 18, 1, 7), _rectangle(8, 32, 2, 11), _rectangle(12, 26, 1, 14), _rectangle(12, 36, 2, 18),
    _rectangle(16, 36, 2, 24), _rectangle(16, 48, 2, 28),
)  # fmt: skip
_DMRE = (
    _rectangle(8, 48, 2, 15), _rectangle(8, 64, 4, 18), _rectangle(8, 80, 4, 22), _rectangle(8, 96, 4, 28),
    _rectangle(8, 120, 6, 32), _rectangle(8, 144, 6, 36), _rectangle(12, 64, 4, 27),
    _rectangle(12, 88, 4, 36), _rectangle(16, 64, 4, 36), _rectangle(20, 36, 2, 28),
    _rectangle(20, 44, 2, 34), _rectangle(20, 64, 4, 42), _rectangle(22, 48, 2, 38),
    _rectangle(24, 48, 2, 41), _rectangle(24, 64, 4, 46), _rectangle(26, 40, 2, 38),
    _rectangle(26, 48, 2, 42), _rectangle(26, 64, 4, 50),
)  # fmt: skip
TABLE: Mapping[str, Size] = MappingProxyType(
    {f"{size.rows}x{size.columns}": size for size in (*_SQUARE, *_RECTANGULAR, *_DMRE)}
)
"""All sizes by their names."""


def function_patterns(size: Size) -> NDArray[np.int8]:
    """Return the borders of the regions (V, U): -1 dark, +1 light, 0 elsewhere."""
    rows, columns = size.rows // size.down, size.columns // size.across
    region = np.zeros((rows, columns), np.int8)
    region[0] = np.where(np.arange(columns) % 2, 1, -1)
    region[:, -1] = np.where(np.arange(rows) % 2, -1, 1)
    region[:, 0] = region[-1] = -1
    return np.tile(region, (size.down, size.across))


@functools.cache
def placement(name: str) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return where the codewords of a size are.

    Parameters
    ----------
    name : str
        Key of `TABLE`.

    Returns
    -------
    bits : (n, 8) intp
        Flat module index of each codeword's bits, most significant first.
    left : (0,) or (4,) intp
        The same of modules that are left over: dark, light, light, dark.
    """
    size = TABLE[name]
    rows, columns = size.mapping
    free = np.ones((rows, columns), np.bool_)
    words = np.array(list(_words(free)))
    left = np.argwhere(free)
    return closed(_modules(size, words)), closed(_modules(size, left))


def _modules(size: Size, places: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return flat module indices (...) of places (..., 2) within the borders."""
    row, column = places[..., 0], places[..., 1]
    rows, columns = size.mapping
    row = row + 1 + 2 * (row // (rows // size.down))
    column = column + 1 + 2 * (column // (columns // size.across))
    return row * size.columns + column


def _words(free: NDArray[np.bool_]) -> Iterator[list[tuple[int, int]]]:
    """Yield the eight places of each codeword within the borders, and mark them as taken.

    Codewords follow each other along diagonals, up and down in turn; some corners have one of their own.
    """
    rows, columns = free.shape
    row, column = 4, 0
    while row < rows or column < columns:
        anchors: list[tuple[int, int]] = []
        yield from _taken(free, _corner(row, column, rows, columns))
        while row >= 0 and column < columns:
            anchors.append((row, column))
            row, column = row - 2, column + 2
        row, column = row + 1, column + 3
        while row < rows and column >= 0:
            anchors.append((row, column))
            row, column = row + 2, column - 2
        row, column = row + 3, column + 1
        for at in anchors:
            if 0 <= at[0] < rows and 0 <= at[1] < columns and free[at]:
                yield from _taken(free, _around(*at, rows, columns))


def _taken(free: NDArray[np.bool_], word: list[tuple[int, int]]) -> Iterator[list[tuple[int, int]]]:
    if word:
        free[tuple(np.array(word).T)] = False
        yield word


def _around(row: int, column: int, rows: int, columns: int) -> list[tuple[int, int]]:
    """Return the places of a codeword whose last bit is at a place; beyond an edge it goes on."""
    word = []
    for r, c in ((-2, -2), (-2, -1), (-1, -2), (-1, -1), (-1, 0), (0, -2), (0, -1), (0, 0)):
        r, c = row + r, column + c
        if r < 0:
            r, c = r + rows, c + 4 - (rows + 4) % 8
        if c < 0:
            r, c = r + 4 - (columns + 4) % 8, c + columns
        word.append((r - rows if r >= rows else r, c))
    return word


def _corner(row: int, column: int, rows: int, columns: int) -> list[tuple[int, int]]:
    """Return the places of a codeword that lies in corners, if one comes where a diagonal begins here.

    Written from the edges that they lie at: negative numbers count from the last row or column.
    """
    if (row, column) == (rows, 0):
        word = ((-1, 0), (-1, 1), (-1, 2), (0, -2), (0, -1), (1, -1), (2, -1), (3, -1))
    elif (row, column) == (rows - 2, 0) and columns % 8 == 4:
        word = ((-3, 0), (-2, 0), (-1, 0), (0, -2), (0, -1), (1, -1), (2, -1), (3, -1))
    elif (row, column) == (rows - 2, 0) and columns % 4:
        word = ((-3, 0), (-2, 0), (-1, 0), (0, -4), (0, -3), (0, -2), (0, -1), (1, -1))
    elif (row, column) == (rows + 4, 2) and columns % 8 == 0:
        word = ((-1, 0), (-1, -1), (0, -3), (0, -2), (0, -1), (1, -3), (1, -2), (1, -1))
    else:
        return []
    return [(r % rows, c % columns) for r, c in word]
