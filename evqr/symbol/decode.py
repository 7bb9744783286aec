"""Module grid -> payload: format information, Reed-Solomon with erasures, and the proof that it is no chance.

Format information by soft correlation; unmask and deinterleave; correct each block, erasing ever more of its
least reliable codewords; judge the result (`evqr.symbol.chance`); rebuild the exact symbol; zxing-cpp for the
text.

Reed-Solomon comes before zxing-cpp because zxing-cpp corrects up to the last check codeword: one chance grid
in two million of version 1-L passes.  Given the exact symbol it has nothing left to correct, and interprets
modes, ECI, kanji and the rest.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import zxingcpp
from numpy.typing import NDArray

from evqr.config import DecodeConfig
from evqr.reason import Reason
from evqr.symbol.chance import count_pads, log_chance_contents
from evqr.symbol.qr_codewords import Block, ErrorLevel, codeword_layout, format_words, symbol_of, unmasked
from evqr.symbol.space import CodeSpace, Symbology, Version

Effort = Literal["quick", "full"]

_QR_CODE = zxingcpp.barcode_formats_from_str("QRCode")

# In units of a block's mean |q|, measured on symbols with even and with patchy Gaussian noise.  A module
# stronger than the cap counts no more than the cap: where it is wrong, it is dirt rather than noise.
_WEIGHT_CAP = 2.0
_LOG_ODDS = 4.0
_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, eq=False, kw_only=True)
class Decoded:
    """A symbol, read.

    Attributes
    ----------
    text : str
        The payload.
    data : bytes
        The payload, as it is in the symbol.
    space : CodeSpace
        Kind and size of the symbol.
    ec_level : str, optional
        "L", "M", "Q" or "H"; None where the symbology has no levels.
    mask : int, optional
        Number of the mask; None where the symbology has none.
    mirrored : bool
        The grid was the transpose of the symbol.
    errors_corrected : int
        Codewords that error correction changed, erased ones included.
    erasures : int
        Codewords that were erased.
    spare : int
        Unused check codewords, n_check - 2 errors - erasures: the least over the blocks.
    modules : (V, U) int8
        The exact symbol, in the orientation of the grid: -1 dark, +1 light.
    log10_chance : float
        Decimal logarithm of the number of contents expected to agree as well by chance.
    confidence : float
        1 / (1 + wrong_grids 10^log10_chance): that the text is right, 0 to 1.
    """

    text: str
    data: bytes
    space: CodeSpace
    ec_level: ErrorLevel | None
    mask: int | None
    mirrored: bool
    errors_corrected: int
    erasures: int
    spare: int
    modules: NDArray[np.int8]
    log10_chance: float
    confidence: float

    @property
    def symbology(self) -> Symbology:
        """Kind of the symbol."""
        return self.space.symbology

    @property
    def version(self) -> Version:
        """Size of the symbol: an int for QR codes, text for others."""
        return self.space.version


@dataclass(frozen=True, kw_only=True)
class DecodeFailure:
    """A grid that does not decode.

    Attributes
    ----------
    reason : Reason
        Why.
    detail : str
        What it was in this case; empty where the reason says it all.
    space : CodeSpace
        What was taken for granted of the grid.
    ec_level : str, optional
        Of the most likely format; None where it is unreadable, or there are no levels.
    mask : int, optional
        Of the most likely format; None where it is unreadable, or there are no masks.
    """

    reason: Reason
    detail: str
    space: CodeSpace
    ec_level: ErrorLevel | None = None
    mask: int | None = None

    def __str__(self) -> str:
        return self.reason.explained(self.detail)


@dataclass(frozen=True, eq=False, kw_only=True)
class _CorrectedBlock:
    codewords: NDArray[np.uint8]
    n_pads: int
    changed: int
    erased: int
    spare: int
    log_chance: float


def decode_grid(
    q: NDArray[np.floating],
    space: CodeSpace,
    *,
    config: DecodeConfig | None = None,
    effort: Effort = "quick",
) -> Decoded | DecodeFailure:
    """Decode an estimated module grid.

    Parameters
    ----------
    q : (V, U) float
        Below 0 dark, above 0 light, 0 unknown; the magnitude is the reliability, in any unit.  Known modules
        are not looked at.
    space : CodeSpace
        Kind and size of the symbol.
    config : DecodeConfig, optional
        Thresholds.
    effort : {"quick", "full"}
        Few tries; or many, and the transpose too (mirrored symbols).

    Returns
    -------
    Decoded or DecodeFailure
        The reading when its confidence reaches ``config.min_confidence``.

    Raises
    ------
    ValueError
        The grid is not of the space's shape, or not finite.
    """
    config = config or DecodeConfig()
    q = np.asarray(q, dtype=np.float64)
    if q.shape != space.known.shape:
        raise ValueError(f"q must have shape {space.known.shape} for {space}, got {q.shape}")
    if not np.isfinite(q).all():
        raise ValueError("q must be finite, got NaN or infinity: write 0 for unknown modules")
    if effort not in ("quick", "full"):
        raise ValueError(f"effort must be 'quick' or 'full', got {effort!r}")
    outcome = _decode_oriented(q, space, config, effort, mirrored=False)
    if effort == "full" and isinstance(outcome, DecodeFailure):
        mirrored = _decode_oriented(q.T, space, config, effort, mirrored=True)
        if isinstance(mirrored, Decoded):
            return mirrored
    return outcome


def _decode_oriented(
    q: NDArray[np.float64], space: CodeSpace, config: DecodeConfig, effort: Effort, *, mirrored: bool
) -> Decoded | DecodeFailure:
    """Decode with each of the likely formats until one gives a reading."""
    words = format_words(space.version)
    soft = q.ravel()[words.at]
    correlation = ((words.signs @ soft) / max(float(np.abs(soft).sum()), _TINY)).tolist()
    best = max(correlation)
    if best < config.format_floor:
        detail = f"its modules correlate {best:.2f} with the likeliest word, {config.format_floor:.2f} needed"
        return DecodeFailure(reason=Reason.FORMAT_UNREADABLE, detail=detail, space=space)

    likely = [k for k, value in enumerate(correlation) if value >= best - config.format_margin]
    likely.sort(key=lambda k: -correlation[k])
    outcomes = []
    for index in likely[: config.format_candidates]:
        level, mask = words.meaning[index]
        outcome = _decode_format(q, space, level, mask, config, effort, mirrored=mirrored)
        if isinstance(outcome, Decoded):
            return outcome
        outcomes.append(outcome)
    return outcomes[0]


def _decode_format(
    q: NDArray[np.float64],
    space: CodeSpace,
    level: ErrorLevel | None,
    mask: int,
    config: DecodeConfig,
    effort: Effort,
    *,
    mirrored: bool,
) -> Decoded | DecodeFailure:
    """Decode with known level and mask: correct every block, judge, rebuild the symbol, interpret it."""
    layout = codeword_layout(space.version, level)
    soft = unmasked(q, space.version, level, mask)
    # Every format and orientation that might be tried is one more opportunity for chance.
    hypotheses = math.log(2 * config.format_candidates)
    log_limit = config.log_chance_limit - hypotheses - math.log(len(layout.blocks))

    def failed(reason: Reason, detail: str) -> DecodeFailure:
        return DecodeFailure(reason=reason, detail=detail, space=space, ec_level=level, mask=mask)

    codewords = np.packbits(soft < 0.0)
    blocks = []
    padding = True  # pads fill the end of the data, so blocks come last first
    for index in reversed(range(len(layout.blocks))):
        block = layout.blocks[index]
        result = _correct_block(
            soft[block.bits], block, _tries(block.n_check, config, effort), padding, log_limit
        )
        if isinstance(result, tuple):
            reason, detail = result
            place = f"level {level}, mask {mask}, block {index + 1} of {len(layout.blocks)}"
            return failed(reason, f"{detail} ({place})")
        blocks.append(result)
        codewords[block.codewords] = result.codewords
        padding = padding and result.n_pads == block.n_data

    modules = symbol_of(codewords, space.version, level, mask)
    barcode = zxingcpp.read_barcode(
        ~modules.view(np.uint8),  # 0 and 254
        formats=_QR_CODE,
        text_mode=zxingcpp.TextMode.Plain,
        is_pure=True,
        try_rotate=False,
        try_invert=False,
        try_downscale=False,
    )
    # A texture that equals a mask (stripes, checks) is the all-zero word: valid, and empty.
    if barcode is None or not barcode.valid or not barcode.bytes:
        return failed(Reason.NO_CONTENT, f"level {level}, mask {mask}")

    least_sure = max(block.log_chance for block in blocks)
    log_chance = hypotheses + least_sure + math.log(sum(math.exp(b.log_chance - least_sure) for b in blocks))
    return Decoded(
        text=barcode.text,
        data=barcode.bytes,
        space=space,
        ec_level=level,
        mask=mask,
        mirrored=mirrored,
        errors_corrected=sum(b.changed for b in blocks),
        erasures=sum(b.erased for b in blocks),
        spare=min(b.spare for b in blocks),
        modules=modules.T if mirrored else modules,
        log10_chance=log_chance / math.log(10.0),
        confidence=1.0 / (1.0 + config.wrong_grids * math.exp(log_chance)),
    )


def _correct_block(
    soft: NDArray[np.float64], block: Block, tries: list[int], padding: bool, log_limit: float
) -> _CorrectedBlock | tuple[Reason, str]:
    """Correct one block with ever more erasures, until the result is beyond chance; else tell the reason.

    Parameters
    ----------
    soft : (8 n,) float   the unmasked modules of its bits
    tries                 numbers of codewords to erase
    padding               all blocks behind it are pads, so it may end in pads
    log_limit             natural logarithm of the largest acceptable number of chance contents
    """
    received = np.packbits(soft < 0.0)
    syndromes = block.code.syndromes(received)
    strength = np.abs(soft)
    strength /= max(float(strength.sum()) / len(soft), _TINY)
    weights = np.minimum(strength, _WEIGHT_CAP)

    least = math.inf
    doubtful: list[int] = []
    for n_erased in tries:
        if n_erased and not doubtful:
            doubtful = _doubtful(strength)
        codewords = block.code.correct(received, doubtful[:n_erased], syndromes=syndromes)
        if codewords is None:
            continue
        n_pads = count_pads(codewords[: block.n_data]) if padding else 0
        agreement = np.where((soft < 0.0) == np.unpackbits(codewords), weights, -weights)
        log_chance = log_chance_contents(agreement, block.n_data, n_pads)
        if log_chance <= log_limit:
            changed = set(np.flatnonzero(codewords != received).tolist())
            n_errors = len(changed.difference(doubtful[:n_erased]))
            return _CorrectedBlock(
                codewords=codewords,
                n_pads=n_pads,
                changed=len(changed),
                erased=n_erased,
                spare=block.n_check - n_erased - 2 * n_errors,
                log_chance=log_chance,
            )
        least = min(least, log_chance)
    if least < 0.0:
        chance, limit = least / math.log(10.0), log_limit / math.log(10.0)
        detail = f"10^{chance:.1f} contents would agree as well, 10^{limit:.1f} allowed"
        return Reason.POSSIBLY_CHANCE, detail
    detail = f"too many of {len(received)} codewords wrong for {block.n_check} check codewords"
    return Reason.TOO_MANY_ERRORS, detail


def _doubtful(strength: NDArray[np.float64]) -> list[int]:
    """Return the codewords, the least certain first."""
    # Log probability that all eight bits of a codeword are right, with Gaussian noise of typical strength.
    log_right = -np.logaddexp(0.0, -_LOG_ODDS * strength).reshape(-1, 8).sum(1)
    return np.argsort(log_right, kind="stable").tolist()


@functools.cache
def _tries(n_check: int, config: DecodeConfig, effort: Effort) -> list[int]:
    """Return the numbers of codewords to erase, in turn.

    Besides none, as many as leave an even number of check codewords: one error takes two of them.
    """
    tries = sorted({0, *range(n_check % 2, n_check - config.min_check + 1, 2)})
    if effort == "full":
        return tries
    chosen = np.linspace(0, len(tries) - 1, num=config.quick_tries).round().astype(int)
    return [tries[i] for i in sorted(set(chosen.tolist()))]
