"""Motion from cold: the displacement between the two halves of a window.

The paper takes the first principal component of the events in space-time; over a whole view that finds the
extent of the object rather than its motion.  Instead the signed counts of the two halves are correlated, and
the displacement of the peak is divided by the difference of the halves' mean times.  The sign comes from the
order of time.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.config import MotionConfig
from evqr.windows import EventBuffer, Window
from evqr.workspace import Workspace

FEWEST_EVENTS = 200
"""Events below which a window says nothing about motion."""


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


@functools.lru_cache(maxsize=32)
def _smoother(size: int, sigma: float) -> NDArray[np.float64]:
    steps = np.arange(size)[:, None] - np.arange(size)[None, :]
    return np.exp(-0.5 * (steps / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma)


@functools.cache
def _quadratic() -> NDArray[np.float64]:
    """Least-squares fit of ``c0 + c1 x + c2 y + c3 x^2 + c4 xy + c5 y^2`` to a 3 x 3 neighbourhood."""
    y, x = (g.ravel() for g in np.mgrid[-1:2, -1:2])
    return np.linalg.pinv(np.stack([np.ones(9), x, y, x * x, x * y, y * y], axis=1)).astype(np.float64)


def _peak(surface: NDArray[np.float64]) -> NDArray[np.float64]:
    """Position (x, y) of the highest point, from the surface's centre, to a fraction of a step."""
    radius = surface.shape[0] // 2
    inner = surface[1:-1, 1:-1]
    row, column = (int(k) + 1 for k in np.unravel_index(inner.argmax(), inner.shape))
    c = _quadratic() @ surface[row - 1 : row + 2, column - 1 : column + 2].ravel()
    hessian = np.array([[2.0 * c[3], c[4]], [c[4], 2.0 * c[5]]])
    offset = np.zeros(2)
    if hessian[0, 0] < 0.0 and np.linalg.det(hessian) > 0.0:
        offset[:] = np.clip(-np.linalg.solve(hessian, c[1:3]), -1.0, 1.0)
    return np.array([offset[0] + column - radius, offset[1] + row - radius])


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
    backend, device = workspace.backend, workspace.device
    middle = int(np.searchsorted(window.t, 0.0))
    if min(middle, len(window) - middle) < FEWEST_EVENTS // 2:
        return None
    blur = cfg.blur_px / reduction
    radius = (reach or cfg.reach_px) + max(2, round(blur))
    height, width = -(-window.height // reduction), -(-window.width // reduction)
    halves = workspace.buffer("halves", (2, height, width))
    counts = workspace.get(halves)
    counts.fill(0.0)
    backend.bin_events(
        workspace.put(window.x),
        workspace.put(window.y),
        workspace.put(window.p),
        workspace.put(np.array([0, middle, len(window)], np.int32)),
        reduction,
        halves,
    )
    np.clip(counts, -cfg.clip, cfg.clip, out=counts)
    shifts = 2 * radius + 1
    rows = workspace.buffer("motion rows", (1, height, shifts, -(-shifts // 16) * 16))
    correlation = workspace.buffer("motion correlation", (1, shifts, shifts))
    backend.motion_correlation(halves[0:1], halves[1:2], radius, rows, correlation)
    backend.synchronize(device)
    smooth = _smoother(shifts, blur)
    surface = smooth @ workspace.get(correlation)[0].astype(np.float64) @ smooth.T
    energy = np.sqrt(np.square(counts).sum(axis=(1, 2), dtype=np.float64).prod())
    peak = _peak(surface)
    if reach is None and np.abs(peak).max() >= cfg.reach_px:
        return estimate_motion(window, cfg, workspace=workspace, reduction=reduction, reach=4 * cfg.reach_px)
    displacement = peak * reduction
    between = float(window.t[middle:].mean(dtype=np.float64) - window.t[:middle].mean(dtype=np.float64))
    height_of_peak = float(surface.max() / max(energy, 1e-9))
    if between <= 0.0 or height_of_peak < cfg.min_peak:
        return None
    return Motion(displacement / between, height_of_peak)


def window_length_us(speed: float, travel_px: float, cfg: MotionConfig) -> int:
    """Length of a window in which something at ``speed`` [px/s] travels ``travel_px`` [us]."""
    return int(np.clip(travel_px / max(speed, 1e-9) * 1e6, 20.0, cfg.longest_us))


def find_motion(
    events: EventBuffer, start_us: int, cfg: MotionConfig, *, workspace: Workspace, speed: float | None = None
) -> Motion | None:
    """Estimate the motion at a time from cold: look coarsely, then over a window that suits the speed.

    Parameters
    ----------
    speed   a guess, from an earlier window [px/s]; None: nothing known
    """
    if speed is None:
        length = cfg.probe_us
        for _ in range(4):
            coarse = estimate_motion(
                events.window(start_us, start_us + length), cfg, workspace=workspace, reduction=cfg.reduction
            )
            if coarse is not None and coarse.speed * length * 1e-6 >= 1.0:
                speed = coarse.speed
                break
            if length >= cfg.longest_us:
                return None
            length = min(4 * length, cfg.longest_us)
        else:
            return None
    assert speed is not None
    length = window_length_us(speed, cfg.travel_px, cfg)
    return estimate_motion(events.window(start_us, start_us + length), cfg, workspace=workspace)
