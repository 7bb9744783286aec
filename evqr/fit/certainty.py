"""How sure a module is: the probability that it is dark, from its estimate and what the window knows.

Estimates of modules are no probabilities: stage two pulls them to dark or light, the more so the less the
events say, and what noise is left depends on how the window was seen.  What tells how sure they are was
fitted to simulated passes of every sensor and symbology, and compared with others:

    ln P(right) / P(wrong) = exp(a + b ln i + c ln(u + 0.01)) s (1 + d s^e),   s = min(|q|, 1.2),

where i is the information of a module, the diagonal of the normal matrix in units of its noise, and u the
share of modules that are not clearly dark or light.  The larger scatter of what is left where a pattern in
the middle anchors all the code, and the smaller one where edges all around do, is in a.
`perf/calibration.py` fits, checks and draws it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from evqr.symbol.space import CodeSpace
from evqr.symbology import Symbology

CLEAR = 0.5
"""A module whose estimate is at least so far from grey is clearly dark or light."""

MOST = 1.2
"""Estimate from which on a module is not surer."""

LEVEL: Mapping[Symbology, float] = MappingProxyType(
    {
        Symbology.QR_CODE: -2.42,
        Symbology.MICRO_QR_CODE: -2.17,
        Symbology.RMQR_CODE: -2.19,
        Symbology.DATA_MATRIX: -1.95,
        Symbology.AZTEC: -2.54,
    }
)
"""The a above, as `python perf/calibration.py` fits it, like the others."""

OF_INFORMATION, OF_UNCLEAR = 0.724, -0.433
BEND, POWER = 1.516, 1.290


def unclear(q: NDArray[np.floating], space: CodeSpace) -> float:
    """Give the share of the modules that are not known before and not clearly dark or light.

    Parameters
    ----------
    q : (V, U) float
        Estimates of a code's modules.
    space : CodeSpace
        Which are known.

    Returns
    -------
    share : float
        0 to 1; 0 where all are known.
    """
    unknown = ~space.known
    return float((np.abs(q[unknown]) < CLEAR).mean()) if unknown.any() else 0.0


def log_odds(q: NDArray[np.floating], space: CodeSpace, information: float) -> NDArray[np.float64]:
    """Give how sure each module is.

    Parameters
    ----------
    q : (V, U) float
        Estimates of a code's modules, < 0 dark, > 0 light.
    space : CodeSpace
        Kind and size of the code.
    information : float
        Of the windows that they are from, as of `CodeEstimate`.

    Returns
    -------
    odds : (V, U) float64
        ln of the probability that it is light over that it is dark; infinite where it is known before.
    """
    level = LEVEL[space.symbology] + OF_UNCLEAR * math.log(unclear(q, space) + 0.01)
    factor = math.exp(level) * max(information, 1e-12) ** OF_INFORMATION
    strength = np.minimum(np.abs(q, dtype=np.float64), MOST)
    odds = np.copysign(factor * strength * (1.0 + BEND * strength**POWER), q)
    return np.where(space.known, np.copysign(np.inf, space.values), odds)


def dark(q: NDArray[np.floating], space: CodeSpace, information: float) -> NDArray[np.float32]:
    """Give the probability that each module is dark.

    Parameters
    ----------
    q : (V, U) float
        As of `log_odds`.
    space : CodeSpace
        As of `log_odds`.
    information : float
        As of `log_odds`.

    Returns
    -------
    probability : (V, U) float32
        0 to 1; 0.5 where nothing is known.
    """
    with np.errstate(over="ignore"):
        return (1.0 / (1.0 + np.exp(log_odds(q, space, information)))).astype(np.float32)
