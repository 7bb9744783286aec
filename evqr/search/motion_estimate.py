"""Motion from cold: the displacement between the two halves of a window.

The paper takes the first principal component of the events in space-time; over a whole view that finds the
extent of the object rather than its motion.  Instead the signed counts of the two halves are correlated, and
the displacement of the peak is divided by the difference of the halves' mean times.  The sign comes from the
order of time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from evqr.config import MotionConfig
from evqr.events.batch import EventBatch
from evqr.events.buffer import Asking
from evqr.events.window import Window
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.values import Value
from evqr.workspace import EventRoom, Workspace

MOST_PROBES, LONGER = 4, 4
"""Windows tried while the speed is unknown, each so many times as long as the one before."""

LEAST_TRAVEL_PX = 1.0
"""Travel in such a window that tells a speed [px]."""

LEAST_HALF = 1.5
"""Half width of the window that blurs a correlation, at least [binned px]."""


@dataclass(frozen=True, eq=False)
class MotionEstimate(Value):
    """The motion common to a window's events.

    Attributes
    ----------
    motion : Motion
        At the middle of the window.
    correlation : float
        Normalised correlation of the two halves, 0 to 1.
    timings_ms : mapping of str to float [ms]
        By stage; does not count in comparisons.
    """

    motion: Motion
    correlation: float
    timings_ms: Mapping[str, float] = field(default_factory=dict, compare=False)


class _Correlator:
    """Correlates the halves of windows of one size of image, over one square of shifts."""

    def __init__(
        self, events: EventRoom, height: int, width: int, reduction: int, radius: int, half: float,
        cfg: MotionConfig, workspace: Workspace,
    ) -> None:  # fmt: skip
        backend, shifts = workspace.backend, 2 * radius + 1
        self._ptr = workspace.mirror((2, 2), np.int32)
        self._peak, self._energy = workspace.mirror((1, 3)), workspace.mirror((1, 2))
        halves = workspace.empty(2, height, width)
        pair = halves.reshape((1, 2, height, width))
        scratch = workspace.scratch("motion_correlation", B=1, Y=height, X=width, radius=radius)
        surface = workspace.empty(1, shifts, shifts)
        blurred = workspace.scratch("surface_peak", B=1, N=shifts)

        def launch() -> None:
            backend.clear(halves)
            backend.bin_packed_events(events.x, events.y, events.stamp, self._ptr.device, reduction, halves)
            backend.motion_correlation(pair, cfg.clip, radius, *scratch, surface, self._energy.device)
            backend.surface_peak(surface, half, *blurred, self._peak.device)

        self._run = backend.record(launch)

    def __call__(self, middle: int, count: int) -> tuple[NDArray[np.float64], float]:
        """Give the shift (x, y) of highest correlation [binned px], and that correlation, normalised."""
        self._ptr.write([(0, middle), (middle, count)])
        self._run()
        x, y, highest = self._peak.read()[0].tolist()
        first, second = self._energy.read()[0].tolist()
        return np.array([x, y]), highest / max(math.sqrt(first * second), 1e-9)


def estimate_motion(
    window: Window, cfg: MotionConfig, *, workspace: Workspace, reduction: int = 1, reach: int | None = None
) -> MotionEstimate | Reason:
    """Estimate the motion common to a window's events.

    Parameters
    ----------
    window : Window
        Whose motion.
    cfg : MotionConfig
        Settings.
    workspace : Workspace
        Buffers.
    reduction : int [px]
        Binning; 1 is the precise estimate.
    reach : int [binned px]
        Largest displacement between the halves; default ``cfg.reach_px``, and more where the peak lies there.

    Returns
    -------
    estimate : MotionEstimate or Reason
        TOO_FEW_EVENTS in a half of the window, or NOTHING_MOVES where the halves do not correlate.
    """
    middle = window.events.first_at(window.middle_us)
    if min(middle, len(window) - middle) < cfg.fewest_events // 2:
        return Reason.TOO_FEW_EVENTS
    half = max(cfg.blur_px / reduction, LEAST_HALF)
    radius = (reach or cfg.reach_px) + math.ceil(half)
    height, width = -(-window.height // reduction), -(-window.width // reduction)
    events = workspace.events(EventBatch.of([window]))
    correlate = workspace.once(
        ("motion", events.capacity, height, width, reduction, radius, cfg),
        lambda: _Correlator(events, height, width, reduction, radius, half, cfg, workspace),
    )
    shift, correlation = correlate(middle, len(window))
    if reach is None and np.abs(shift).max() >= cfg.reach_px:
        return estimate_motion(window, cfg, workspace=workspace, reduction=reduction, reach=4 * cfg.reach_px)
    between = _mean_us(window, middle, len(window), cfg) - _mean_us(window, 0, middle, cfg)
    if between <= 0.0 or correlation < cfg.min_peak:
        return Reason.NOTHING_MOVES
    motion = Motion(shift * reduction / (between * 1e-6), window.middle_us)
    return MotionEstimate(motion, correlation)


def _mean_us(window: Window, first: int, last: int, cfg: MotionConfig) -> float:
    """Mean time of some events since the window's start [us], from every n-th: they are in order of time."""
    step = 1 + (last - first) // cfg.most_times
    times = window.events.t[first + step // 2 : last : step] - window.start_us
    return int(times.sum()) / len(times)


def find_motion(
    start_us: int, cfg: MotionConfig, *, workspace: Workspace, guess: Motion | None = None
) -> Asking[MotionEstimate | Reason]:
    """Estimate the motion at a time from cold: coarsely, then over a window that suits the speed.

    Which windows it takes depends on what the ones before say, so it asks for them one by one
    (`EventBuffer.answer` runs it where all events are there).

    Parameters
    ----------
    start_us : int [us]
        All windows begin here.
    cfg : MotionConfig
        Settings.
    workspace : Workspace
        Buffers.
    guess : Motion
        From an earlier window, for its speed; None: nothing known.

    Returns
    -------
    estimate : MotionEstimate or Reason
        As of `estimate_motion`.
    """
    length = cfg.probe_us
    for _ in range(0 if guess is not None else MOST_PROBES):
        window = yield start_us, start_us + length
        coarse = estimate_motion(window, cfg, workspace=workspace, reduction=cfg.reduction)
        if isinstance(coarse, MotionEstimate) and coarse.motion.travel_px(length) >= LEAST_TRAVEL_PX:
            guess = coarse.motion
            break
        if length >= cfg.longest_us:
            return Reason.NOTHING_MOVES
        length = min(LONGER * length, cfg.longest_us)
    if guess is None:
        return Reason.NOTHING_MOVES
    window = yield start_us, start_us + guess.window_us(cfg.travel_px, longest_us=cfg.longest_us)
    return estimate_motion(window, cfg, workspace=workspace)
