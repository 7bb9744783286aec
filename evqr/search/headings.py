"""Along which motions a window is searched."""

from __future__ import annotations

from evqr.config import FinderConfig
from evqr.events.window import Window
from evqr.motion import Motion


def headings(window: Window, motion: Motion, cfg: FinderConfig) -> list[Motion]:
    """Give the motions that codes of a window may have, the most likely first.

    A motion of less than a pixel may as well be another: several directions are tried then.  Where nothing
    moves there is nothing to search.

    Parameters
    ----------
    window : Window
        Where is searched.
    motion : Motion
        Of the codes.
    cfg : FinderConfig
        Settings.

    Returns
    -------
    motions : list of Motion
        At the middle of the window.
    """
    motion = motion.at(window.middle_us)
    if motion.speed <= 0.0:
        return []
    if motion.travel_px(1e6 * window.seconds) >= cfg.sure_travel_px:
        return [motion]
    return [motion.turned(angle) for angle in cfg.unsure_turns]
