"""One Reed-Solomon block of soft bits, its least reliable words erased until the result is beyond chance.

The judge is `evqr.symbol.chance`: a corrected block counts when fewer contents than allowed would be expected
to agree with its modules as well by chance.
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
from evqr.symbol.chance import log_chance
from evqr.symbol.decoded import Effort
from evqr.symbol.reed_solomon import ReedSolomon, Symbols

# In units of a block's mean |q|, measured on symbols with even and with patchy Gaussian noise.  A module
# stronger than the cap counts no more than the cap: where it is wrong, it is dirt rather than noise.
_WEIGHT_CAP = 2.0
_LOG_ODDS = 4.0
_FULL_TRIES = 34
"""Tries with effort "full", at most: all that there are up to 68 check words, the most that a block of a QR
code or a Data Matrix symbol has."""

_MANY_CHECK = 100
"""Check words from which on tries get fewer."""

_SURELY_LARGER = 16
"""Bits of further check words that are no coincidence."""

_FORMAT_WRONG = 2
"""Modules of format information that may be wrong where a single further check word may be a coincidence."""

_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, eq=False, kw_only=True)
class Corrected:
    """A block that is right beyond chance.

    Attributes
    ----------
    words : (n,) uint8 or uint16
        Data and check words.
    changed : int
        Words that differ from those received.
    erased : int
        Words that were erased.
    spare : int
        Check words that were not needed.
    unused : float
        Share of the check words that the cheaper way would have left: one for each word that was known to be
        wrong, as erased ones are, or two for each that was wrong.
    log_chance : float
        Natural logarithm of the number of contents expected to agree as well by chance.
    """

    words: Symbols
    changed: int
    erased: int
    spare: int
    unused: float
    log_chance: float


@dataclass(frozen=True, kw_only=True)
class Doubt:
    """Why a block could not be corrected.

    Attributes
    ----------
    reason : Reason
        Why.
    detail : str
        What it was in this case.
    """

    reason: Reason
    detail: str


def words_of(dark: NDArray[np.bool_], code: ReedSolomon) -> Symbols:
    """Return bits, most significant first, as words (n,) of a code: uint8 or uint16."""
    width = code.width
    if width == 8:
        return np.packbits(dark)
    return (dark.reshape(-1, width) << np.arange(width)[::-1]).sum(axis=1, dtype=code.field.power.dtype)


def bits_of(words: Symbols, code: ReedSolomon) -> NDArray[np.bool_]:
    """Return the bits of words of a code, most significant first."""
    width = code.width
    if width == 8:
        return np.unpackbits(words).view(np.bool_)
    return (words[:, None] >> np.arange(width)[::-1] & 1).astype(np.bool_).ravel()


def correct_block(
    soft: NDArray[np.float64],
    code: ReedSolomon,
    log_contents: Callable[[Symbols], float],
    *,
    log_limit: float,
    config: DecodeConfig,
    effort: Effort,
    printed: NDArray[np.bool_] | None = None,
    beside: NDArray[np.float64] | None = None,
    received: Symbols | None = None,
    syndromes: Symbols | None = None,
    trust: Callable[[], NDArray[np.float64]] | None = None,
) -> Corrected | Doubt:
    """Correct one block.

    Parameters
    ----------
    soft : (width n,) float64
        Modules of its bits, the mask undone, most significant bit first: below 0 for a 1, above 0 for a 0.
    code : ReedSolomon
        What the block is a word of.
    log_contents : callable
        Gives the natural logarithm of the number of contents that a corrected block might as well have had.
    log_limit : float
        Natural logarithm of the largest acceptable number of chance contents.
    config : DecodeConfig
        How hard to try.
    effort : {"quick", "full"}
        Few numbers of erasures, or all.
    printed : (width n,) bool, optional
        Bits that have a module; the others are 0 in every symbol, and 0 in ``soft``.  Default all.
    beside : (k,) float64, optional
        Further modules that a chance content would have to agree with, times +1 where they do, else -1.
    received, syndromes : (n,) and (n_check,) uint8 or uint16, optional
        The block's words as they are, and their syndromes, where they are known already.
    trust : callable, optional
        Gives factors (width n,) on how certain bits are, 0 to 1, for the order in which words are erased;
        they may come from signs as well, for the chance of a result does not depend on that order.

    Returns
    -------
    Corrected or Doubt
        The first result beyond chance, or why there is none.
    """
    ones = soft < 0.0
    if received is None:
        received = words_of(ones, code)
    if syndromes is None:
        syndromes = code.syndromes(received)
    if not syndromes.any() and (beside is None or not (beside < 0.0).any()):
        # nothing is wrong: each module that says anything is a coin that agrees, whatever its strength
        coins = int(np.count_nonzero(soft) + (0 if beside is None else np.count_nonzero(beside)))
        chance = log_contents(received) - math.log(2.0) * coins
        if chance <= log_limit and not _is_of_larger_code(received, code, beside):
            return Corrected(
                words=received, changed=0, erased=0, spare=code.n_check, unused=1.0, log_chance=chance
            )
    strength = np.abs(soft)
    scale = _mean(strength if beside is None else np.concatenate([strength, np.abs(beside)]))
    strength /= scale
    weights = np.minimum(strength, _WEIGHT_CAP)
    others = None if beside is None else np.clip(beside / scale, -_WEIGHT_CAP, _WEIGHT_CAP)

    least = math.inf
    doubtful: list[int] = []
    for n_erased in _tries(code.n_check, config, effort):
        if n_erased and not doubtful:
            certain = strength if trust is None else strength * trust()
            doubtful = _doubtful(certain, printed, code.width)
        words = code.correct(received, doubtful[:n_erased], syndromes=syndromes)
        if words is None:
            continue
        bits = bits_of(words, code)
        if printed is not None and bits[~printed].any():
            continue
        if _is_of_larger_code(words, code, beside):
            detail = f"more of {len(received)} codewords are check codewords than {code.n_check}"
            return Doubt(reason=Reason.POSSIBLY_CHANCE, detail=detail)
        agreement = np.where(ones == bits, weights, -weights)
        if others is not None:
            agreement = np.concatenate([agreement, others])
        chance = log_chance(agreement, log_contents(words))
        if chance <= log_limit:
            changed = set(np.flatnonzero(words != received).tolist())
            n_errors = len(changed.difference(doubtful[:n_erased]))
            spare = code.n_check - n_erased - 2 * n_errors
            return Corrected(
                words=words,
                changed=len(changed),
                erased=n_erased,
                spare=spare,
                unused=max(spare, code.n_check - 2 * len(changed)) / code.n_check,
                log_chance=chance,
            )
        least = min(least, chance)
    if least < 0.0:
        chance, limit = least / math.log(10.0), log_limit / math.log(10.0)
        detail = f"10^{chance:.1f} contents would agree as well, 10^{limit:.1f} allowed"
        return Doubt(reason=Reason.POSSIBLY_CHANCE, detail=detail)
    detail = f"too many of {len(received)} codewords wrong for {code.n_check} check codewords"
    return Doubt(reason=Reason.TOO_MANY_ERRORS, detail=detail)


def _is_of_larger_code(words: Symbols, code: ReedSolomon, beside: NDArray[np.float64] | None) -> bool:
    """Tell whether more words are check words than the format information says: it was misread.

    A word of a code is also one of each smaller code, whose roots are some of its own, and it would be read
    with its check words as data.
    """
    further = code.further_roots(words) if words.any() else 0
    if further * code.width >= _SURELY_LARGER:
        return True
    return further > 0 and beside is not None and int((beside < 0.0).sum()) > _FORMAT_WRONG


def _mean(strength: NDArray[np.float64]) -> float:
    return max(float(strength.sum()) / len(strength), _TINY)


def _doubtful(strength: NDArray[np.float64], printed: NDArray[np.bool_] | None, width: int) -> list[int]:
    """Return the words, the least certain first."""
    # Log probability that all bits of a word are right, with Gaussian noise of typical strength.
    log_right = -np.logaddexp(0.0, -_LOG_ODDS * strength)
    if printed is not None:
        log_right *= printed
    return np.argsort(log_right.reshape(-1, width).sum(1), kind="stable").tolist()


@functools.cache
def _tries(n_check: int, config: DecodeConfig, effort: Effort) -> list[int]:
    """Return the numbers of words to erase, in turn.

    Besides none, as many as leave an even number of check words: one error takes two of them.
    """
    tries = sorted({0, *range(n_check % 2, n_check - config.min_check + 1, 2)})
    # what a try costs grows with the square of the check words
    most = _FULL_TRIES if effort == "full" else config.quick_tries
    most = max(1, min(most, _FULL_TRIES * _MANY_CHECK**2 // n_check**2))
    if most >= len(tries):
        return tries
    chosen = np.linspace(0, len(tries) - 1, num=most).round().astype(int)
    return [tries[i] for i in sorted(set(chosen.tolist()))]
