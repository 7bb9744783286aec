"""Aztec symbols (ISO/IEC 24778), compact or of full range: bull's eye, mode message, layers of codewords.

The mode message says how many of the codewords are data; the others are for error correction.  It is evidence
like the modules of the codewords: all that it may say is counted as a hypothesis.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from evqr.clock import one_time
from evqr.config import DecodeConfig
from evqr.reason import Reason
from evqr.symbol.aztec_tables import (
    FIELDS,
    TABLE,
    bulls_eye,
    function_patterns,
    mode_code,
    mode_places,
    mode_words,
    placement,
)
from evqr.symbol.chance import ORIENTATIONS, confidence
from evqr.symbol.content import content_of
from evqr.symbol.correct import Doubt, bits_of, correct_block, words_of
from evqr.symbol.decoded import Decoded, DecodeFailure, Effort
from evqr.symbol.format_words import likely_words
from evqr.symbol.payload import Payload
from evqr.symbol.reed_solomon import ReedSolomon, Symbols
from evqr.symbol.space import Anchor, CodeSpace, Landmark, Timing, closed
from evqr.symbology import Symbology

QUIET_ZONE = 0
SIZES: Mapping[str, tuple[int, int]] = MappingProxyType(
    {name: (size.side, size.side) for name, size in TABLE.items()}
)


_TINY = float(np.finfo(np.float64).tiny)

LEAST_MATCH = 0.6
"""Correlation of a mode message with the modules that it is read from, for it to be believed."""

CORES: Mapping[str, str] = MappingProxyType({"C": "C1", "F": "F1"})
"""Bull's eyes of compact symbols and those of full range, with the smallest symbols about them: all that is
known before the mode message tells size and direction."""


def anchors(version: str) -> tuple[Anchor, ...]:
    """Return the bull's eye of a version, in its middle."""
    middle = SIZES[CORES.get(version, version)][0] / 2.0
    return (Anchor(Landmark.BULLS_EYE, middle, middle),)


def timing(version: str) -> tuple[Timing, ...]:
    """Return the timing patterns that the search scores by: none."""
    return ()


@functools.cache
@one_time()
def space(version: str) -> CodeSpace:
    """Return the code space of a version, or of a core.

    Raises
    ------
    ValueError
        Not a version from C1 to C4 or F1 to F32, nor C or F.
    """
    if version in CORES:
        size = TABLE[CORES[version]]
        values = np.where(bulls_eye(size), function_patterns(size), np.int8(0))
        return replace(space(CORES[version]), version=version, known=values != 0, values=values)
    if version not in TABLE:
        raise ValueError(f"version must be one of {', '.join(TABLE)}, got {version}")
    values = function_patterns(TABLE[version])
    return CodeSpace(
        symbology=Symbology.AZTEC,
        version=version,
        known=values != 0,
        values=values,
        anchors=anchors(version),
        quiet_zone=QUIET_ZONE,
    )


_space = space  # where an argument has that name


@dataclass(frozen=True, eq=False, kw_only=True)
class Modes:
    """The mode messages of a version.

    Attributes
    ----------
    at : (k,) intp
        Flat module index of each of their bits.
    signs : (n, k) float64
        Of 1 to n data codewords: -1 dark, +1 light.
    """

    at: NDArray[np.intp]
    signs: NDArray[np.float64]


@functools.cache
@one_time()
def modes_of(version: str) -> Modes:
    """Return the mode messages of a version: those that leave codewords for error correction."""
    size = TABLE[version]
    return Modes(at=closed(mode_places(size)), signs=closed(mode_words(size)[: size.n_codewords - 1]))


def shown(q: NDArray[np.float64], space: CodeSpace) -> tuple[CodeSpace, NDArray[np.float64]] | None:
    """Return what the mode message in a grid says: which size the symbol has, and how it is turned.

    Bull's eyes look alike in all directions, and about one all compact symbols have the same modules known,
    those of full range nearly so.

    Parameters
    ----------
    q : (n, n) float64
        Modules about the bull's eye, in any direction.
    space : CodeSpace
        That they were taken for.

    Returns
    -------
    shown : (CodeSpace, (3, 3) float64), or None
        The code space, and a map of its code coordinates to those of ``space``; None: no message was read.
    """
    version = CORES[str(space.version)]
    compact = TABLE[version].compact
    at, code = modes_of(version).at, mode_code(TABLE[version])
    v, u = np.indices(q.shape)
    best, found = LEAST_MATCH, None
    for turn in range(8):
        grid, grid_u, grid_v = (np.rot90(each.T if turn > 3 else each, turn % 4) for each in (q, u, v))
        soft = grid.ravel()[at]
        doubtful = np.argsort(np.abs(soft).reshape(-1, 4).min(axis=1), kind="stable").tolist()
        tries = (code.correct(words_of(soft < 0.0, code), doubtful[:n_erased]) for n_erased in (0, 2))
        bits = next((bits_of(words, code) for words in tries if words is not None), None)
        if bits is None:
            continue
        match = float(np.where(bits, -soft, soft).sum()) / max(float(np.abs(soft).sum()), _TINY)
        if match > best:
            layers = 1 + int("".join("01"[bit] for bit in bits[: 2 if compact else 5].astype(int)), 2)
            along = [(each[0, 1] - each[0, 0], each[1, 0] - each[0, 0]) for each in (grid_u, grid_v)]
            best, found = match, (f"{version[0]}{layers}", along)
    if found is None:
        return None
    whole, to_found = _space(found[0]), np.eye(3)
    to_found[:2, :2] = found[1]
    to_found[:2, 2] = 0.5 * space.size - 0.5 * whole.size * to_found[:2, :2].sum(axis=1)
    return whole, to_found


