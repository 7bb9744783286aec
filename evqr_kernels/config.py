"""Frozen settings that kernels are built for."""

import functools
import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class SplatConfig:
    """Shape of an event's splat: a Gaussian that a polynomial takes to zero, smoothly, at ``radius_px``.

    In one axis ``g(r) = exp(-r^2 / (2 epsilon^2)) (1 - (r / radius)^2)^2 / c`` for ``|r| < radius``, with c
    such that the integral is 1.  A Gaussian that is just cut off makes the cost jump when an event crosses
    the cut.

    Attributes
    ----------
    epsilon_px : float [image px]
        Standard deviation of the Gaussian before it is taken to zero, 0.3 to 8.
    radius_px : float [image px]
        Where the splat ends, at most 8 standard deviations and 32 pixels; 3 standard deviations by default.
    """

    epsilon_px: float = 0.8
    radius_px: float = 0.0

    def __post_init__(self) -> None:
        if not 0.3 <= self.epsilon_px <= 8.0:
            raise ValueError(f"epsilon_px must be 0.3 to 8, got {self.epsilon_px}")
        if self.radius_px == 0.0:
            object.__setattr__(self, "radius_px", 3.0 * self.epsilon_px)
        # farther out a Gaussian is lost in rounding, and what kernels compute it from overflows
        most = min(8.0 * self.epsilon_px, 32.0)
        if not self.epsilon_px <= self.radius_px <= most:
            raise ValueError(f"radius_px must be epsilon_px to {most:g}, got {self.radius_px}")

    @property
    def reach(self) -> int:
        """Pixels on either side of the nearest one that a splat can touch."""
        return math.ceil(self.radius_px - 0.5)

    def gauss(self, r: float) -> float:
        """``exp(-r^2 / (2 epsilon^2))``."""
        return math.exp(-0.5 * (r / self.epsilon_px) ** 2)

    @functools.cached_property
    def norm(self) -> float:
        """1 / c: makes the integral of ``g`` 1."""
        steps = 4000
        offsets = (2.0 * k / steps - 1.0 for k in range(1, steps))
        total = sum(self.gauss(s * self.radius_px) * (1.0 - s * s) ** 2 for s in offsets)
        return steps / (2.0 * self.radius_px * total)
