"""Row 3 of the paper's table, "w/o QR": its cost without the code space, equation 7.

    cost = sum over pixels of |grad L . m + E|^2 + lambda |grad L|^2

over the luminance L of each pixel and the motion m, by gradient descent, with lambda = 0.2.  What the text
leaves open is resolved as for the paper's own method (`methods.descent`): the cost is divided by its
largest curvature, |m|^2 + 8 lambda, so that a rate of 1 is stable, and the events are splatted anew for each
motion but held in its derivative.  Besides:

- the first motion comes from `estimate_motion`;
- the first luminance is 0;
- a sum over all pixels has no size of its own to stop at: the descent has converged where a step is smaller
  than ``tolerance`` of the luminance it has reached.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evqr.config import MotionConfig
from evqr.events.window import Window
from evqr.launched import LAUNCHED
from evqr.paper.methods.event_image import event_image
from evqr.paper.methods.method import Outcome, Watch
from evqr.reason import Reason
from evqr.search.motion_estimate import estimate_motion
from evqr.workspace import Workspace
from evqr_kernels.registry import get_backend

Image = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class WithoutQrConfig:
    """Settings.

    Attributes
    ----------
    smoothness : float
        Lambda of equation 7.
    threshold : float [log units]
        Of an event, theta.
    epsilon_px : float [px]
        Standard deviation of an event's splat.
    motion_rate : float
        Update rate of m.
    luminance_rate : float
        Update rate of L.
    tolerance : float
        Step of L, relative to L, below which the descent has converged.
    max_iterations : int
        At most so many.
    """

    smoothness: float = 0.2
    threshold: float = 0.2
    epsilon_px: float = 0.8
    motion_rate: float = 0.001
    luminance_rate: float = 1.0
    tolerance: float = 0.005
    max_iterations: int = 300


class WithoutQr:
    """Luminance and motion of one window (Nagata et al. 2020, equation 7); codes are found in the image."""

    takes: Literal["events"] = "events"
    windows = 1
    matched = True

    def __init__(self, cfg: WithoutQrConfig | None = None) -> None:
        self.cfg = cfg or WithoutQrConfig()
        backend = get_backend("auto")
        backend.load("cpu", LAUNCHED)
        self._workspace = Workspace(backend, "cpu")

    def read(self, seen: Window, watch: Watch) -> Outcome:
        """Descend until it has converged, then on for as long as the watch wants to see more."""
        cfg = self.cfg
        guess = estimate_motion(seen, MotionConfig(), workspace=self._workspace)
        if isinstance(guess, Reason):
            return Outcome(converged=False)
        motion = guess.motion.displacement(1e6 * seen.seconds)
        luminance = np.zeros((seen.height, seen.width), np.float32)
        final: Image | None = None
        for iteration in range(1, cfg.max_iterations + 1):
            events = event_image(
                seen,
                motion,
                epsilon_px=cfg.epsilon_px,
                workspace=self._workspace,
                weight=cfg.threshold,
            )
            step, adj_motion = descend(luminance, events, motion, cfg)
            luminance -= step
            motion = motion - cfg.motion_rate * adj_motion
            small = np.linalg.norm(step) < cfg.tolerance * np.linalg.norm(luminance)
            if final is None and small:
                final = luminance.copy()
            enough = watch(iteration, luminance, final is not None)
            if final is not None and enough:
                break
        return Outcome(image=luminance if final is None else final, converged=final is not None)


def descend(
    luminance: Image, events: Image, motion: NDArray[np.float64], cfg: WithoutQrConfig
) -> tuple[Image, NDArray[np.float64]]:
    """Give the step of L (Y, X), to be subtracted, and the derivative in m (2,) of half the divided cost."""
    m_x, m_y = (np.float32(part) for part in motion)
    scale = np.float32(1.0 / (float(motion @ motion) + 8.0 * cfg.smoothness))
    padded = np.pad(luminance, 1, mode="edge")
    right, left, below, above = padded[1:-1, 2:], padded[1:-1, :-2], padded[2:, 1:-1], padded[:-2, 1:-1]
    slope_x, slope_y = np.float32(0.5) * (right - left), np.float32(0.5) * (below - above)
    residual = m_x * slope_x
    residual += m_y * slope_y
    residual += events
    adj_motion = float(scale) * np.array([np.vdot(residual, slope_x), np.vdot(residual, slope_y)], np.float64)

    # adjoint of the central differences: minus them, and at a border what falls on the repeated pixel
    step = np.zeros_like(luminance)
    for axis, part in ((1, m_x), (0, m_y)):
        flux, out = np.moveaxis(residual, axis, -1), np.moveaxis(step, axis, -1)
        half = np.float32(0.5) * part * flux
        out[..., 1:] += half[..., :-1]
        out[..., -1] += half[..., -1]
        out[..., :-1] -= half[..., 1:]
        out[..., 0] -= half[..., 0]
    smooth = np.float32(cfg.smoothness)
    step += smooth * (np.float32(4.0) * luminance - right - left - below - above)
    step *= scale * np.float32(cfg.luminance_rate)
    return step, adj_motion
