"""A window without the codes in it that are known already, so that a search finds those beside them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from evqr.events.window import Window
from evqr.fit.detection import Target
from evqr.geometry import inverse


def outside(window: Window, targets: Iterable[Target], margin: float) -> Window:
    """Give a window without the events of some codes.

    Parameters
    ----------
    window : Window
        Events of one window.
    targets : iterable of Target
        Where the codes are, at any time.
    margin : float [modules]
        Around the codes, whose events go too: their quiet zone.

    Returns
    -------
    window : Window
        With the same bounds.
    """
    for target in targets:
        now = target.at(window.middle_us)
        x, y = now.motion.transport(window.x, window.y, window.t)
        u, v, z = (row[0] * x + row[1] * y + row[2] for row in inverse(now.pose).tolist())
        across, down = now.space.columns / 2.0, now.space.rows / 2.0
        window = window.keep(
            (np.abs(u / z - across) > across + margin) | (np.abs(v / z - down) > down + margin)
        )
    return window
