"""What the modules of a QR or Micro QR code carry: function patterns, format words, masks and codewords.

All modules are +1 light and -1 dark, bit 1 is dark, and a mask is a grid of signs: masking is multiplying.
A version is 1 to 40 or M1 to M4.  Everything comes from segno's tables and placement, so that the tables of
ISO/IEC 18004 are not repeated here.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evqr.clock import one_time
from evqr.symbol.reed_solomon import ReedSolomon, Symbols
from evqr.symbol.space import Version, closed

ErrorLevel = Literal["L", "M", "Q", "H"]
LEVELS: tuple[ErrorLevel, ...] = ("L", "M", "Q", "H")

QR_FIELD = 0x11D
"""Polynomial of the codewords' field, GF(256)."""

DARK_MODULE = (-8, 8)
"""Row and column of the module beside the lower left finder pattern that is dark in all QR codes."""

_EMPTY = 2
"""segno's mark of a module to fill."""

HALF_CODEWORDS = ("M1", "M3")
"""Versions whose last data codeword has four bits."""


def levels_of(version: Version) -> tuple[ErrorLevel | None, ...]:
    """Return the error correction levels of a version, the weakest first; M1 has one without a name."""
    from segno import consts

    shapes = consts.ECC[_segno_version(version)]
    levels: tuple[ErrorLevel | None, ...] = (None, *LEVELS)
    return tuple(level for level in levels if _segno_level(level) in shapes)


@dataclass(frozen=True, eq=False, kw_only=True)
class Roles:
    """The modules of one version, by what they carry: every one is known, format or data.

    Attributes
    ----------
    known : (r, r) bool
        Function patterns.
    values : (r, r) int8
        -1 dark, +1 light where known, 0 elsewhere.
    format : (r, r) bool
        Format information: level and mask.
    data : (r, r) bool
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
    known = ~(is_format | is_data)
    values = np.where(_array(matrix) == 1, -1, 1) * known
    return Roles(
        known=closed(known),
        values=closed(values.astype(np.int8)),
        format=closed(is_format),
        data=closed(is_data),
    )


def _array(matrix: Sequence[bytearray]) -> NDArray[np.uint8]:
    """Return segno's matrix as an array (r, r)."""
    return np.frombuffer(b"".join(matrix), np.uint8).reshape(len(matrix), -1)


def _add_format(matrix: Sequence[bytearray], version: Version, level: ErrorLevel | None, mask: int) -> None:
    """Write format information, and the dark module of a QR code, into segno's matrix."""
    from segno import encoder

    encoder.add_format_info(matrix, _segno_version(version), _segno_level(level), mask)


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


@functools.cache
@one_time()
def codeword_layout(version: Version, level: ErrorLevel | None) -> CodewordLayout:
    """Return where the codewords of a version and level are."""
    from segno import consts

    shapes = [
        (ec.num_data, ec.num_total - ec.num_data)
        for ec in consts.ECC[_segno_version(version)][_segno_level(level)]
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
    """Return the masks, (8, r r) or (4, r r) int8: -1 where a data module is inverted, +1 elsewhere."""
    from segno import encoder

    data = roles_of(version).data
    rows, columns = np.indices(data.shape)
    functions = encoder.get_data_mask_functions(is_micro=isinstance(version, str))
    masks = np.array([inverts(rows, columns) & data for inverts in functions])
    return closed(np.where(masks, -1, 1).astype(np.int8).reshape(len(masks), -1))


@dataclass(frozen=True, eq=False, kw_only=True)
class FormatWords:
    """The words of format information of a version: 32, or those of a Micro QR code's version.

    Attributes
    ----------
    at : (k,) intp
        Flat module index of each of their modules: 30 in two copies, or 15.
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
    words = []
    for level, mask in meaning:
        matrix = [bytearray(len(is_format)) for _ in is_format]
        _add_format(matrix, version, level, mask)
        words.append(np.where(_array(matrix)[is_format], -1, 1))
    at = np.flatnonzero(is_format)
    return FormatWords(at=closed(at), signs=closed(np.array(words, np.float64)), meaning=meaning)


def symbol_of(
    codewords: NDArray[np.uint8], version: Version, level: ErrorLevel | None, mask: int
) -> NDArray[np.int8]:
    """Return the exact symbol, (r, r) int8, that carries some codewords.

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
    symbol : (r r,) int8
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
    """Return the modules (8 n,) that carry the codewords' bits, the mask undone, of a grid (r, r).

    Bits that are not printed are 0.
    """
    return q.ravel()[codeword_layout(version, level).bits] * _masked(version, level, mask).signs


@functools.cache
@one_time()
def _placement(version: Version) -> NDArray[np.intp]:
    """Return the flat indices of the data modules in the order in which codewords fill them."""
    from segno import encoder

    data = roles_of(version).data
    # we let segno fill in the number of the bit instead of the bit
    matrix = np.where(data, _EMPTY, 0).tolist()
    first = _EMPTY + 1
    encoder.add_codewords(matrix, range(first, first + np.count_nonzero(data)), _segno_version(version))
    order = np.argsort(np.array(matrix).ravel())
    return order[-np.count_nonzero(data) :]


def _segno_version(version: Version) -> int:
    from segno import consts

    return consts.MICRO_VERSION_MAPPING[version] if isinstance(version, str) else version


def _segno_level(level: ErrorLevel | None) -> int | None:
    from segno import consts

    return None if level is None else consts.ERROR_MAPPING[level]
