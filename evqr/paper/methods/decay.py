"""Row 6b: an accumulator that forgets, and an ordinary decoder; no motion is estimated.

Each event adds its polarity to its pixel, and what is there fades with a time constant: the image is that
of dv-processing's ``Accumulator`` with exponential, synchronous decay (a test compares the two where that
is installed), in one pass over arrays.  At a pixel that an edge passed at time s the value is the sum of
its steps times exp(-(t - s) / tau), so the image is the luminance behind each edge, high-passed.  The
default time constant is the best of 3, 6 and 12 windows on the scenes of `evqr.paper.dataset`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evqr.events.window import Window
from evqr.paper.methods.integrate import decode, stretch
from evqr.paper.methods.method import Outcome, Watch

FADE = 4.0
"""Time constants of events that are added up: what is older has faded to less than 2 %."""


@dataclass(frozen=True, kw_only=True)
class DecayConfig:
    """Settings.

    Attributes
    ----------
    windows : int
        Time constant, in windows of the scene.
    contrast : float
        Standard deviations of the luminance from mid grey to black or white.
    """

    windows: int = 12
    contrast: float = 2.4


class Decay:
    """Events of the last windows, fading, as an image: dv-processing's ``Accumulator``, exponential decay."""

    takes: Literal["events"] = "events"
    matched = False

    def __init__(self, cfg: DecayConfig | None = None) -> None:
        self.cfg = cfg or DecayConfig()
        self.windows = round(FADE * self.cfg.windows)

    def read(self, seen: Window, watch: Watch) -> Outcome:
        """Accumulate, then decode the image as it is at the end of the window."""
        tau = seen.seconds / FADE
        image = accumulate(seen, tau)
        grey = stretch(image, self.cfg.contrast)
        return Outcome(image=image, text=decode(grey), time_us=seen.end_us, windows=self.windows)


def accumulate(window: Window, tau: float) -> NDArray[np.float32]:
    """Sum of polarities (Y, X), each faded by ``exp(-age / tau)`` to the end of the window."""
    age = np.float32(1e-6 * (window.end_us - window.middle_us)) - window.t
    weight = window.p * np.exp(age * np.float32(-1.0 / tau))
    address = window.y.astype(np.intp) * window.width + window.x.astype(np.intp)
    total = np.bincount(address, weights=weight, minlength=window.width * window.height)
    return total.reshape(window.height, window.width).astype(np.float32)
