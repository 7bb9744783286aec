"""Where the codewords of a QR code are: masks, format words, placement and interleaving.

All modules are +1 light and -1 dark, bit 1 is dark, and a mask is a grid of signs: masking is multiplying.
Like the code space, everything comes from segno's tables and placement.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evqr.symbol.reed_solomon import ReedSolomon
from evqr.symbol.space import code_space, read_only, size_of

ErrorLevel = Literal["L", "M", "Q", "H"]
LEVELS: tuple[ErrorLevel, ...] = ("L", "M", "Q", "H")
N_MASKS = 8


@dataclass(frozen=True, kw_only=True)
class Block:
    """One Reed-Solomon block: ``codewords`` is its part of the symbol's codewords, data first, then check."""

    codewords: slice
    n_data: int
    n_check: int

    @property
    def code(self) -> ReedSolomon:
        """The code over GF(256) that it is a word of."""
        return ReedSolomon(polynomial=0x11D, n_check=self.n_check)

    @property
    def bits(self) -> slice:
        """Its part of the symbol's bits."""
        return slice(8 * self.codewords.start, 8 * self.codewords.stop)


@dataclass(frozen=True, eq=False, kw_only=True)
class CodewordLayout:
    """The codewords of one version and level, block by block.

    Attributes
    ----------
    bits : (8 n,) intp   flat module index of every bit, most significant first, blocks one after another
    blocks               in order of their data
    """

    bits: NDArray[np.intp]
    blocks: tuple[Block, ...]


@functools.cache
def codeword_layout(version: int, level: ErrorLevel) -> CodewordLayout:
    """Return where the codewords of a version and level are."""
    from segno import consts

    shapes = [
        (ec.num_data, ec.num_total - ec.num_data)
        for ec in consts.ECC[version][consts.ERROR_MAPPING[level]]
        for _ in range(ec.num_blocks)
    ]
    # A symbol holds the first data codeword of every block, then the second ..., then the check codewords so.
    data = [(i, b) for b, (n_data, _) in enumerate(shapes) for i in range(n_data)]
    check = [(i, b) for b, (_, n_check) in enumerate(shapes) for i in range(n_check)]
    place = {(b, i): n for n, (i, b) in enumerate(sorted(data))}
    place |= {(b, shapes[b][0] + i): len(data) + n for n, (i, b) in enumerate(sorted(check))}

    blocks, codewords, start = [], [], 0
    for b, (n_data, n_check) in enumerate(shapes):
        stop = start + n_data + n_check
        blocks.append(Block(codewords=slice(start, stop), n_data=n_data, n_check=n_check))
        codewords += [place[b, i] for i in range(n_data + n_check)]
        start = stop
    bits = _placement(version)[: 8 * start].reshape(-1, 8)[codewords]
    return CodewordLayout(bits=read_only(bits.ravel()), blocks=tuple(blocks))


@functools.cache
def mask_signs(version: int) -> NDArray[np.int8]:
    """Return the eight masks, (8, r r) int8: -1 where a data module is inverted, +1 elsewhere."""
    from segno import encoder

    space = code_space(version)
    rows, columns = np.indices((space.size, space.size))
    masks = [
        inverts(rows, columns) & space.data for inverts in encoder.get_data_mask_functions(is_micro=False)
    ]
    return read_only(np.where(masks, -1, 1).astype(np.int8).reshape(N_MASKS, -1))


@dataclass(frozen=True, eq=False, kw_only=True)
class FormatWords:
    """The 32 words of format information of a version.

    Attributes
    ----------
    at : (30,) intp            flat module index of each of their modules (both copies)
    signs : (32, 30) float64   -1 dark, +1 light
    meaning                    level and mask of each word
    """

    at: NDArray[np.intp]
    signs: NDArray[np.float64]
    meaning: tuple[tuple[ErrorLevel, int], ...]


@functools.cache
def format_words(version: int) -> FormatWords:
    """Return the words of format information of a version."""
    from segno import consts, encoder

    space = code_space(version)
    meaning: tuple[tuple[ErrorLevel, int], ...] = tuple(
        (level, mask) for level in LEVELS for mask in range(N_MASKS)
    )
    words = []
    for level, mask in meaning:
        matrix = [bytearray(space.size) for _ in range(space.size)]
        encoder.add_format_info(matrix, version, consts.ERROR_MAPPING[level], mask)
        words.append(np.where(np.array(matrix)[space.format], -1, 1))
    at = np.flatnonzero(space.format)
    return FormatWords(at=read_only(at), signs=read_only(np.array(words, np.float64)), meaning=meaning)


def symbol_of(codewords: NDArray[np.uint8], version: int, level: ErrorLevel, mask: int) -> NDArray[np.int8]:
    """Return the exact symbol, (r, r) int8, that carries some codewords.

    Parameters
    ----------
    codewords : (n,) uint8   data and check codewords of the first block, then of the second, ...
    """
    masked = _masked(version, level, mask)
    modules = masked.symbol.copy()
    dark = np.unpackbits(codewords ^ masked.codewords).view(np.int8)
    modules[codeword_layout(version, level).bits] = 1 - 2 * dark
    size = size_of(version)
    return modules.reshape(size, size)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Masked:
    """What the codewords of one version, level and mask are drawn into.

    Attributes
    ----------
    signs : (8 n,) int8        of the mask, in the order of the codewords' bits
    codewords : (n,) uint8     that the mask turns into light modules
    symbol : (r r,) int8       with those
    """

    signs: NDArray[np.int8]
    codewords: NDArray[np.uint8]
    symbol: NDArray[np.int8]


@functools.cache
def _masked(version: int, level: ErrorLevel, mask: int) -> _Masked:
    space, words = code_space(version), format_words(version)
    symbol = mask_signs(version)[mask].copy()
    symbol[space.known.ravel()] = space.values[space.known]
    symbol[words.at] = words.signs[words.meaning.index((level, mask))]
    bits = codeword_layout(version, level).bits
    signs = mask_signs(version)[mask][bits]
    symbol[bits] = 1
    return _Masked(
        signs=read_only(signs),
        codewords=read_only(np.packbits(signs < 0)),
        symbol=read_only(symbol),
    )


def unmasked(q: NDArray[np.float64], version: int, level: ErrorLevel, mask: int) -> NDArray[np.float64]:
    """Return the modules (8 n,) that carry the codewords' bits, the mask undone, of a grid (r, r)."""
    return q.ravel()[codeword_layout(version, level).bits] * _masked(version, level, mask).signs


@functools.cache
def _placement(version: int) -> NDArray[np.intp]:
    """Return the flat indices of the data modules in the order in which codewords fill them."""
    from segno import encoder

    space = code_space(version)
    empty = 2  # segno's mark of a module to fill; we let it fill in the number of the bit instead of the bit
    matrix = np.where(space.data, empty, 0).tolist()
    first = empty + 1
    encoder.add_codewords(matrix, range(first, first + np.count_nonzero(space.data)), version)
    order = np.argsort(np.array(matrix).ravel())
    return order[-np.count_nonzero(space.data) :]
