"""What the modules of codes of the QR family carry: function patterns, format words, masks and codewords.

All modules are +1 light and -1 dark, bit 1 is dark, and a mask is a grid of signs: masking is multiplying.
A version is 1 to 40, M1 to M4 or R7x43 to R17x139; the standards' tables are in `evqr.symbol.qr_tables` and
`evqr.symbol.rmqr_tables`.
"""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from evqr.clock import one_time
from evqr.symbol import qr_tables, rmqr_tables
from evqr.symbol.qr_tables import ErrorLevel
from evqr.symbol.reed_solomon import ReedSolomon, Symbols
from evqr.symbol.space import Version, closed

QR_FIELD = 0x11D
"""Polynomial of the codewords' field, GF(256)."""

HALF_CODEWORDS = ("M1", "M3")
"""Versions whose last data codeword has four bits."""


def _tables(version: Version) -> ModuleType:
    return rmqr_tables if version in rmqr_tables.SIZES else qr_tables


def levels_of(version: Version) -> tuple[ErrorLevel | None, ...]:
    """Return the error correction levels of a version, the weakest first; M1 has one without a name."""
    return _tables(version).levels_of(version)


@dataclass(frozen=True, eq=False, kw_only=True)
class Roles:
    """The modules of one version, by what they carry: every one is known, format or data.

    Attributes
    ----------
    known : (V, U) bool
        Function patterns.
    values : (V, U) int8
        -1 dark, +1 light where known, 0 elsewhere.
    format : (V, U) bool
        Format information: level and mask.
    data : (V, U) bool
        Codewords, and the few remainder bits behind the last.
    """

    known: NDArray[np.bool_]
    values: NDArray[np.int8]
    format: NDArray[np.bool_]
    data: NDArray[np.bool_]


@functools.cache
@one_time()
def roles_of(version: Version) -> Roles:
    """Return what the modules of a version carry."""
    values, is_format = _tables(version).function_patterns(version)
    values = np.where(is_format, np.int8(0), values)
    known = values != 0
    return Roles(
        known=closed(known),
        values=closed(values),
        format=closed(is_format),
        data=closed(~(known | is_format)),
    )


@dataclass(frozen=True, kw_only=True)
class Block:
    """One Reed-Solomon block.

    Attributes
    ----------
    codewords : slice
        Its part of the symbol's codewords, data first, then check.
    n_data : int
        Data codewords.
    code : ReedSolomon
        What it is a word of.
    """

    codewords: slice
    n_data: int
    code: ReedSolomon

    @property
    def n_check(self) -> int:
        """Check codewords."""
        return self.code.n_check

    @property
    def bits(self) -> slice:
        """Its part of the symbol's bits."""
        return slice(8 * self.codewords.start, 8 * self.codewords.stop)


