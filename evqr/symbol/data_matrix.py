"""Data Matrix symbols (ISO/IEC 16022), ECC 200 and DMRE (ISO/IEC 21471): an L, timing on the other edges.

Between the borders are codewords, without masks; a symbol of several blocks has the words of each in turn.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from evqr.clock import one_time
from evqr.config import DecodeConfig
from evqr.reason import Reason
from evqr.symbol.chance import ORIENTATIONS, confidence, log_sum
from evqr.symbol.content import content_of
from evqr.symbol.correct import Corrected, Doubt, correct_block
from evqr.symbol.data_matrix_tables import TABLE, Size, function_patterns, placement
from evqr.symbol.decoded import Decoded, DecodeFailure, Effort
from evqr.symbol.payload import Payload, StructuredAppend
from evqr.symbol.qr_segments import Segments
from evqr.symbol.reed_solomon import ReedSolomon, Symbols
from evqr.symbol.space import Anchor, CodeSpace, Landmark, Timing, closed
from evqr.symbology import Symbology

QUIET_ZONE = 1
FIELD = 0x12D
"""Polynomial of the codewords' field, GF(256)."""

STRUCTURED_APPEND = 233
"""First codeword of a symbol that is a part of a message (ISO/IEC 16022, 5.6)."""

SIZES: Mapping[str, tuple[int, int]] = MappingProxyType(
    {name: (size.rows, size.columns) for name, size in TABLE.items()}
)


def anchors(version: str) -> tuple[Anchor, ...]:
    """Return the corner at which the two edges of the L meet."""
    return (Anchor(Landmark.SOLID_CORNER, 0.0, float(SIZES[version][0])),)


def timing(version: str) -> tuple[Timing, ...]:
    """Return the timing patterns of a version: the sides across from the L, which end in a light corner."""
    rows, columns = SIZES[version]
    return (
        Timing(0.5, 0.5, True, columns - 1, 1 + QUIET_ZONE),
        Timing(columns - 0.5, 1.5, False, rows - 1, QUIET_ZONE),
    )


@functools.cache
@one_time()
def space(version: str) -> CodeSpace:
    """Return the code space of a version.

    Raises
    ------
    ValueError
        Not a size of the standards.
    """
    if version not in TABLE:
        raise ValueError(f"version must be one of {', '.join(TABLE)}, got {version}")
    values = function_patterns(TABLE[version])
    return CodeSpace(
        symbology=Symbology.DATA_MATRIX,
        version=version,
        known=values != 0,
        values=values,
        anchors=anchors(version),
        quiet_zone=QUIET_ZONE,
    )


def mirror(grid: NDArray) -> NDArray:
    """Return the grid mirrored about the diagonal through the corner of the L."""
    return grid[::-1, ::-1].T


@dataclass(frozen=True, eq=False, kw_only=True)
class Layout:
    """The codewords of one size, block by block.

    Attributes
    ----------
    order : tuple of (n,) intp
        Of each block, which of the symbol's codewords it has: data, then check.
    bits : (n, 8) intp
        Flat module index of each bit of the symbol's codewords, most significant first.
    code : ReedSolomon
        What each block is a word of.
    symbol : (V U,) int8
        All other modules.
    """

    order: tuple[NDArray[np.intp], ...]
    bits: NDArray[np.intp]
    code: ReedSolomon
    symbol: NDArray[np.int8]


@functools.cache
@one_time()
def layout_of(version: str) -> Layout:
    """Return where the codewords of a version are."""
    size = TABLE[version]
    bits, left = placement(version)
    symbol = function_patterns(size).ravel().copy()
    symbol[left] = (-1, 1, 1, -1)[: len(left)]
    return Layout(
        order=tuple(closed(_order(size, block)) for block in range(size.blocks)),
        bits=bits,
        code=ReedSolomon(polynomial=FIELD, n_check=size.n_check // size.blocks, first_root=1),
        symbol=closed(symbol),
    )


def _order(size: Size, block: int) -> NDArray[np.intp]:
    """Return the codewords of a block: every so many-th of the data, and every so many-th check codeword."""
    check = range(size.n_data + block, size.n_data + size.n_check, size.blocks)
    return np.array([*range(block, size.n_data, size.blocks), *check], np.intp)


def symbol_of(codewords: NDArray[np.uint8], version: str) -> NDArray[np.int8]:
    """Return the exact symbol, (V, U) int8, that carries all codewords (n,) of a version."""
    layout = layout_of(version)
    symbol = layout.symbol.copy()
    symbol[layout.bits] = 1 - 2 * np.unpackbits(codewords).view(np.int8).reshape(-1, 8)
    return symbol.reshape(SIZES[version])


def decode(
    q: NDArray[np.float64], space: CodeSpace, config: DecodeConfig, effort: Effort
) -> Decoded | DecodeFailure:
    """Decode a grid: correct every block, judge, rebuild the symbol, read it."""
    version = str(space.version)
    layout = layout_of(version)
    soft = q.ravel()[layout.bits]
    codewords = np.packbits(soft < 0.0, axis=1).ravel()
    count, hypotheses = len(layout.order), math.log(ORIENTATIONS)
    blocks: list[Corrected] = []
    for number, which in enumerate(layout.order):
        result = correct_block(
            soft[which].ravel(),
            layout.code,
            functools.partial(_log_contents, layout.code.n_check),
            log_limit=config.log_chance_limit - hypotheses - math.log(count),
            config=config,
            effort=effort,
            received=codewords[which],
        )
        if isinstance(result, Doubt):
            detail = f"{result.detail} (block {number + 1} of {count})"
            return DecodeFailure(reason=result.reason, detail=detail, space=space)
        codewords[which] = result.words
        blocks.append(result)

    modules, payload = _said(codewords.tobytes(), version, config.charset)
    if payload is None:  # as a plain area, which is the all-zero word
        return DecodeFailure(reason=Reason.NO_CONTENT, detail="no valid encodation", space=space)
    log_chance = hypotheses + log_sum([block.log_chance for block in blocks])
    return Decoded(
        payload=payload,
        space=space,
        errors_corrected=sum(block.changed for block in blocks),
        erasures=sum(block.erased for block in blocks),
        spare=min(block.spare for block in blocks),
        check=count * layout.code.n_check,
        unused_correction=min(block.unused for block in blocks),
        modules=modules,
        log10_chance=log_chance / math.log(10.0),
        confidence=confidence(log_chance, config.wrong_grids),
    )


@functools.lru_cache(maxsize=64)
def _said(codewords: bytes, version: str, charset: str | None) -> tuple[NDArray[np.int8], Payload | None]:
    """Return the exact symbol and what it says; one code gives the same in window after window."""
    modules = symbol_of(np.frombuffer(codewords, np.uint8), version)
    segments = Segments(structured_append=_structured_append(codewords))
    return closed(modules), content_of(modules, Symbology.DATA_MATRIX, charset=charset, segments=segments)


def _log_contents(n_check: int, words: Symbols) -> float:
    return math.log(256.0) * (len(words) - n_check)


def _structured_append(data: bytes) -> StructuredAppend | None:
    """Return which part of a message a symbol is, of its codewords."""
    index, count = data[1] >> 4, 17 - (data[1] & 15)
    if data[0] != STRUCTURED_APPEND or index >= count:
        return None
    return StructuredAppend(index=index, count=count, parity=256 * data[2] + data[3])
