"""Sizes, function patterns and placement of Aztec symbols (ISO/IEC 24778), compact or of full range.

A version is C1 to C4 or F1 to F32, with the number of layers.  All are tested against zxing-cpp's symbols.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from evqr.symbol.reed_solomon import ReedSolomon
from evqr.symbol.space import closed

FIELDS: Mapping[int, int] = MappingProxyType({6: 0x43, 8: 0x12D, 10: 0x409, 12: 0x1069})
"""Polynomial of the codewords' field by their bits."""

MODE_FIELD = 0x13
"""Polynomial of the mode message's field, GF(16)."""

GRID = 16
"""Modules from one line of the reference grid to the next."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """One size of a symbol.

    Attributes
    ----------
    layers : int
        Of codewords around the core, two modules wide.
    compact : bool
        With the smaller core, and without a reference grid.
    """

    layers: int
    compact: bool

    @property
    def base(self) -> int:
        """Modules a side without those of the reference grid."""
        return 4 * self.layers + (11 if self.compact else 14)

    @property
    def side(self) -> int:
        """Modules a side."""
        return self.base if self.compact else self.base + 1 + 2 * ((self.base // 2 - 1) // (GRID - 1))

    @property
    def core(self) -> int:
        """Distance of the mode message from the centre [modules]."""
        return 5 if self.compact else 7

    @property
    def width(self) -> int:
        """Bits of a codeword."""
        return next(width for width, most in ((6, 2), (8, 8), (10, 22), (12, 32)) if self.layers <= most)

    @property
    def n_bits(self) -> int:
        """Modules of the layers."""
        return self.layers * (16 * self.layers + (88 if self.compact else 112))

    @property
    def n_codewords(self) -> int:
        """Codewords, data and check."""
        return self.n_bits // self.width


TABLE: Mapping[str, Size] = MappingProxyType(
    {f"C{layers}": Size(layers=layers, compact=True) for layers in range(1, 5)}
    | {f"F{layers}": Size(layers=layers, compact=False) for layers in range(1, 33)}
)
"""All sizes by their names."""


def function_patterns(size: Size) -> NDArray[np.int8]:
    """Return bull's eye, orientation marks and reference grid (n, n): -1 dark, +1 light, 0 elsewhere."""
    centre, core = size.side // 2, size.core
    row, column = np.abs(np.indices((size.side, size.side)) - centre)
    values = np.zeros(row.shape, np.int8)
    if not size.compact:
        lines = (row % GRID == 0) | (column % GRID == 0)
        values[lines] = np.where((row + column) % 2, 1, -1)[lines]
    bull = bulls_eye(size)
    values[bull] = np.where(np.maximum(row, column) % 2, 1, -1)[bull]
    marks = values[centre - core : centre + core + 1, centre - core : centre + core + 1]
    marks[:2, :2][[0, 0, 1], [0, 1, 0]] = (
        -1,
        -1,
        -1,
    )  # from the upper left, clockwise: three, two, one and none
    marks[:2, -2:][[0, 0, 1], [0, 1, 1]] = 1, -1, -1
    marks[-2:, -2:][[0, 1, 1], [1, 1, 0]] = -1, 1, 1
    marks[-2:, :2][[0, 1, 1], [0, 0, 1]] = 1, 1, 1
    return values


def bulls_eye(size: Size) -> NDArray[np.bool_]:
    """Return the modules of the bull's eye (n, n), the light ring about it included where that is known."""
    row, column = np.abs(np.indices((size.side, size.side)) - size.side // 2)
    return np.maximum(row, column) < size.core


def mode_places(size: Size) -> NDArray[np.intp]:
    """Return the flat module index of each bit of the mode message (28,) or (40,), clockwise."""
    core, first = size.core, size.side // 2 - size.core
    along = [k for k in range(2, 2 * core - 1) if size.compact or k != core]
    places = []
    for turn in range(4):
        for k in along:
            row, column = ((0, k), (k, 2 * core), (2 * core, 2 * core - k), (2 * core - k, 0))[turn]
            places.append((first + row) * size.side + first + column)
    return np.array(places, np.intp)


def mode_words(size: Size) -> NDArray[np.float64]:
    """Return the mode messages (K, 28) or (K, 40) of 1 to K data codewords: -1 dark, +1 light."""
    count = np.arange(size.n_codewords)
    if size.compact:
        said, nibbles = (size.layers - 1 << 6) + count[:64], 2
    else:
        said, nibbles = (size.layers - 1 << 11) + count[:2048], 4
    data = (said[:, None] >> 4 * np.arange(nibbles)[::-1] & 15).astype(np.uint8)
    words = np.array([mode_code(size).encode(each) for each in data])
    bits = words[:, :, None] >> np.arange(4)[::-1] & 1
    return np.where(bits, -1.0, 1.0).reshape(len(words), -1)


def mode_code(size: Size) -> ReedSolomon:
    """Return what the mode message of a size is a word of."""
    return ReedSolomon(polynomial=MODE_FIELD, n_check=5 if size.compact else 6, first_root=1)


@functools.cache
def placement(version: str) -> NDArray[np.intp]:
    """Return the flat module index of each bit of the layers (n_bits,).

    From the outermost layer inwards, anticlockwise from the upper left, across its two modules, then along.
    """
    size = TABLE[version]
    half = np.arange(size.base // 2)
    if size.compact:
        at = np.arange(size.base)
    else:
        away = half + 1 + half // (GRID - 1)
        at = size.side // 2 + np.concatenate([-away[::-1], away])
    bits = []
    for layer in range(size.layers):
        low, length = 2 * layer, size.base - 4 * layer - 2
        row, column = (low + each for each in np.divmod(np.arange(2 * length), 2))
        for _ in range(4):
            bits.append(at[row] * size.side + at[column])
            row, column = size.base - 1 - column, row
    return closed(np.concatenate(bits))
