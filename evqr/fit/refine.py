"""Candidates of a search, each refined on an image of its own; and how their pixels lag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from evqr.clock import StageClock
from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.events.window import Window
from evqr.fit.align import escape_side_minimum
from evqr.fit.detection import NO_LAG, Detection, Target
from evqr.fit.image import depositing
from evqr.fit.lag import estimate_lag
from evqr.fit.measure import Measurement, measure, measuring
from evqr.fit.region import Region, region_around
from evqr.geometry import compose
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
    iterations : int
        Gauss-Newton steps, of all candidates of the window.
    """

    target: Target
    region: Region
    measurement: Measurement
    escaped: bool
    iterations: int = 0

    @property
    def score(self) -> float:
        """Correlation with the known modules."""
        return float(self.measurement.alignment.score[0])

    @property
    def refined(self) -> Target:
        """What was found, in px of the sensor."""
        pose = compose(self.region.to_px, self.measurement.alignment.pose[0])
        return replace(self.target, pose=pose / pose[2, 2])


def refine(
    batch: EventBatch,
    motions: Sequence[Motion],
    candidates: Sequence[Sequence[Guess]],
    tau_us: Sequence[tuple[float, float] | None],
    cfg: ReadConfig,
    *,
    workspace: Workspace,
) -> list[Refinement]:
    """Refine candidates of searches, for each window until one of them is good, and give the best of each.

    A row of the batch is one place where a code is looked for: for several in a window, `EventBatch.pick`
    gives it several rows, each with candidates of its own.  What comes out of a row does not depend on the
    others.

    Parameters
    ----------
    batch : EventBatch
        B windows.
    motions : sequence of Motion
        Of the code in each, at the middle of the window.
    candidates : sequence of sequences
        For each window at least one, with ``space`` and ``pose`` (3, 3) [px], best first.
    tau_us : sequence of (float, float) or None [us]
        Time constants of the pixels, a window; None: not known, and not undone.
    cfg : ReadConfig
        Settings.
    workspace : Workspace
        Buffers.

    Returns
    -------
    refinements : list of Refinement
        For each window the one with the highest score of those up to the first good one; `complete` makes
        detections of them.
    """
    return [
        _refine(window, motion, tried, tau, cfg, workspace=workspace)
        for window, motion, tried, tau in zip(batch.windows, motions, candidates, tau_us, strict=True)
    ]


def _refine(
    window: Window,
    motion: Motion,
    candidates: Sequence[Guess],
    tau_us: tuple[float, float] | None,
    cfg: ReadConfig,
    *,
    workspace: Workspace,
) -> Refinement:
    """Refine the candidates of one window."""
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
    return replace(best, iterations=iterations)


def complete(
    batch: EventBatch,
    refinements: Sequence[Refinement],
    tau_us: Sequence[tuple[float, float] | None],
    cfg: ReadConfig,
    *,
    workspace: Workspace,
    clock: StageClock,
) -> list[Detection]:
    """Estimate what is still unknown of codes that were found, and measure them.

    Parameters
    ----------
    batch : EventBatch
        B windows, as they were refined; others are left out by `EventBatch.pick`.
    refinements : sequence of Refinement
        What `refine` found in each.
    tau_us : sequence of (float, float) or None [us]
        As for `refine`; where it is None the lags are estimated, unless the code is sharp without.
    cfg : ReadConfig
        Settings.
    workspace : Workspace
        Buffers.
    clock : StageClock
        To which the times are added, of the stages "lag" and "stage_one".

    Returns
    -------
    detections : list of Detection
        One a window, without timings.
    """
    return [
        _complete(window, found, tau, cfg, workspace=workspace, clock=clock)
        for window, found, tau in zip(batch.windows, refinements, tau_us, strict=True)
    ]


def _complete(
    window: Window,
    found: Refinement,
    tau_us: tuple[float, float] | None,
    cfg: ReadConfig,
    *,
    workspace: Workspace,
    clock: StageClock,
) -> Detection:
    """Complete one window."""
    if tau_us is None and found.score >= cfg.align.sharp_score:
        tau_us = NO_LAG
    if tau_us is not None and not found.escaped:
        return found.measurement.detection(found.target, found.region, found.iterations)
    target = found.refined
    if tau_us is None:
        with clock("lag"):
            target = _with_lags(window, found, cfg, workspace=workspace)
    with clock("stage_one"):
        measured = measure(window, target, found.region, cfg, workspace=workspace)
    return measured.detection(target, found.region, found.iterations + measured.alignment.iterations)


def _with_lags(window: Window, found: Refinement, cfg: ReadConfig, *, workspace: Workspace) -> Target:
    """Estimate the time constants of the pixels for a candidate, and its pose with their lags undone."""
    target, region = found.target, found.region
    alone = EventBatch.of([window])
    deposit, fresh = depositing(alone, [target.motion], [region], workspace=workspace)
    if fresh:
        deposit.run()
    lag_px, aligned = estimate_lag(
        deposit, target.motion, region, found.measurement.alignment.pose[0], target.space, cfg,
        workspace=workspace,
    )  # fmt: skip
    pose = compose(region.to_px, aligned.pose[0])
    return replace(target, pose=pose / pose[2, 2], tau_us=target.motion.tau_us(lag_px))
