"""Frozen settings that kernels are built for."""

import functools
import math
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class SplatConfig:
    """Shape of an event's splat: a Gaussian that ends smoothly, or the shares of the four pixels around it.

    A Gaussian is taken to zero at ``radius_px`` by a polynomial.

    In one axis ``g(r) = exp(-r^2 / (2 epsilon^2)) (1 - (r / radius)^2)^2 / c`` for ``|r| < radius``, with c
    such that the integral is 1.  A Gaussian that is just cut off makes the cost jump when an event crosses
    the cut.  Bilinear is ``g(r) = max(0, 1 - |r|)``, with slope 0 at its middle and ends.

    Attributes
    ----------
    kind : str
        "gaussian" or "bilinear", which has no width to choose.
    epsilon_px : float [image px]
        Standard deviation of the Gaussian before it is taken to zero, 0.3 to 8.
    radius_px : float [image px]
        Where the splat ends, at most 8 standard deviations and 32 pixels; 3 standard deviations by default.
    """

    kind: Literal["gaussian", "bilinear"] = "gaussian"
    epsilon_px: float = 0.8
    radius_px: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in ("gaussian", "bilinear"):
            raise ValueError(f'kind must be "gaussian" or "bilinear", got {self.kind!r}')
        if self.kind == "bilinear":
            if self.epsilon_px != 0.8 or self.radius_px not in (0.0, 1.0):
                raise ValueError("a bilinear splat has no width: leave epsilon_px and radius_px")
            object.__setattr__(self, "radius_px", 1.0)
            return
        if not 0.3 <= self.epsilon_px <= 8.0:
            raise ValueError(f"epsilon_px must be 0.3 to 8, got {self.epsilon_px}")
        if self.radius_px == 0.0:
            object.__setattr__(self, "radius_px", 3.0 * self.epsilon_px)
        # farther out a Gaussian is lost in rounding, and what kernels compute it from overflows
        most = min(8.0 * self.epsilon_px, 32.0)
        if not self.epsilon_px <= self.radius_px <= most:
            raise ValueError(f"radius_px must be epsilon_px to {most:g}, got {self.radius_px}")

    @property
    def name(self) -> str:
        """What tells kernels of this splat from others."""
        return f"{self.epsilon_px:g}_{self.radius_px:g}" if self.kind == "gaussian" else self.kind

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
