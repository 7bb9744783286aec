"""Why a part has no text: what someone who stands at the line can act on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evqr.config import ReadConfig
from evqr.geometry import module_px
from evqr.motion import SHORTEST_WINDOW_US, Motion
from evqr.reason import Reason
from evqr.stream.records import CodeUnread, Searched

STILL = (Reason.NOTHING_MOVES, Reason.TOO_FEW_EVENTS, Reason.NO_EVENTS)
"""What searches say where nothing passes."""

LAG_MODULES = 1.5
"""Pixels that lag by so many modules see neighbours as one."""

ALL_CLEAR = 0.9
"""Share of clear modules from which on they were not blurred: the lag was fitted to what is no code."""


@dataclass(frozen=True)
class Verdict:
    """Why there is no text.

    Attributes
    ----------
    reason : Reason
        For programs.
    detail : str
        What it was in this case.
    nearest : CodeUnread, optional
        What came nearest to a code.
    motion : Motion, optional
        How things moved, where something did.
    """

    reason: Reason
    detail: str = ""
    nearest: CodeUnread | None = None
    motion: Motion | None = None

    def __str__(self) -> str:
        return self.reason.explained(self.detail)


def verdict_on(
    unread: Sequence[CodeUnread], searches: Sequence[Searched], size: tuple[int, int], cfg: ReadConfig
) -> Verdict:
    """Tell why nothing was read in a time that was searched.

    A code was seen where its known modules agree, in the mean over all windows in which it was followed; what
    agrees less is nothing like a code, however many finder patterns it seems to have.

    Parameters
    ----------
    unread : sequence of CodeUnread
        What was followed in vain.
    searches : sequence of Searched
        What was searched, in order.
    size : (int, int) [px]
        Width and height of the sensor.
    cfg : ReadConfig
        What it was read with.

    Returns
    -------
    verdict : Verdict
        The reason, and what came nearest.
    """
    best = max(unread, key=lambda each: each.mean_score, default=None)
    motion = best.target.motion if best else _fastest(searches)
    if best is not None and best.agrees(cfg.align.good_score):
        return _seen(best, size)
    if all(each.not_found is not None and each.not_found.reason in STILL for each in searches) and not best:
        return Verdict(Reason.NOTHING_MOVES, f"searches: {len(searches)}")
    if motion is not None and motion.travel_time_us(cfg.travel_px) > cfg.motion.longest_us:
        return Verdict(Reason.TOO_SLOW, _speed(motion), best, motion)
    if motion is not None and motion.travel_time_us(cfg.travel_px) < SHORTEST_WINDOW_US:
        return Verdict(Reason.TOO_FAST, _speed(motion), best, motion)
    closest = max((each.not_found.closest for each in searches if each.not_found is not None), default=0.0)
    closest = max(closest, 0.0 if best is None else best.mean_score)
    followed = f", followed over windows: {best.windows}" if best else ""
    moved = f", {_speed(motion)}" if motion is not None else ""
    detail = f"closest agreement {max(closest, 0.0):.2f}{followed}, searches: {len(searches)}{moved}"
    return Verdict(Reason.NOTHING_LIKE_A_CODE, detail, best, motion)


def _seen(code: CodeUnread, size: tuple[int, int]) -> Verdict:
    """Tell why a code that was seen does not decode."""
    target, motion = code.target, code.target.motion
    how = (
        f"agreement {code.mean_score:.2f} over windows: {code.windows}, {code.clear_modules:.0%} of its"
        f" modules clear, {code.events_an_edge:.1f} events an edge"
    )
    if not any(_inside(code, time_us, size) for time_us in (code.t_first_us, target.time_us, code.t_last_us)):
        return Verdict(Reason.PARTLY_IN_VIEW, how, code, motion)
    lag = max(target.lag_px) / module_px(target.pose, target.space.shape)
    if lag > LAG_MODULES and code.clear_modules < ALL_CLEAR:
        return Verdict(Reason.TOO_FAST, f"pixels lag by {lag:.1f} modules, {how}", code, motion)
    return Verdict(Reason.NOT_DECODED, f"{how}: {code.failure}", code, motion)


def _inside(code: CodeUnread, time_us: float, size: tuple[int, int]) -> bool:
    corners = code.target.at(time_us).outline()
    return bool((corners > -0.5).all() and (corners < (size[0] - 0.5, size[1] - 0.5)).all())


def _fastest(searches: Sequence[Searched]) -> Motion | None:
    return max(
        (each.motion for each in searches if each.motion is not None), key=lambda m: m.speed, default=None
    )


def _speed(motion: Motion) -> str:
    return f"{motion.speed / 1000.0:.2f} px/ms"
