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
from evqr.search.triples import three_cornered

PATTERNS = 12
"""Finder patterns of a window that are taken two by two, the best."""

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


def codes_of_pairs(peaks: Sequence[NDArray[np.float32]], cfg: FinderConfig) -> list[Hypotheses]:
    """Give the codes that two finder patterns each could belong to: all sizes that fit, of each window.

    Parameters
    ----------
    peaks : sequence of (P, 5) float32
        Response, x, y, size of a module and angle, of each window, best first.
    cfg : FinderConfig
        Settings.

    Returns
    -------
    hypotheses : list of Hypotheses
        Of each window, the best by response first.  None depends on the other windows.
    """
    table = np.zeros((len(peaks), PATTERNS, 5))
    for row, some in zip(table, peaks, strict=True):
        row[: len(some)] = some[:PATTERNS]
    response, position, angle = table[..., 0], table[..., 1:3], table[..., 4]
    log_module = np.log(np.where(response == 0.0, np.nan, table[..., 3]))  # NaN agrees with nothing
    way = position[:, None] - position[:, :, None]  # (B, from, to, 2)
    length = np.hypot(way[..., 0], way[..., 1])
    heading = np.arctan2(way[..., 1], way[..., 0])
    alike = np.abs(log_module[:, None] - log_module[:, :, None]) <= cfg.scale_tolerance
    alike &= (response[:, None] * response[:, :, None] > 0.0) & (length > 0.0)
    log_leg = np.log(np.maximum(length, 1e-9)) - 0.5 * (log_module[:, None] + log_module[:, :, None])
    legs, sizes = three_cornered()
    found: list[tuple[NDArray[np.intp], ...]] = []
    for kind in range(len(WAYS)):
        diagonal = kind == 2
        turn = heading - 0.25 * math.pi * diagonal
        off = np.maximum(_off_axis(turn - angle[:, :, None]), _off_axis(turn - angle[:, None]))
        leg = log_leg - 0.5 * math.log(2.0) * diagonal
        near = np.abs(leg[..., None] - legs) <= cfg.scale_tolerance
        window, one, other, size = np.nonzero(near & (alike & (off <= cfg.angle_tolerance))[..., None])
        found.append((window, one, other, size, np.full(len(window), kind)))
    window, one, other, size, kind = map(np.concatenate, zip(*found, strict=True))
    strength = np.abs(response[window, one]) + np.abs(response[window, other])
    order = np.lexsort((-strength, window))
    window, one, other, size, kind = (each[order] for each in (window, one, other, size, kind))
    along = way[window, one, other]
    turned = np.stack([-along[:, 1], along[:, 0]], axis=1)
    u_along, u_turned, c_along, c_turned = WAYS[kind].T[..., None]
    u = u_along * along + u_turned * turned
    v = np.stack([-u[:, 1], u[:, 0]], axis=1)
    corner_u, corner_v, per_u, per_v, number = sizes[size].T[..., None]
    pose = np.zeros((len(window), 3, 3))
    pose[:, :2, 0], pose[:, :2, 1] = u * per_u, v * per_v
    corner = position[window, one] - c_along * along - c_turned * turned
    pose[:, :2, 2] = corner - corner_u * pose[:, :2, 0] - corner_v * pose[:, :2, 1]
    pose[:, 2, 2] = 1.0
    made = Hypotheses.of(
        number[:, 0].astype(np.intp), pose, np.stack([one, other, one], axis=1), response[window, one] < 0.0
    )
    ends = np.searchsorted(window, np.arange(len(peaks)), side="right").tolist()
    return [made[first:end] for first, end in pairwise([0, *ends])]


def _off_axis(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give how far angles are from the nearest axis of a square."""
    return np.abs((angle + 0.25 * math.pi) % (0.5 * math.pi) - 0.25 * math.pi)
