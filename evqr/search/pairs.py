"""Symbols of whose three finder patterns two were found: the third is where a square asks for it.

A pattern may be covered, or move so that few of its edges cause events: then it is none of the best places of
a window, or its angle is off.  Two that agree with each other are sides of a symbol, or its diagonal; timing
and what is seen of the third tell.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from evqr.config import FinderConfig
from evqr.search.hypothesis import Hypotheses
from evqr.search.models import hidden_sizes
from evqr.search.triples import three_cornered

PATTERNS = 12
"""Finder patterns of a window that are taken two by two, the best."""

OFF = (-1.2, 0.0, 1.2)
"""How far the way between two patterns may be off: each is where it is to half a module or so [modules]."""

WAYS = np.array(
    [
        # the leg along u, times the way from one to the other: along it, and turned by a right angle
        (1.0, 0.0, 0.0, 0.0),
        (0.0, -1.0, 0.0, 0.0),
        # from the end of u to that of v; the corner is the leg before the first
        (-0.5, -0.5, -0.5, -0.5),
    ]
)
"""What two patterns may be: corner and u, corner and v, u and v.

The leg along u, and the way from the corner to the first of them, each in parts of the way between the two
and of that turned by a right angle."""


HIDDEN = np.array([2, 1, 0])
"""The third pattern of each."""


def codes_of_pairs(
    peaks: Sequence[NDArray[np.float32]], cfg: FinderConfig, *, hidden: bool = False
) -> list[Hypotheses]:
    """Give the codes that two finder patterns each could belong to: all sizes that fit, of each window.

    Parameters
    ----------
    peaks : sequence of (P, 5) float32
        Response, x, y, size of a module and angle, of each window, best first.
    cfg : FinderConfig
        Settings.
    hidden : bool
        Whether the third is not to be seen: stained, cut off by the border, not printed.  Default: it is
        there, but none of the peaks.

    Returns
    -------
    hypotheses : list of Hypotheses
        Of each window, the best by response first.  None depends on the other windows.
    """
    table = np.zeros((len(peaks), PATTERNS, 5))
    for row, some in zip(table, peaks, strict=True):
        row[: len(some)] = some[:PATTERNS]
    response = table[..., 0]
    log_module = np.log(np.where(response == 0.0, np.nan, table[..., 3]))  # NaN agrees with nothing
    alike = np.abs(log_module[:, None] - log_module[:, :, None]) <= 2.0 * cfg.scale_tolerance
    alike &= response[:, None] * response[:, :, None] > 0.0
    alike &= ~np.eye(PATTERNS, dtype=np.bool_)
    window, one, other = np.nonzero(alike)
    first, second = table[window, one], table[window, other]
    way = second[:, 1:3] - first[:, 1:3]
    heading = np.arctan2(way[:, 1], way[:, 0])
    # a symbol's side lies along the axes of its patterns, its diagonal between them
    side, diagonal = (
        np.maximum(_off_axis(turn - first[:, 4]), _off_axis(turn - second[:, 4])) <= cfg.angle_tolerance
        for turn in (heading, heading - 0.25 * math.pi)
    )
    pair, kind = np.nonzero(np.stack([side, side, diagonal], axis=1))
    log_way = np.log(np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-9))
    log_way -= 0.5 * np.log(first[:, 3] * second[:, 3])
    log_leg, place = three_cornered()
    around = (log_way[pair] - 0.5 * math.log(2.0) * (kind == 2))[:, None]
    begins, ends = np.searchsorted(log_leg, around + np.array([-1.0, 1.0]) * cfg.scale_tolerance).T
    counts = ends - begins
    # the strongest of each window first, each in its sizes, and each size in its lengths
    strength = np.abs(first[pair, 0]) + np.abs(second[pair, 0])
    order = np.lexsort((-strength, window[pair]))
    pair, kind, counts, ends = pair[order], kind[order], counts[order], ends[order]
    size = np.arange(counts.sum()) + (ends - counts.cumsum()).repeat(counts)
    pair, kind = pair.repeat(counts), kind.repeat(counts)
    pair, kind, size = (each.repeat(len(OFF)) for each in (pair, kind, size))
    corner_u, corner_v, per_u, per_v, number = place[size].T[..., None]
    along = way[pair] * (1.0 + np.resize(OFF, len(pair))[:, None] * per_u)
    turned = np.stack([-along[:, 1], along[:, 0]], axis=1)
    u_along, u_turned, c_along, c_turned = WAYS[kind].T[..., None]
    u = u_along * along + u_turned * turned
    v = np.stack([-u[:, 1], u[:, 0]], axis=1)
    pose = np.zeros((len(pair), 3, 3))
    pose[:, :2, 0], pose[:, :2, 1] = u * per_u, v * per_v
    middle = first[pair, 1:3] + 0.5 * way[pair]
    corner = middle - (c_along + 0.5) * along - c_turned * turned
    pose[:, :2, 2] = corner - corner_u * pose[:, :2, 0] - corner_v * pose[:, :2, 1]
    pose[:, 2, 2] = 1.0
    window, one, other = window[pair], one[pair], other[pair]
    number = number[:, 0].astype(np.intp)
    if hidden:
        number = hidden_sizes()[number, HIDDEN[kind]]
    made = Hypotheses.of(number, pose, np.stack([one, other, one], axis=1), response[window, one] < 0.0)
    ends = np.searchsorted(window, np.arange(len(peaks)), side="right").tolist()
    return [made[first:end] for first, end in pairwise([0, *ends])]


def _off_axis(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give how far angles are from the nearest axis of a square."""
    return np.abs((angle + 0.25 * math.pi) % (0.5 * math.pi) - 0.25 * math.pi)