def code_of(version: str, n_data: int) -> ReedSolomon:
    """Return what the codewords of a version are a word of, with so many of data."""
    size = TABLE[version]
    return ReedSolomon(polynomial=FIELDS[size.width], n_check=size.n_codewords - n_data, first_root=1)


def symbol_of(codewords: Symbols, version: str, n_data: int) -> NDArray[np.int8]:
    """Return the exact symbol, (n, n) int8, that carries all codewords, the first so many of them data."""
    size, modes = TABLE[version], modes_of(version)
    bits = bits_of(codewords, code_of(version, n_data))
    symbol = function_patterns(size).ravel()
    symbol[modes.at] = modes.signs[n_data - 1]
    at = placement(version)
    symbol[at] = 1
    symbol[at[-len(bits) :]] = np.where(bits, -1, 1)  # what is left over comes first, and is light
    return symbol.reshape(size.side, size.side)


def decode(
    q: NDArray[np.float64], space: CodeSpace, config: DecodeConfig, effort: Effort
) -> Decoded | DecodeFailure:
    """Decode with each of the likely mode messages until one gives a reading."""
    modes = modes_of(str(space.version))
    likely = likely_words(q.ravel()[modes.at], modes.signs, config)
    if isinstance(likely, str):
        return DecodeFailure(reason=Reason.FORMAT_UNREADABLE, detail=likely, space=space)
    outcomes = []
    for word in likely:
        outcome = _decode_mode(q, space, word + 1, config, effort)
        if isinstance(outcome, Decoded):
            return outcome
        outcomes.append(outcome)
    return outcomes[0]


def _decode_mode(
    q: NDArray[np.float64], space: CodeSpace, n_data: int, config: DecodeConfig, effort: Effort
) -> Decoded | DecodeFailure:
    version = str(space.version)
    size, modes, code = TABLE[version], modes_of(version), code_of(version, n_data)
    soft = q.ravel()[placement(version)[-size.width * size.n_codewords :]]
    hypotheses = math.log(ORIENTATIONS * len(modes.signs))
    result = correct_block(
        soft,
        code,
        functools.partial(_log_contents, n_data, size.width),
        log_limit=config.log_chance_limit - hypotheses,
        config=config,
        effort=effort,
        beside=q.ravel()[modes.at] * modes.signs[n_data - 1],
    )
    if isinstance(result, Doubt):
        detail = f"{result.detail} ({n_data} of data)"
        return DecodeFailure(reason=result.reason, detail=detail, space=space)
    modules, payload = _said(result.words.tobytes(), version, n_data, config.charset)
    if payload is None:
        return DecodeFailure(reason=Reason.NO_CONTENT, detail=f"{n_data} codewords of data", space=space)
    log_chance = hypotheses + result.log_chance
    return Decoded(
        payload=payload,
        space=space,
        errors_corrected=result.changed,
        erasures=result.erased,
        spare=result.spare,
        check=code.n_check,
        unused_correction=result.unused,
        modules=modules,
        log10_chance=log_chance / math.log(10.0),
        confidence=confidence(log_chance, config.wrong_grids),
    )


def _log_contents(n_data: int, width: int, words: Symbols) -> float:
    """Neither all bits 0 nor all bits 1 is a data codeword."""
    return n_data * math.log((1 << width) - 2)


@functools.lru_cache(maxsize=64)
def _said(
    codewords: bytes, version: str, n_data: int, charset: str | None
) -> tuple[NDArray[np.int8], Payload | None]:
    """Return the exact symbol and what it says; one code gives the same in window after window."""
    words = np.frombuffer(codewords, code_of(version, n_data).field.power.dtype)
    modules = symbol_of(words, version, n_data)
    return closed(modules), content_of(modules, Symbology.AZTEC, charset=charset)
