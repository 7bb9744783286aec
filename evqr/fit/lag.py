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

import numpy as np
from numpy.typing import NDArray

from evqr.config import ReadConfig
from evqr.fit.align import Align, Alignment, fine_levels
from evqr.fit.image import Deposit, Sharpen
from evqr.fit.region import Region
from evqr.motion import Motion
from evqr.symbol.space import CodeSpace
from evqr.workspace import Images, Step, Workspace

CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
"""Lags [px] whose images those for all pairs are mixed from: the image is linear in the lags."""

LEAST_ON = 0.1
"""ON lag around which is tried where none is better than those that were tried first [modules]."""


def estimate_lag(
    deposit: Deposit,
    motion: Motion,
    region: Region,
    pose: NDArray[np.float64],
    space: CodeSpace,
    cfg: ReadConfig,
    *,
    workspace: Workspace,
) -> tuple[tuple[float, float], Alignment]:
    """Estimate the lags at a pose that stage one found without them.

    Parameters
    ----------
    deposit : Deposit
        Of the events on the region, made already.
    motion : Motion
        Of the code.
    region : Region
        Around the code.
    pose : (3, 3) float64
        Code coordinates to cells of the region.
    space : CodeSpace
        Of the code.
    cfg : ReadConfig
        Settings.
    workspace : Workspace
        Buffers.

    Returns
    -------
    lag_px : (float, float) [px]
        Of ON and of OFF events.
    alignment : Alignment
        Of the pose with these lags, one hypothesis.
    """
    lag = cfg.lag
    step = deposit.once(("lag", space, cfg.align, lag), lambda: _Lag(deposit, space, cfg, workspace))
    direction = motion.direction
    module = region.cell * cfg.align.cells_a_module
    first = [(on * module, lag.off_over_on * on * module) for on in lag.first_on]
    # a lagging edge is seen behind the true one by the mean lag
    start = np.tile(pose, (len(first), 1, 1))
    for ahead, (on, off) in zip(start, first, strict=True):
        ahead[:2] += np.outer(direction * 0.5 * (on + off) / region.cell, pose[2])
    step.corners.write(motion, region, CORNERS)
    step.first.write(first, start)
    step.run()
    tried = step.first.align.read()
    best = tried.best
    base_on, base_off = first[best] if best else (LEAST_ON * module, lag.off_over_on * LEAST_ON * module)
    second = [first[best]] + [
        (base_on * f, base_off * g) for f in lag.factors for g in lag.factors if (f, g) != (1.0, 1.0)
    ]
    step.second.write(second, np.tile(tried.pose[best], (len(second), 1, 1)))
    step.second.run()
    tried = step.second.align.read()
    return second[tried.best], tried.only(tried.best)


class _Lag(Step):
    """The images for the corners, and the pairs that are tried first; then the pairs around the best."""

    def __init__(self, deposit: Deposit, space: CodeSpace, cfg: ReadConfig, workspace: Workspace) -> None:
        super().__init__(workspace.backend)
        self.corners = Sharpen(deposit.cells, len(CORNERS), cfg.align.blur_cells, workspace)
        self.first, self.second = (
            _Pairs(self.corners.images, count, space, cfg, workspace)
            for count in (len(cfg.lag.first_on), len(cfg.lag.factors) ** 2)
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
        self, corners: Images, count: int, space: CodeSpace, cfg: ReadConfig, workspace: Workspace
    ) -> None:
        super().__init__(workspace.backend)
        self._corners, self._weight = corners.device, workspace.mirror((count, 3))
        self._images = Images(workspace.empty(count, *self._corners.shape[1:]))
        one = cfg.align
        most = cfg.lag.max_iterations
        self.align = Align(self._images, count, space, fine_levels(one), most, one, workspace)

    def write(self, pairs: list[tuple[float, float]], start: NDArray[np.float64]) -> None:
        """Say which lags [px], and the poses (N, 3, 3) to start from."""
        self._weight.write([(1.0 - on - off, on, off) for on, off in pairs])
        self.align.write(start, range(len(pairs)))

    def launch(self) -> None:
        """Launch the kernels one by one."""
        self._backend.mix_images(self._corners, self._weight.device, self._images.device)
        self.align.launch()