@dataclass(frozen=True, eq=False, kw_only=True)
class CodewordLayout:
    """The codewords of one version and level, block by block.

    Attributes
    ----------
    bits : (8 n,) intp
        Flat module index of every bit, most significant first, blocks one after another; -1 for a bit that is
        not printed.
    printed : (8 n,) bool, optional
        Bits that are printed, None for all: the last four of the last data codeword of M1 and M3 are not, and
        are zero.
    blocks : tuple of Block
        In order of their data.
    """

    bits: NDArray[np.intp]
    printed: NDArray[np.bool_] | None
    blocks: tuple[Block, ...]

    @functools.cached_property
    def _alike(self) -> list[tuple[ReedSolomon, slice, int]]:
        """Blocks in a row that are as long: their code, their codewords and how many they are."""
        alike = []
        for (code, _), each in itertools.groupby(
            self.blocks, lambda b: (b.code, b.codewords.stop - b.codewords.start)
        ):
            blocks = list(each)
            alike.append((code, slice(blocks[0].codewords.start, blocks[-1].codewords.stop), len(blocks)))
        return alike

    def syndromes(self, codewords: NDArray[np.uint8]) -> list[Symbols]:
        """Return the syndromes of all blocks, of codewords (n,) as ``bits`` has them."""
        return [
            of_block
            for code, where, count in self._alike
            for of_block in code.syndromes(codewords[where].reshape(count, -1))
        ]

    def valid(self, codewords: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Tell in which (B,) of the codewords (B, n) of symbols, as ``bits`` has them, none is wrong."""
        valid = np.ones(len(codewords), np.bool_)
        for code, where, count in self._alike:
            syndromes = code.syndromes(codewords[:, where].reshape(len(codewords), count, -1))
            valid &= ~syndromes.any(axis=(1, 2))
        return valid


@functools.cache
@one_time()
def codeword_layout(version: Version, level: ErrorLevel | None) -> CodewordLayout:
    """Return where the codewords of a version and level are."""
    shapes = _tables(version).block_shapes(version, level)
    # A symbol holds the first data codeword of every block, then the second ..., then the check codewords so.
    data = [(i, b) for b, (n_data, _) in enumerate(shapes) for i in range(n_data)]
    check = [(i, b) for b, (_, n_check) in enumerate(shapes) for i in range(n_check)]
    place = {(b, i): n for n, (i, b) in enumerate(sorted(data))}
    place |= {(b, shapes[b][0] + i): len(data) + n for n, (i, b) in enumerate(sorted(check))}

    blocks, codewords, start = [], [], 0
    for b, (n_data, n_check) in enumerate(shapes):
        stop = start + n_data + n_check
        code = ReedSolomon(polynomial=QR_FIELD, n_check=n_check)
        blocks.append(Block(codewords=slice(start, stop), n_data=n_data, code=code))
        codewords += [place[b, i] for i in range(n_data + n_check)]
        start = stop
    printed = np.ones((start, 8), dtype=bool)
    if version in HALF_CODEWORDS:
        printed[len(data) - 1, 4:] = False
    modules = np.full((start, 8), -1, dtype=np.intp)
    modules[printed] = _placement(version)[: np.count_nonzero(printed)]
    return CodewordLayout(
        bits=closed(modules[codewords].ravel()),
        printed=None if printed.all() else closed(printed[codewords].ravel()),
        blocks=tuple(blocks),
    )


@functools.cache
@one_time()
def mask_signs(version: Version) -> NDArray[np.int8]:
    """Return the masks (n, V U) int8: -1 where a data module is inverted, +1 elsewhere."""
    masks = _tables(version).masks_of(version, roles_of(version).data)
    return closed(np.where(masks, -1, 1).astype(np.int8).reshape(len(masks), -1))


@dataclass(frozen=True, eq=False, kw_only=True)
class FormatWords:
    """The words of format information of a version: 32, or those of the version.

    Attributes
    ----------
    at : (k,) intp
        Flat module index of each of their modules: 30 in two copies, 15 in one, or 36 in two.
    signs : (n, k) float64
        -1 dark, +1 light.
    meaning : tuple
        Level and mask of each word.
    """

    at: NDArray[np.intp]
    signs: NDArray[np.float64]
    meaning: tuple[tuple[ErrorLevel | None, int], ...]


@functools.cache
@one_time()
def format_words(version: Version) -> FormatWords:
    """Return the words of format information of a version."""
    is_format = roles_of(version).format
    meaning: tuple[tuple[ErrorLevel | None, int], ...] = tuple(
        (level, mask) for level in levels_of(version) for mask in range(len(mask_signs(version)))
    )
    words = [_tables(version).format_signs(version, *which, is_format) for which in meaning]
    at = np.flatnonzero(is_format)
    return FormatWords(at=closed(at), signs=closed(np.array(words, np.float64)), meaning=meaning)


def symbol_of(
    codewords: NDArray[np.uint8], version: Version, level: ErrorLevel | None, mask: int
) -> NDArray[np.int8]:
    """Return the exact symbol, (V, U) int8, that carries some codewords.

    Parameters
    ----------
    codewords : (n,) uint8
        Data and check codewords of the first block, then of the second, ...
    version : int or str
        Size of the symbol.
    level : str, optional
        Its level of error correction.
    mask : int
        Number of its mask.
    """
    layout, masked = codeword_layout(version, level), _masked(version, level, mask)
    modules = masked.symbol.copy()
    signs = (1 - 2 * np.unpackbits(codewords).view(np.int8)) * masked.signs
    printed = slice(None) if layout.printed is None else layout.printed
    modules[layout.bits[printed]] = signs[printed]
    return modules.reshape(roles_of(version).known.shape)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Masked:
    """What the codewords of one version, level and mask are drawn into.

    Attributes
    ----------
    signs : (8 n,) int8
        Of the mask, in the order of the codewords' bits; 0 for bits that are not printed.
    symbol : (V U,) int8
        All other modules.
    """

    signs: NDArray[np.int8]
    symbol: NDArray[np.int8]


@functools.cache
@one_time()
def _masked(version: Version, level: ErrorLevel | None, mask: int) -> _Masked:
    roles, words = roles_of(version), format_words(version)
    symbol = mask_signs(version)[mask].copy()
    symbol[roles.known.ravel()] = roles.values[roles.known]
    symbol[words.at] = words.signs[words.meaning.index((level, mask))]
    bits = codeword_layout(version, level).bits
    signs = np.where(bits < 0, 0, mask_signs(version)[mask][bits])
    return _Masked(
        signs=closed(signs.astype(np.int8)),
        symbol=closed(symbol),
    )


def unmasked(
    q: NDArray[np.float64], version: Version, level: ErrorLevel | None, mask: int
) -> NDArray[np.float64]:
    """Return the modules (..., 8 n) that carry the codewords' bits, the mask undone, of grids (..., V, U).

    Bits that are not printed are 0.
    """
    flat = q.reshape(*q.shape[:-2], -1)
    return flat[..., codeword_layout(version, level).bits] * _masked(version, level, mask).signs


@functools.cache
@one_time()
def _placement(version: Version) -> NDArray[np.intp]:
    """Return the flat indices of the data modules in the order in which codewords fill them."""
    return _tables(version).placement(version, roles_of(version).data)
