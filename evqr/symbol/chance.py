"""How likely a reading is mere chance: the argument behind the confidence of a reading.

The chance hypothesis: there is no code, so the signs of the estimated modules are fair coins, whatever their
magnitudes.  A Reed-Solomon block with k data codewords has 256^k valid contents.  The expected number of
contents that agree with such coins at least as well as the one that was read is

    F = 256^k P(sum_i w_i s_i >= sum_i w_i a_i),

with fair signs s_i, a_i = +1 where module i agrees with the content read and -1 where it does not, and
weights w_i that depend on magnitudes alone.  F bounds the probability that any decoder whatsoever, after any
number of attempts, finds so good a content by chance.  Chernoff's inequality bounds the tail,

    P <= min over lambda > 0 of  exp(-lambda sum_i w_i a_i)  prod_i cosh(lambda w_i),

for every lambda (so the minimum need not be exact).  When all n modules agree, P is 2^-n.

Symbols are rarely full: the pad codewords 0xEC and 0x11 fill a QR code in turn, and p pads leave 256^(k - p)
contents.  Half of the prior weight goes to blocks without pads and half, in equal parts, to the 2 k ways to
end in pads (how many, and which is last), so 2 min(256^k, 2 k 256^(k - p)) stands in place of 256^k.  Where
codewords have other widths, or a symbology has fewer contents, their number stands there.

Blocks are judged one by one: where all others are right beyond doubt, chance in one is a wrong text all the
same.  The sum of F over the blocks bounds the probability that at least one of them is chance.

What may be tried in a grid multiplies F: the orientations, and the formats.  Of a Micro QR code, a single
short block, the 15 modules of the format information are evidence as well: they are coins like the others,
the n words of the version multiply F, and its sums run over both kinds of modules.  Of the weakest, M1, 51
modules against 2 orientations, 4 words and 111,110 contents (one to five digits) leave 2^-31 = 4e-10 where
all agree, and more than is allowed where a single one does not.  A QR code's finder pattern, taken for a
Micro QR code's, does not come with coins but with format information of another kind; over its three finder
patterns, four rotations and two orientations together, that is a word of M1 about as often as one throw is
(tests/symbol/test_micro_qr.py).  QR codes' own format information does not count: a code that is taken for
one of another version has it right.

Windows that are read apart: where the coins are noise they are independent, and the chance of a content that
two of them show is below the product of their F.  Where they are print they are the same coins again, however
many windows show them; only F itself, of the sum of all windows, tells such a pattern from a symbol.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

ORIENTATIONS = 2
"""Of a grid: as it is, and mirrored.  Its rotations are the search's hypotheses, which the prior counts."""

PAD_CODEWORDS = (0xEC, 0x11)
_LN_256 = math.log(256.0)
_NEWTON_STEPS = 4


def log_chance(agreement: NDArray[np.floating], log_contents: float) -> float:
    """Return the natural logarithm of F.

    Parameters
    ----------
    agreement : (k,) float
        Weight of each module, times +1 where it agrees with the content, else -1.
    log_contents : float
        Natural logarithm of the number of contents.
    """
    return log_contents + log_tail(agreement)


def log_padded_contents(n_data: int, n_pads: int) -> float:
    """Return the natural logarithm of the number of contents of a block that may end in pads.

    Parameters
    ----------
    n_data : int
        Data codewords of the block, of eight bits.
    n_pads : int
        Pad codewords at their end.
    """
    contents = n_data * _LN_256
    if n_pads:
        contents = min(contents, math.log(2 * n_data) + (n_data - n_pads) * _LN_256)
    return math.log(2.0) + contents


def confidence(log_chance: float, wrong_grids: float) -> float:
    """Return the probability that a reading is right.

    Parameters
    ----------
    log_chance : float
        Natural logarithm of the number of contents expected to agree as well by chance, all hypotheses told.
    wrong_grids : float
        Grids without a code that are tried for each one with a code.
    """
    return 1.0 / (1.0 + wrong_grids * math.exp(log_chance))


def log_sum(log_chances: Sequence[float]) -> float:
    """Return the natural logarithm of the sum of F over blocks, of their logarithms."""
    least_sure = max(log_chances)
    return least_sure + math.log(sum(math.exp(each - least_sure) for each in log_chances))


def log_tail(agreement: NDArray[np.floating]) -> float:
    """Return the log of Chernoff's bound on the probability that fair signs bring as large a sum."""
    total = float(agreement.sum())
    weights = np.abs(agreement)
    most = float(weights.sum())
    if total <= 0.0:
        return 0.0
    if not (agreement < 0.0).any():
        return -math.log(2.0) * int(np.count_nonzero(weights))
    # Newton's method for the root of the derivative, which is concave: from its left, it never overshoots.
    rate = math.atanh(total / most) / float(weights.max())
    for _ in range(_NEWTON_STEPS):
        slope = np.tanh(rate * weights)
        gap = total - float((weights * slope).sum())
        rate += gap / float((weights**2 * (1.0 - slope**2)).sum())
    scaled = rate * weights
    log_cosh = scaled + np.log1p(np.exp(-2.0 * scaled)) - math.log(2.0)
    return min(0.0, float(log_cosh.sum()) - rate * total)


def count_pads(data: NDArray[np.uint8]) -> int:
    """Return how many codewords at the end of a block's data are pads, 0xEC and 0x11 in turn."""
    count, behind = 0, None
    for codeword in reversed(data.tolist()):
        if codeword not in PAD_CODEWORDS or codeword == behind:
            break
        count, behind = count + 1, codeword
    return count
