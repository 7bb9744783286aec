"""A window without the codes in it that are known already, or with one of them alone."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

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
        window = window.keep(~_on(window, target, margin))
    return window


def inside(window: Window, target: Target, margin: float) -> Window:
    """Give the events of a code alone.

    Parameters
    ----------
    window : Window
        Events of one window.
    target : Target
        Where the code is, at any time.
    margin : float [modules]
        Around the code, whose events stay.

    Returns
    -------
    window : Window
        With the same bounds.
    """
    return window.keep(_on(window, target, margin))


def _on(window: Window, target: Target, margin: float) -> NDArray[np.bool_]:
    """Tell which events (E,) are of a code."""
    now = target.at(window.middle_us)
    x, y = now.motion.transport(window.x, window.y, window.t)
    u, v, z = (row[0] * x + row[1] * y + row[2] for row in inverse(now.pose).tolist())
    across, down = now.space.columns / 2.0, now.space.rows / 2.0
    return (np.abs(u / z - across) <= across + margin) & (np.abs(v / z - down) <= down + margin)
