"""In which order a window is searched: along which motions, and how thoroughly."""

from __future__ import annotations

from collections.abc import Iterator

from evqr.config import FinderConfig, SearchPass
from evqr.events.window import Window
from evqr.motion import Motion


def search_passes(
    window: Window, motion: Motion, cfg: FinderConfig, *, thorough: bool = True
) -> Iterator[tuple[Motion, SearchPass]]:
    """Give motions and passes along them, the most promising first.

    A motion of less than a pixel may as well be another: several directions are tried then, thoroughly.
    Where nothing moves there is nothing to search.

    Parameters
    ----------
    window : Window
        Where is searched.
    motion : Motion
        Of the code.
    cfg : FinderConfig
        The passes.
    thorough : bool
        False: the motion is sure, and the last pass, which takes most of the time, is left out.

    Yields
    ------
    motion : Motion
        At the middle of the window.
    search_pass : SearchPass
        To search with along it.
    """
    motion = motion.at(window.middle_us)
    if motion.speed <= 0.0:
        return
    if not thorough:
        for search_pass in cfg.passes[:-1] or cfg.passes:
            yield motion, search_pass
    elif motion.travel_px(1e6 * window.seconds) >= cfg.sure_travel_px:
        for search_pass in cfg.passes:
            yield motion, search_pass
    else:
        for angle in cfg.unsure_turns:
            yield motion.turned(angle), cfg.passes[-1]
