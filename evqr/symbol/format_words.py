"""Which words of format information a grid may have, by soft correlation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evqr.config import DecodeConfig

_TINY = float(np.finfo(np.float64).tiny)


def likely_words(
    soft: NDArray[np.float64], signs: NDArray[np.float64], config: DecodeConfig
) -> list[int] | str:
    """Return the likely words, best first.

    Parameters
    ----------
    soft : (k,) float64
        Modules of the format information.
    signs : (n, k) float64
        Of all words: -1 dark, +1 light.
    config : DecodeConfig
        How many, and how likely.

    Returns
    -------
    words : list of int, or str
        At least one; or why none is, in words.
    """
    agreement = (signs * soft).sum(axis=1)
    correlation = agreement / max(float(np.abs(soft).sum()), _TINY)
    best = float(correlation.max())
    if best < config.format_floor:
        return f"its modules correlate {best:.2f} with the likeliest word, {config.format_floor:.2f} needed"
    likely = np.flatnonzero(correlation >= best - config.format_margin)
    return likely[np.argsort(-correlation[likely], kind="stable")][: config.format_candidates].tolist()
