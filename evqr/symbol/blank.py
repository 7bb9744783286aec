"""Where a grid shows no print: under a stain, in a glare, out of view.

There modules are all alike, and as sure as others: what their magnitudes do not tell, the lack of any edge
between them does.  In a symbol half of all neighbours differ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

REACH = 2
"""Modules around each that are looked at."""

USUAL = 0.25
"""Share of neighbours that differ from which on there is print: coins have it in all but a place of 1000."""


def printed_share(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Tell how much the surroundings of each module look like print.

    Parameters
    ----------
    q : (V, U) float64
        As of `evqr.symbol.decode.decode_grid`.

    Returns
    -------
    share : (V, U) float64
        1 where as many neighbours differ as in any symbol, 0 where all are alike.
    """
    dark = q < 0.0
    differ, pairs = np.zeros(q.shape, np.int32), np.zeros(q.shape, np.int32)
    differ[:, 1:] += dark[:, 1:] != dark[:, :-1]
    differ[1:] += dark[1:] != dark[:-1]
    pairs[:, 1:] += 1
    pairs[1:] += 1
    return np.minimum(1.0, _around(differ) / (USUAL * np.maximum(_around(pairs), 1)))


def _around(count: NDArray[np.int32]) -> NDArray[np.int32]:
    """Sum up squares of 2 REACH + 1 a side around each place."""
    side = 2 * REACH + 1
    total = np.pad(np.pad(count, REACH).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    return total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side]
