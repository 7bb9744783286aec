"""Candidates of a search, each refined on an image of its own; and how their pixels lag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from evqr.config import ReadConfig
from evqr.events.window import Window
from evqr.fit.align import escape_side_minimum
from evqr.fit.detection import NO_LAG, Target
from evqr.fit.image import depositing
from evqr.fit.lag import estimate_lag
from evqr.fit.measure import Measurement, measuring
from evqr.fit.region import Region, region_around
from evqr.motion import Motion
from evqr.symbol.space import CodeSpace
from evqr.workspace import Workspace


class Guess(Protocol):
    """Where a code might be: its space and pose (3, 3) [px]."""

    @property
    def space(self) -> CodeSpace: ...  # noqa: D102

    @property
    def pose(self) -> NDArray[np.float64]: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class Refinement:
    """A candidate, refined.

    Attributes
    ----------
    target : Target
        What was looked for: its pose is the candidate's.
    region : Region
        Around the candidate.
    measurement : Measurement
        What came out, in cells of the region.
    escaped : bool
        Whether a pose one module away was better, so that the equations are not of the alignment's pose.
    deposited : bool
        Whether the window's events still are on the device's cells for the region.
    iterations : int
        Gauss-Newton steps, of all candidates.
    """

    target: Target
    region: Region
    measurement: Measurement
    escaped: bool
    deposited: bool = True
    iterations: int = 0

    @property
    def score(self) -> float:
        """Correlation with the known modules."""
        return float(self.measurement.alignment.score[0])

    @property
    def refined(self) -> Target:
        """What was found, in px of the sensor."""
        pose = self.region.to_px @ self.measurement.alignment.pose[0]
        return replace(self.target, pose=pose / pose[2, 2])


def refine(
    window: Window,
    motion: Motion,
    candidates: Sequence[Guess],
    tau_us: tuple[float, float] | None,
    cfg: ReadConfig,
    *,
    workspace: Workspace,
) -> Refinement:
    """Refine candidates of a search until one of them is good, and give the best.

    Parameters
    ----------
    window : Window
        Where they are.
    motion : Motion
        Of the code, at the middle of the window.
    candidates : sequence
        At least one, with ``space`` and ``pose``; best first.
    tau_us : (float, float) [us]
        Time constants of the pixels; None: not known, and not undone.
    cfg : ReadConfig
        Settings.
    workspace : Workspace
        Buffers.

    Returns
    -------
    refinement : Refinement
        The one with the highest score.
    """
    one = cfg.align
    tried: list[Refinement] = []
    for candidate in candidates:
        target = Target(candidate.space, candidate.pose, motion, tau_us or NO_LAG)
        region = region_around(target.pose, target.space, one, margin_px=cfg.finder.margin_px)
        step = measuring(window, target, region, cfg, workspace=workspace)
        step.run()
        found = step.read()
        better = escape_side_minimum(step.images, found.alignment, target.space, one, workspace=workspace)
        if better is not None:
            found = replace(found, alignment=better)
        tried.append(Refinement(target, region, found, escaped=better is not None))
        # with a single finder pattern another size may agree well before the right one has its turn
        if tried[-1].score >= one.good_score and not target.space.single_pattern:
            break
    best = max(tried, key=lambda refinement: refinement.score)
    iterations = sum(refinement.measurement.alignment.iterations for refinement in tried)
    return replace(best, deposited=best is tried[-1], iterations=iterations)


def with_lags(window: Window, found: Refinement, cfg: ReadConfig, *, workspace: Workspace) -> Target:
    """Estimate the time constants of the pixels for a candidate, and its pose with their lags undone.

    The window's events then are on the device's cells for the candidate's region.
    """
    target, region = found.target, found.region
    deposit = depositing(window, target.motion, region, workspace=workspace)
    if not found.deposited:
        deposit.run()
    lag_px, aligned = estimate_lag(
        deposit, target.motion, region, found.measurement.alignment.pose[0], target.space, cfg,
        workspace=workspace,
    )  # fmt: skip
    pose = region.to_px @ aligned.pose[0]
    return replace(target, pose=pose / pose[2, 2], tau_us=target.motion.tau_us(lag_px))
