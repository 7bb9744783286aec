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

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.config import StageOneConfig
from evqr.region import Region, sharpen
from evqr.stage_one import Alignment, align, fine_levels
from evqr.workspace import Workspace

FIRST_LAGS = (0.0, 0.2, 0.4, 0.7, 1.0, 1.5)
"""ON lags tried first [modules]."""

OFF_OVER_ON = 1.6
"""Ratio of the lags tried first."""

MOST_STEPS = 1
"""Steps of Gauss-Newton for each pair."""

FACTORS = (0.6, 1.0, 1.6)
"""Factors around the best first pair, for ON and for OFF."""


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
    direction = velocity / np.hypot(*velocity)

    # the image is linear in the lags: those of all pairs are mixtures of three
    corners = sharpen(cells, velocity, region, [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], workspace=workspace)

    # a step or two settle which pair is best; what they leave of the pose the next alignment takes up
    def try_pairs(pairs: list[tuple[float, float]], start: list[NDArray[np.float64]]) -> Alignment:
        images = _mix(corners, pairs, region, workspace)
        idx = np.arange(len(pairs), dtype=np.int32)
        return align(
            images, np.stack(start), version, fine_levels(cfg), cfg, workspace=workspace, image_idx=idx,
            max_iterations=MOST_STEPS,
        )  # fmt: skip

    module = region.cell * cfg.cells_a_module
    first = [(lag * module, OFF_OVER_ON * lag * module) for lag in FIRST_LAGS]
    # a lagging edge is seen behind the true one by the mean lag
    start = []
    for on, off in first:
        ahead = np.eye(3)
        ahead[:2, 2] = direction * 0.5 * (on + off) / region.cell
        start.append(ahead @ pose)
    tried = try_pairs(first, start)
    best = int(tried.score.argmax())
    base_on, base_off = first[best] if best else (0.1 * module, 0.16 * module)
    second = [first[best]] + [
        (base_on * f, base_off * g) for f in FACTORS for g in FACTORS if (f, g) != (1.0, 1.0)
    ]
    tried = try_pairs(second, [tried.pose[best]] * len(second))
    best = int(tried.score.argmax())
    pick = slice(best, best + 1)
    return second[best], Alignment(
        tried.pose[pick], tried.gain[pick], tried.score[pick], tried.noise[pick], tried.iterations
    )


def _mix(corners: Any, pairs: list[tuple[float, float]], region: Region, workspace: Workspace) -> Any:
    """Make the images for pairs of lags [px] from those for (0, 0), (1, 0) and (0, 1)."""
    count = len(pairs)

    def make() -> tuple[Any, ...]:
        weight, images = workspace.mirror((count, 3)), workspace.empty(count, region.height, region.width)
        run = workspace.backend.record(lambda: workspace.backend.mix_images(corners, weight.device, images))
        return weight, images, run

    weight, images, run = workspace.once(("mix", id(corners), count), make)
    weight.write([(1.0 - on - off, on, off) for on, off in pairs])
    run()
    return images
