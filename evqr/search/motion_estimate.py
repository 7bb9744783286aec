"""Motion from cold: the displacement between the two halves of a window.

The paper takes the first principal component of the events in space-time; over a whole view that finds the
extent of the object rather than its motion.  Instead the signed counts of the two halves are correlated, and
the displacement of the peak is divided by the difference of the halves' mean times.  The sign comes from the
order of time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.config import MotionConfig
from evqr.events.buffer import Asking
from evqr.events.window import Window
from evqr.workspace import EventSlots, Workspace

FEWEST_EVENTS = 200
"""Events below which a window says nothing about motion."""

TIMES = 256
"""Events at most whose times are averaged: they are quantiles, so that the mean is as good as that of all."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion common to a window.

    Attributes
    ----------
    velocity : (2,) float64 [px/s]
    peak                           normalised correlation of the two halves, 0 to 1
    """

    velocity: NDArray[np.float64]
    peak: float

    @property
    def speed(self) -> float:
        """Length of the velocity [px/s]."""
        return float(np.hypot(*self.velocity))


def _smoother(size: int, sigma: float) -> NDArray[np.float32]:
    steps = np.arange(size)[:, None] - np.arange(size)[None, :]
    return (np.exp(-0.5 * (steps / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma)).astype(np.float32)


class _Correlator:
    """Correlates the halves of windows of one size of image, over one square of shifts."""

    def __init__(
        self, events: EventSlots, height: int, width: int, reduction: int, radius: int, cfg: MotionConfig,
        workspace: Workspace,
    ) -> None:  # fmt: skip
        backend, shifts = workspace.backend, 2 * radius + 1
        self._ptr = workspace.mirror((3,), np.int32)
        self._peak, self._energy = workspace.mirror((1, 3)), workspace.mirror((1, 2))
        halves = workspace.empty(2, height, width)
        pair = halves.reshape((1, 2, height, width))
        rows = workspace.empty(1, height, shifts, -(-shifts // 16) * 16)
        found = workspace.empty(1, height, width, dtype=np.int32)
        energy_rows = workspace.empty(1, height, 2)
        surface, half_smooth, smooth = (workspace.empty(1, shifts, shifts) for _ in range(3))
        smoother = workspace.put(_smoother(shifts, cfg.blur_px / reduction))

        def launch() -> None:
            backend.clear(halves)
            backend.bin_events(events.x, events.y, events.p, self._ptr.device, reduction, halves)
            backend.motion_correlation(
                pair, cfg.clip, radius, found, rows, energy_rows, surface, self._energy.device
            )
            backend.surface_peak(surface, smoother, half_smooth, smooth, self._peak.device)

        self._run = backend.record(launch)

    def __call__(self, middle: int, count: int) -> tuple[NDArray[np.float64], float]:
        """Give the shift (x, y) of highest correlation [binned px], and that correlation, normalised."""
        self._ptr.write((0, middle, count))
        self._run()
        x, y, highest = self._peak.read()[0].tolist()
        first, second = self._energy.read()[0].tolist()
        return np.array([x, y]), highest / max(math.sqrt(first * second), 1e-9)


def estimate_motion(
    window: Window, cfg: MotionConfig, *, workspace: Workspace, reduction: int = 1, reach: int | None = None
) -> Motion | None:
    """Estimate the motion common to a window's events.

    Parameters
    ----------
    reduction   binning [px]; 1 is the precise look
    reach       largest displacement between the halves [binned px]; default ``cfg.reach_px``, and more where
                the peak lies there

    Returns
    -------
    Motion      or None where a half has too few events or nothing correlates
    """
    middle = window.events.first_at(window.middle_us)
    if min(middle, len(window) - middle) < FEWEST_EVENTS // 2:
        return None
    radius = (reach or cfg.reach_px) + max(2, round(cfg.blur_px / reduction))
    height, width = -(-window.height // reduction), -(-window.width // reduction)
    events = workspace.events(window, times=False)
    correlate = workspace.once(
        ("motion", events.capacity, height, width, reduction, radius, cfg),
        lambda: _Correlator(events, height, width, reduction, radius, cfg, workspace),
    )
    shift, correlation = correlate(middle, len(window))
    if reach is None and np.abs(shift).max() >= cfg.reach_px:
        return estimate_motion(window, cfg, workspace=workspace, reduction=reduction, reach=4 * cfg.reach_px)
    between = _mean_us(window, middle, len(window)) - _mean_us(window, 0, middle)
    if between <= 0.0 or correlation < cfg.min_peak:
        return None
    return Motion(shift * reduction / (between * 1e-6), correlation)


def _mean_us(window: Window, first: int, last: int) -> float:
    """Mean time of some events since the window's start [us], from every n-th: they are in order of time."""
    step = 1 + (last - first) // TIMES
    times = window.events.t[first + step // 2 : last : step] - window.start_us
    return int(times.sum()) / len(times)


def travel_time_us(speed: float, travel_px: float) -> float:
    """Time in which something at ``speed`` [px/s], which may be 0, travels ``travel_px`` [us]."""
    return travel_px / max(speed, 1e-9) * 1e6


def window_length_us(speed: float, travel_px: float, cfg: MotionConfig) -> int:
    """Length of a window in which something at ``speed`` [px/s] travels ``travel_px`` [us]."""
    return int(min(max(travel_time_us(speed, travel_px), 20.0), cfg.longest_us))


def find_motion(
    start_us: int, cfg: MotionConfig, *, workspace: Workspace, speed: float | None = None
) -> Asking[Motion | None]:
    """Estimate the motion at a time from cold: look coarsely, then over a window that suits the speed.

    Which windows it takes depends on what the ones before say, so it asks for them one by one
    (`EventBuffer.answer` runs it where all events are there).

    Parameters
    ----------
    start_us : int [us]
        All windows begin here.
    speed : float [px/s]
        A guess, from an earlier window; None: nothing known.
    """
    if speed is None:
        length = cfg.probe_us
        for _ in range(4):
            window = yield start_us, start_us + length
            coarse = estimate_motion(window, cfg, workspace=workspace, reduction=cfg.reduction)
            if coarse is not None and coarse.speed * length * 1e-6 >= 1.0:
                speed = coarse.speed
                break
            if length >= cfg.longest_us:
                return None
            length = min(4 * length, cfg.longest_us)
        else:
            return None
    window = yield start_us, start_us + window_length_us(speed, cfg.travel_px, cfg)
    return estimate_motion(window, cfg, workspace=workspace)
