"""Whether what moves in a window turns: the directions in which its quarters move."""

from __future__ import annotations

import cmath
import math

import numpy as np

from evqr.config import MotionConfig
from evqr.events.window import Window
from evqr.search.motion_estimate import MotionEstimate, estimate_motions
from evqr.workspace import Workspace

LEAST_SPREAD = math.radians(24.0)
"""Angle between the motions of two quarters of something that turns.  Measured: below 10 degrees for codes
that move straight, tilted ones included, 50 to 90 for those that turn about a point within a width."""

MOST_UNLIKE = 0.55
"""How far the motions of the quarters may be from one that is affine in the image, relative to the largest
difference between two of them.  Measured: up to 0.45 for what turns, 0.6 and more where it is noise."""


def turns(window: Window, cfg: MotionConfig, *, workspace: Workspace) -> bool:
    """Tell whether the parts of a window move in different directions.

    Parameters
    ----------
    window : Window
        With one thing in it that moves; as long as one to four pixels of travel take.
    cfg : MotionConfig
        Settings.
    workspace : Workspace
        Buffers.

    Returns
    -------
    turns : bool
        Where the motions of two quarters of its events clearly differ, and all four say one turn.
    """
    if len(window) < 4 * cfg.fewest_events:
        return False
    right, below = window.x >= np.median(window.x), window.y >= np.median(window.y)
    quarters = [window.keep((right == a) & (below == b)) for a in (False, True) for b in (False, True)]
    estimates = estimate_motions(quarters, cfg, workspace=workspace, thorough=False)
    known = [complex(*each.motion.velocity) for each in estimates if isinstance(each, MotionEstimate)]
    if len(known) < 4 or not all(known):
        return False
    spread = max(abs(cmath.phase(a / b)) for a in known for b in known)
    unlike = abs(known[0] - known[1] - known[2] + known[3])
    return spread > LEAST_SPREAD and unlike < MOST_UNLIKE * max(abs(a - b) for a in known for b in known)
