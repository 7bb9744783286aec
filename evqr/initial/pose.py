"""Poses from the search, tried coarsely: which hypotheses deserve a closer look.

Stage one's coarse levels run on the images that the search for finder patterns made already, all hypotheses
of one version in one batch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.config import StageOneConfig
from evqr.initial.finder import Hypothesis, PyramidLevel
from evqr.stage_one import align, coarse_levels
from evqr.workspace import Workspace


@dataclass(frozen=True, eq=False)
class Candidate:
    """A hypothesis after the coarse look.

    Attributes
    ----------
    version         1 to 40
    pose : (3, 3)   code coordinates to px
    score           correlation with the known modules, blurred
    """

    version: int
    pose: NDArray[np.float64]
    score: float


def batches(hypotheses: list[Hypothesis], first: int) -> list[list[Hypothesis]]:
    """Split hypotheses into those tried before the others, ``first`` or a few more, and the others.

    No triple is split: another version of it may agree with a large code well enough to end the search.
    """
    end = first
    while 0 < end < len(hypotheses) and hypotheses[end].triple == hypotheses[end - 1].triple:
        end += 1
    return [batch for batch in (hypotheses[:end], hypotheses[end:]) if batch]


def screen(
    hypotheses: list[Hypothesis], pyramid: list[PyramidLevel], cfg: StageOneConfig, *, workspace: Workspace
) -> tuple[list[Candidate], int]:
    """Refine hypotheses coarsely: those of the best triple, and the others if none of them is clearly a code.

    Returns
    -------
    candidates   best first
    iterations   of Gauss-Newton
    """
    if not hypotheses:
        return [], 0
    cells = np.array([level.cell for level in pyramid])
    poses = np.stack([guess.pose for guess in hypotheses])
    # affine, so a module is as large everywhere
    modules = np.sqrt(np.abs(poses[:, 0, 0] * poses[:, 1, 1] - poses[:, 0, 1] * poses[:, 1, 0]))
    wanted = np.log(modules / cfg.cells_a_module)
    levels = np.abs(np.log(cells) - wanted[:, None]).argmin(axis=1).tolist()
    candidates: list[Candidate] = []
    iterations = 0
    # a version and its neighbours agree with a large code nearly alike, so all of a triple are tried
    first = [k for k, guess in enumerate(hypotheses) if guess.triple == hypotheses[0].triple]
    others = [k for k, guess in enumerate(hypotheses) if guess.triple != hypotheses[0].triple]
    for batch in (first, others):
        groups: dict[tuple[int, int], list[int]] = {}
        for k in batch:
            groups.setdefault((hypotheses[k].version, levels[k]), []).append(k)
        for (version, level), members in groups.items():
            entry = pyramid[level]
            start = entry.from_px @ poses[members]
            found = align(entry.image, start, version, coarse_levels(cfg), cfg, workspace=workspace)
            iterations += found.iterations
            refined = entry.to_px @ found.pose
            refined /= refined[:, 2:, 2:]
            candidates += [
                Candidate(version, pose, score)
                for pose, score in zip(refined, found.score.tolist(), strict=True)
            ]
        if max(candidate.score for candidate in candidates) >= cfg.clear_score:
            break
    candidates.sort(key=lambda candidate: -candidate.score)
    return candidates, iterations
