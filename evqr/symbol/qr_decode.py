"""The grid of a QR or Micro QR code -> its payload.

Format information by soft correlation; unmask and deinterleave; correct each block; rebuild the exact symbol;
read it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.config import DecodeConfig
from evqr.reason import Reason
from evqr.symbol.blank import printed_share
from evqr.symbol.chance import ORIENTATIONS, confidence, count_pads, log_sum
from evqr.symbol.content import content_of
from evqr.symbol.correct import Corrected, Doubt, correct_block
from evqr.symbol.decoded import Decoded, DecodeFailure, Effort
from evqr.symbol.format_words import likely_words
from evqr.symbol.payload import Payload
from evqr.symbol.qr_codewords import (
    ErrorLevel,
    codeword_layout,
    format_words,
    symbol_of,
    unmasked,
)
from evqr.symbol.qr_segments import segments_of
from evqr.symbol.reed_solomon import Symbols
from evqr.symbol.space import CodeSpace, closed


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """How the readings of a symbology are judged.

    Attributes
    ----------
    log_contents : callable
        Natural logarithm of the number of contents that a block might as well have had, of its data codewords
        and of whether it may end in pads, because all blocks behind it are pads.
    format_counts : bool
        The modules of the format information are evidence like those of the codewords; for symbols of one
        block.
    """

    log_contents: Callable[[Symbols, bool], float]
    format_counts: bool = False


@dataclass(frozen=True, kw_only=True)
class _Format:
    """A word of format information.

    Attributes
    ----------
    index : int
        Its number among those of the version.
    level : str, optional
        Level of error correction that it says.
    mask : int
        Mask that it says.
    """

    index: int
    level: ErrorLevel | None
    mask: int


def decode_words(
    q: NDArray[np.float64], space: CodeSpace, config: DecodeConfig, effort: Effort, evidence: Evidence
) -> Decoded | DecodeFailure:
    """Decode with each of the likely formats until one gives a reading.

    Parameters
    ----------
    q : (r, r) float64
        As of `evqr.symbol.decode.decode_grid`.
    space : CodeSpace
        Of a QR or Micro QR code.
    config : DecodeConfig
        How hard to try, and how sure to be.
    effort : {"quick", "full"}
        Few numbers of erasures, or all.
    evidence : Evidence
        How to judge.

    Returns
    -------
    Decoded or DecodeFailure
        The first reading beyond chance, or why the likeliest format gave none.
    """
    words = format_words(space.version)
    likely = likely_words(q.ravel()[words.at], words.signs, config)
    if isinstance(likely, str):
        return DecodeFailure(reason=Reason.FORMAT_UNREADABLE, detail=likely, space=space)
    outcomes = []
    for index in likely:
        level, mask = words.meaning[index]
        form = _Format(index=index, level=level, mask=mask)
        outcome = _decode_format(q, space, form, config, effort, evidence)
        if isinstance(outcome, Decoded):
            return outcome
        outcomes.append(outcome)
    return outcomes[0]


def valid_words(q: NDArray[np.float64], space: CodeSpace) -> NDArray[np.bool_]:
    """Tell in which of some grids no codeword is wrong: where their syndromes are 0, all at once.

    Parameters
    ----------
    q : (B, V, U) float64
        As of `evqr.symbol.decode.decode_grid`.
    space : CodeSpace
        Of a QR, Micro QR or rMQR code.

    Returns
    -------
    (B,) bool
        With the likeliest level and mask of each.
    """
    words, valid = format_words(space.version), np.zeros(len(q), np.bool_)
    likeliest = np.einsum("bk,wk->bw", q.reshape(len(q), -1)[:, words.at], words.signs).argmax(axis=1)
    for index in sorted(set(likeliest.tolist())):
        level, mask = words.meaning[index]
        rows = np.flatnonzero(likeliest == index)
        codewords = np.packbits(unmasked(q[rows], space.version, level, mask) < 0.0, axis=-1)
        valid[rows] = codeword_layout(space.version, level).valid(codewords)
    return valid


def _decode_format(
    q: NDArray[np.float64],
    space: CodeSpace,
    form: _Format,
    config: DecodeConfig,
    effort: Effort,
    evidence: Evidence,
) -> Decoded | DecodeFailure:
    """Decode with known level and mask: correct every block, judge, rebuild the symbol, read it."""
    version, level, mask = space.version, form.level, form.mask
    layout, words = codeword_layout(version, level), format_words(version)
    soft = unmasked(q, version, level, mask)
    # Every format and orientation that might be tried is one more opportunity for chance.  Where format
    # information is evidence, all its words are: that the likeliest were chosen is then part of the bound.
    formats = len(words.meaning) if evidence.format_counts else config.format_candidates
    hypotheses = math.log(ORIENTATIONS * formats)
    beside = q.ravel()[words.at] * words.signs[form.index] if evidence.format_counts else None

    def trust() -> NDArray[np.float64]:
        return np.abs(unmasked(printed_share(q), version, level, mask))

    def failed(reason: Reason, detail: str) -> DecodeFailure:
        return DecodeFailure(reason=reason, detail=detail, space=space, ec_level=level, mask=mask)

    codewords = np.packbits(soft < 0.0)
    syndromes = layout.syndromes(codewords)
    blocks: list[Corrected] = []
    padding = True  # pads fill the end of the data, so blocks come last first
    for index in reversed(range(len(layout.blocks))):
        block = layout.blocks[index]
        result = correct_block(
            soft[block.bits],
            block.code,
            functools.partial(_log_contents, evidence, block.n_data, padding),
            log_limit=config.log_chance_limit - hypotheses - math.log(len(layout.blocks)),
            config=config,
            effort=effort,
            printed=layout.printed,
            beside=beside,
            received=codewords[block.codewords],
            syndromes=syndromes[index],
            trust=lambda block=block: trust()[block.bits],
        )
        if isinstance(result, Doubt):
            place = f"{_named(form)}, block {index + 1} of {len(layout.blocks)}"
            return failed(result.reason, f"{result.detail} ({place})")
        blocks.append(result)
        if result.changed:
            codewords[block.codewords] = result.words
        padding = padding and count_pads(result.words[: block.n_data]) == block.n_data

    modules, payload = _said(codewords.tobytes(), space, level, mask, config.charset)
    # A texture that equals a mask (stripes, checks) is the all-zero word: valid, and empty.
    if payload is None:
        return failed(Reason.NO_CONTENT, _named(form))
    log_chance = hypotheses + log_sum([block.log_chance for block in blocks])
    return Decoded(
        payload=payload,
        space=space,
        ec_level=level,
        mask=mask,
        errors_corrected=sum(b.changed for b in blocks),
        erasures=sum(b.erased for b in blocks),
        spare=min(b.spare for b in blocks),
        check=sum(block.n_check for block in layout.blocks),
        unused_correction=min(b.unused for b in blocks),
        modules=modules,
        log10_chance=log_chance / math.log(10.0),
        confidence=confidence(log_chance, config.wrong_grids),
    )


@functools.lru_cache(maxsize=64)
def _said(
    codewords: bytes, space: CodeSpace, level: ErrorLevel | None, mask: int, charset: str | None
) -> tuple[NDArray[np.int8], Payload | None]:
    """Return the exact symbol and what it says; one code gives the same in window after window."""
    layout = codeword_layout(space.version, level)
    modules = symbol_of(np.frombuffer(codewords, np.uint8), space.version, level, mask)
    stream = b"".join(codewords[block.codewords][: block.n_data] for block in layout.blocks)
    segments = segments_of(stream, space.version)
    return closed(modules), content_of(modules, space.symbology, charset=charset, segments=segments)


def _log_contents(evidence: Evidence, n_data: int, padding: bool, words: Symbols) -> float:
    return evidence.log_contents(words[:n_data], padding)


def _named(form: _Format) -> str:
    return f"mask {form.mask}" if form.level is None else f"level {form.level}, mask {form.mask}"
