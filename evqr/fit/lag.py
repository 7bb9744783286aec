"""How far the pixels lag: one time constant for ON and one for OFF events.

A photoreceptor is a first-order low-pass, tau dY/dt + Y = X.  Seen from the moving code that smears the
image along the motion over lag = |v| tau px, and one directional derivative undoes it (`evqr_kernels`,
lag_operator).  OFF events lag about twice as much as ON events: a darker pixel is slower.  One deposit of
the events gives the image for every pair of lags; the pair is taken whose image agrees best with the known
modules.

The image must be blurred by about a quarter of a module, as regions are, or the comparison favours small
lags: sharpening also sharpens noise.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.config import StageOneConfig
from evqr.fit.align import Align, Alignment, fine_levels
from evqr.fit.image import Sharpen
from evqr.fit.region import Region
from evqr.workspace import Step, Workspace

FIRST_LAGS = (0.0, 0.2, 0.4, 0.7, 1.0, 1.5)
"""ON lags tried first [modules]."""

OFF_OVER_ON = 1.6
"""Ratio of the lags tried first."""

MOST_STEPS = 1
"""Steps of Gauss-Newton for each pair."""

CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
"""Lags [px] whose images those for all pairs are mixed from: the image is linear in the lags."""

FACTORS = (0.6, 1.0, 1.6)
"""Factors around the best first pair, for ON and for OFF; with 1, which is that pair itself."""


def estimate_lag(
    cells: Any,
    velocity: NDArray[np.float64],
    region: Region,
    pose: NDArray[np.float64],
    version: int,
    cfg: StageOneConfig,
    *,
    workspace: Workspace,
) -> tuple[tuple[float, float], Alignment]:
    """Estimate the lags at a pose that stage one found without them.

    Parameters
    ----------
    cells           deposit of the events on the region
    pose : (3, 3)   code coordinates to cells of the region

    Returns
    -------
    lag_px      ON and OFF [px]
    alignment   of the pose with these lags, one hypothesis
    """
    step = workspace.once(("lag", id(cells), version, cfg), lambda: _Lag(cells, version, cfg, workspace))
    direction = velocity / math.hypot(*velocity)
    module = region.cell * cfg.cells_a_module
    first = [(lag * module, OFF_OVER_ON * lag * module) for lag in FIRST_LAGS]
    # a lagging edge is seen behind the true one by the mean lag
    start = np.tile(pose, (len(first), 1, 1))
    for ahead, (on, off) in zip(start, first, strict=True):
        ahead[:2] += np.outer(direction * 0.5 * (on + off) / region.cell, pose[2])
    step.corners.write(velocity, region, CORNERS)
    step.first.write(first, start)
    step.run()
    tried = step.first.align.read()
    best = tried.best
    base_on, base_off = first[best] if best else (0.1 * module, 0.16 * module)
    second = [first[best]] + [
        (base_on * f, base_off * g) for f in FACTORS for g in FACTORS if (f, g) != (1.0, 1.0)
    ]
    step.second.write(second, np.tile(tried.pose[best], (len(second), 1, 1)))
    step.second.run()
    tried = step.second.align.read()
    return second[tried.best], tried.only(tried.best)


class _Lag(Step):
    """The images for the corners, and the pairs that are tried first; then the pairs around the best."""

    def __init__(self, cells: Any, version: int, cfg: StageOneConfig, workspace: Workspace) -> None:
        super().__init__(workspace.backend)
        self._cells = cells  # it is known by its id as long as this lives
        self.corners = Sharpen(cells, len(CORNERS), workspace)
        self.first, self.second = (
            _Pairs(self.corners.images, count, version, cfg, workspace)
            for count in (len(FIRST_LAGS), len(FACTORS) ** 2)
        )

    def launch(self) -> None:
        """Launch the kernels one by one."""
        self.corners.launch()
        self.first.launch()


class _Pairs(Step):
    """Images for some pairs of lags, mixed from those for `CORNERS`, and poses on them.

    A step or two settle which pair is best; what they leave of the pose the next alignment takes up.
    """

    def __init__(
        self, corners: Any, count: int, version: int, cfg: StageOneConfig, workspace: Workspace
    ) -> None:
        super().__init__(workspace.backend)
        self._corners, self._weight = corners, workspace.mirror((count, 3))
        self._images = workspace.empty(count, *corners.shape[1:])
        self.align = Align(self._images, count, version, fine_levels(cfg), MOST_STEPS, cfg, workspace)

    def write(self, pairs: list[tuple[float, float]], start: NDArray[np.float64]) -> None:
        """Say which lags [px], and the poses (N, 3, 3) to start from."""
        self._weight.write([(1.0 - on - off, on, off) for on, off in pairs])
        self.align.write(start, range(len(pairs)))

    def launch(self) -> None:
        """Launch the kernels one by one."""
        self._backend.mix_images(self._corners, self._weight.device, self._images)
        self.align.launch()
