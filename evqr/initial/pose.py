"""Poses from the search, tried coarsely all at once: which hypotheses deserve a closer look.

Stage one's coarse levels run on the images that the search for finder patterns made already, all hypotheses
of one version in one batch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.codespace import size_of
from evqr.config import StageOneConfig
from evqr.initial.finder import Hypothesis, PyramidLevel
from evqr.region import module_px
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


def screen(
    hypotheses: list[Hypothesis], pyramid: list[PyramidLevel], cfg: StageOneConfig, *, workspace: Workspace
) -> tuple[list[Candidate], int]:
    """Refine all hypotheses coarsely.

    Returns
    -------
    candidates   best first
    iterations   of Gauss-Newton
    """
    groups: dict[tuple[int, int], list[Hypothesis]] = {}
    for guess in hypotheses:
        cell = module_px(guess.pose, size_of(guess.version)) / cfg.cells_a_module
        level = int(np.argmin([abs(np.log(entry.cell / cell)) for entry in pyramid]))
        groups.setdefault((guess.version, level), []).append(guess)
    candidates: list[Candidate] = []
    iterations = 0
    for (version, level), members in groups.items():
        entry = pyramid[level]
        start = entry.from_px @ np.stack([guess.pose for guess in members])
        found = align(entry.image, start, version, coarse_levels(cfg), cfg, workspace=workspace)
        iterations += found.iterations
        poses = np.linalg.inv(entry.from_px) @ found.pose
        poses /= poses[:, 2:, 2:]
        candidates += [
            Candidate(version, pose, float(score)) for pose, score in zip(poses, found.score, strict=True)
        ]
    candidates.sort(key=lambda candidate: -candidate.score)
    return candidates, iterations
