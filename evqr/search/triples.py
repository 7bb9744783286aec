"""Symbols with finder patterns at three of their corners: QR codes."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from evqr.config import FinderConfig
from evqr.search.hypothesis import ROW, Hypotheses
from evqr.search.models import sizes


@functools.cache
def three_cornered() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sizes with three finder patterns, the shortest leg first: log of the leg, and what they are (N, 5).

    Where the finder pattern at the corner is along u and v, then one over the leg along u and along v, and
    the number of the size.
    """
    found = []
    for k, size in enumerate(sizes()):
        if len(size.anchors) == 3:
            corner, along, down = size.anchors
            leg_u, leg_v = along.u - corner.u, down.v - corner.v
            found.append((math.log(leg_u), corner.u, corner.v, 1.0 / leg_u, 1.0 / leg_v, k))
    table = np.array(sorted(found))
    return table[:, 0], table[:, 1:]


def leg_tolerances(cfg: FinderConfig, slack: float) -> NDArray[np.float32]:
    """Give what must agree in a triple, with a factor on how well, as `match_corners` takes it."""
    log_leg, _ = three_cornered()
    tolerances = cfg.leg_tolerance * slack, cfg.scale_tolerance * slack, cfg.angle_tolerance * slack
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
    log_leg, place = three_cornered()
    around = triples[:, 4, None] + np.array([-1.0, 1.0]) * cfg.scale_tolerance
    begins, ends = np.searchsorted(log_leg, around).T
    counts = ends - begins
    # with the legs between finder patterns for what they are in modules
    legs = np.zeros(len(triples), ROW)
    legs["peaks"] = triples[:, 1:4]
    three, pose = peaks[legs["peaks"]], legs["pose"]
    legs["inverted"] = three[:, 0, 0] < 0.0
    pose[:, :2, 2] = three[:, 0, 1:3]
    pose[:, :2, 0], pose[:, :2, 1] = (three[:, k, 1:3] - pose[:, :2, 2] for k in (1, 2))
    pose[:, 2, 2] = 1.0
    made = Hypotheses(legs.repeat(counts))
    pose = made.pose
    sizes_of_each = place[np.arange(len(made)) + (ends - counts.cumsum()).repeat(counts)]
    u, v, per_u, per_v, size = sizes_of_each.T[..., None]
    made.size[...] = size[:, 0]
    pose[:, :2, 0] *= per_u
    pose[:, :2, 1] *= per_v
    pose[:, :2, 2] -= u * pose[:, :2, 0] + v * pose[:, :2, 1]
    return made
