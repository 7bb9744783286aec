"""Module grid -> payload: each symbology by its own decoder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from evqr.config import DecodeConfig
from evqr.symbol.decoded import Decoded, DecodeFailure, Effort
from evqr.symbol.space import CodeSpace
from evqr.symbol.symbols import SYMBOLS

DEFAULT = DecodeConfig()
"""Made once: checking the settings takes a third as long as reading a clean grid."""


def decode_grid(
    q: NDArray[np.floating],
    space: CodeSpace,
    *,
    config: DecodeConfig = DEFAULT,
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
    config : DecodeConfig
        How hard to try, and how sure to be.
    effort : {"quick", "full"}
        Few tries; or many, and the mirror image of square symbols too.

    Returns
    -------
    Decoded or DecodeFailure
        The reading when its confidence reaches ``config.min_confidence``.

    Raises
    ------
    ValueError
        The grid is not of the space's shape, or not finite.
    """
    q = np.asarray(q, dtype=np.float64)
    if q.shape != space.known.shape:
        raise ValueError(f"q must have shape {space.known.shape} for {space}, got {q.shape}")
    if not np.isfinite(q).all():
        raise ValueError("q must be finite, got NaN or infinity: write 0 for unknown modules")
    if effort not in ("quick", "full"):
        raise ValueError(f"effort must be 'quick' or 'full', got {effort!r}")
    symbol = SYMBOLS[space.symbology]
    if space.hidden is not None:  # what it says does not depend on which modules were seen
        space = symbol.space(space.version)
    outcome = symbol.decode(q, space, config, effort)
    if effort == "full" and isinstance(outcome, DecodeFailure) and space.rows == space.columns:
        mirrored = symbol.decode(symbol.mirror(q), space, config, effort)
        if isinstance(mirrored, Decoded):
            return replace(mirrored, mirrored=True, modules=symbol.mirror(mirrored.modules))
    return outcome


def are_valid(grids: Sequence[NDArray[np.floating]], spaces: Sequence[CodeSpace]) -> list[bool]:
    """Tell which grids have no error, so that decoding them takes no time; those of a space all at once.

    Parameters
    ----------
    grids : sequence of (V, U) float
        As of `decode_grid`.
    spaces : sequence of CodeSpace
        Kind and size of each.

    Returns
    -------
    valid : list of bool
        False also where it cannot be told at once.
    """
    valid = [False] * len(grids)
    of_space: dict[CodeSpace, list[int]] = {}
    for k, (q, space) in enumerate(zip(grids, spaces, strict=True)):
        if q.shape == space.known.shape:
            of_space.setdefault(space, []).append(k)
    for space, rows in of_space.items():
        of_rows = SYMBOLS[space.symbology].valid(np.array([grids[k] for k in rows], np.float64), space)
        for k, one in zip(rows, of_rows.tolist(), strict=True):
            valid[k] = one
    return valid
