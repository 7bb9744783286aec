"""Candidates of a search, each refined on an image of its own; and how their pixels lag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from evqr.clock import StageClock
from evqr.config import AlignConfig, ReadConfig
from evqr.events.batch import EventBatch
from evqr.fit.align import escape_side_minimum
from evqr.fit.detection import NO_LAG, Detection, Target
from evqr.fit.lag import estimate_lags
from evqr.fit.measure import measure, measuring
from evqr.fit.region import in_cells, in_px
from evqr.fit.targets import Targets
from evqr.motion import Motion
from evqr.symbol.space import CodeSpace, closed
from evqr.values import Value
from evqr.workspace import Workspace


class Guess(Protocol):
    """Where a code might be: its space and pose (3, 3) [px]."""

    @property
    def space(self) -> CodeSpace:
        """Kind and size of the code."""
        ...

    @property
    def pose(self) -> NDArray[np.float64]:
        """Code coordinates to px (3, 3)."""
        ...


@dataclass(frozen=True, eq=False)
class Refinement(Value):
    """A candidate, refined.

    Attributes
    ----------
    target : Target
        What was looked for: its pose is the candidate's.
    region : (5,) float64
        Around the candidate, as of `Regions`.
    detection : Detection
        What came out, before lags are estimated.
    escaped : bool
        Whether a pose one module away was better, so that the equations are not of the detection's pose.
    iterations : int
        Gauss-Newton steps, of all candidates of the window.
    """

    target: Target
    region: NDArray[np.float64]
    detection: Detection
    escaped: bool
    iterations: int = 0

    @property
    def score(self) -> float:
        """Correlation with the known modules."""
        return self.detection.score


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
    one, count = cfg.align, len(batch)
    tried: list[list[Refinement]] = [[] for _ in range(count)]
    pending = list(range(count))
    while pending:
        # on a CPU one candidate of each window at a time: those behind a good one are not looked at
        together = 1 if workspace.shared else max(len(candidates[k]) - len(tried[k]) for k in pending)
        rows = [
            (k, candidate)
            for k in pending
            for candidate in candidates[k][len(tried[k]) : len(tried[k]) + together]
        ]
        targets = [
            Target(candidate.space, candidate.pose, motions[k], tau_us[k] or NO_LAG) for k, candidate in rows
        ]
        refined = _refined(batch.pick([k for k, _ in rows]), targets, cfg, workspace=workspace)
        for (k, _), each in zip(rows, refined, strict=True):
            if not (tried[k] and _is_good(tried[k][-1], one)):
                tried[k].append(each)
        pending = [
            k for k in pending if len(tried[k]) < len(candidates[k]) and not _is_good(tried[k][-1], one)
        ]
    return [
        max(of_window, key=lambda refinement: refinement.score).altered(
            iterations=sum(refinement.detection.iterations for refinement in of_window)
        )
        for of_window in tried
    ]


def _is_good(refinement: Refinement, cfg: AlignConfig) -> bool:
    """Whether no other candidate of the window is looked at."""
    # with a single finder pattern another size may agree well before the right one has its turn
    return refinement.score >= cfg.good_score and not refinement.target.space.single_pattern


def _refined(
    batch: EventBatch, targets: Sequence[Target], cfg: ReadConfig, *, workspace: Workspace
) -> list[Refinement]:
    """Refine one candidate a window."""
    one, placed = cfg.align, Targets(targets)
    regions = placed.regions(one, margin_px=cfg.finder.margin_px)
    step = measuring(batch, placed, regions, cfg, workspace=workspace)
    step.run()
    found = step.read()
    alignment, escaped = escape_side_minimum(
        step.images, found.alignment, placed.spaces, one, workspace=workspace
    )
    found = replace(found, alignment=alignment)
    detections = found.detections(placed, regions)
    return [Refinement(*one) for one in zip(targets, regions, detections, escaped.tolist(), strict=True)]


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
    detections: list[Detection] = []
    lagging: list[int] = []
    unsure: list[int] = []
    for k, (found, tau) in enumerate(zip(refinements, tau_us, strict=True)):
        detections.append(found.detection.altered(iterations=found.iterations))
        if tau is None and found.score < cfg.align.sharp_score:
            lagging.append(k)
        elif found.escaped:
            unsure.append(k)
    groups = [(unsure, [detections[k].target for k in unsure])]
    if lagging:
        with clock("lag"):
            found = [refinements[k] for k in lagging]
            # measured at once and by themselves: their deposits are still there
            groups.insert(0, (lagging, _with_lags(batch.pick(lagging), found, cfg, workspace=workspace)))
    for rows, targets in groups:
        if not rows:
            continue
        regions, placed = np.stack([refinements[k].region for k in rows]), Targets(targets)
        with clock("stage_one"):
            measured = measure(batch.pick(rows), placed, regions, cfg, workspace=workspace)
        made = measured.detections(placed, regions, [refinements[k].iterations for k in rows])
        for k, detection in zip(rows, made, strict=True):
            detections[k] = detection
    return detections


def _with_lags(
    batch: EventBatch, found: Sequence[Refinement], cfg: ReadConfig, *, workspace: Workspace
) -> list[Target]:
    """Estimate the time constants of the pixels for candidates, and their poses with the lags undone."""
    targets, regions = Targets([each.target for each in found]), np.stack([each.region for each in found])
    pose = in_cells(regions, np.stack([each.detection.pose for each in found]))
    lags_px, aligned = estimate_lags(batch, targets, regions, pose, cfg, workspace=workspace)
    seen = closed(in_px(regions, aligned.pose))
    return [
        each.target.altered(pose=seen[k], tau_us=each.target.motion.tau_us((on, off)))
        for k, (each, (on, off)) in enumerate(zip(found, lags_px.tolist(), strict=True))
    ]
