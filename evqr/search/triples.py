"""Symbols with finder patterns at three of their corners: QR codes."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from evqr.config import FinderConfig
from evqr.search.hypothesis import Hypotheses
from evqr.search.models import sizes


@functools.cache
def _three_cornered() -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """Sizes with three finder patterns, the shortest leg first: index, log of the leg, and where (N, 2, 3).

    Where: of the finder pattern at the corner along u and v, then one over the leg along u and along v.
    """
    found = []
    for k, size in enumerate(sizes()):
        if len(size.anchors) == 3:
            corner, along, down = size.anchors
            leg_u, leg_v = along.u - corner.u, down.v - corner.v
            found.append((math.log(leg_u), k, corner.u, corner.v, 1.0 / leg_u, 1.0 / leg_v))
    table = np.array(sorted(found))
    return table[:, 1].astype(np.intp), table[:, 0], table[:, 2:]


def leg_tolerances(cfg: FinderConfig) -> NDArray[np.float32]:
    """Give what must agree in a triple, as `match_corners` takes it."""
    _, log_leg, _ = _three_cornered()
    tolerances = cfg.leg_tolerance, cfg.scale_tolerance, cfg.angle_tolerance
    return np.array([*tolerances, log_leg[0], log_leg[-1]], np.float32)


def codes_of_triples(
    peaks: NDArray[np.float32], triples: NDArray[np.float32], cfg: FinderConfig
) -> Hypotheses:
    """Give the codes that triples of finder patterns could be the corners of: all sizes that fit.

    Parameters
    ----------
    peaks : (P, 5) float32
        Response, x, y, size of a module and angle.
    triples : (N, 5) float32
        As of `Found`.
    cfg : FinderConfig
        Settings.

    Returns
    -------
    hypotheses : Hypotheses
        In the order of the triples, those of one from the smallest size on.
    """
    size, log_leg, place = _three_cornered()
    ends = np.searchsorted(log_leg, triples[:, 4:5] + np.array([-1.0, 1.0]) * cfg.scale_tolerance)
    counts = ends[:, 1] - ends[:, 0]
    triple = np.repeat(np.arange(len(triples)), counts)
    first = np.cumsum(counts) - counts
    which = ends[triple, 0] + np.arange(len(triple)) - first[triple]
    corners = triples[triple, 1:4].astype(np.intp)
    at = peaks[corners, 1:3].astype(np.float64)  # (N, 3, 2)
    u, v, per_u, per_v = place[which].T[..., None]
    pose = np.zeros((len(triple), 3, 3))
    pose[:, :2, 0] = (at[:, 1] - at[:, 0]) * per_u
    pose[:, :2, 1] = (at[:, 2] - at[:, 0]) * per_v
    pose[:, :2, 2] = at[:, 0] - u * pose[:, :2, 0] - v * pose[:, :2, 1]
    pose[:, 2, 2] = 1.0
    return Hypotheses(size[which], pose, corners, peaks[corners[:, 0], 0] < 0.0)
