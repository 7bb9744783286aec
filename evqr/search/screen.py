"""Poses from the search, tried coarsely: which hypotheses deserve a closer look.

Stage one's coarse levels run on the images that the search for finder patterns made already, all hypotheses
of one code space in one batch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig
from evqr.fit.align import align, coarse_levels
from evqr.geometry import compose
from evqr.search.finder import PyramidLevel
from evqr.search.hypothesis import Hypothesis
from evqr.symbol.space import CodeSpace
from evqr.workspace import Workspace


@dataclass(frozen=True, eq=False)
class Candidate:
    """A hypothesis after the coarse look.

    Attributes
    ----------
    space : CodeSpace
        Kind and size of the code.
    pose : (3, 3) float64
        Code coordinates to px.
    score : float
        Correlation with the known modules, blurred.
    """

    space: CodeSpace
    pose: NDArray[np.float64]
    score: float


def batches(hypotheses: list[Hypothesis], first: int) -> list[list[Hypothesis]]:
    """Split hypotheses into those tried before the others, ``first`` or a few more, and the others.

    Those of the same finder patterns stay together: another size may agree with a large code well enough to
    end the search.
    """
    end = first
    while 0 < end < len(hypotheses) and hypotheses[end].patterns == hypotheses[end - 1].patterns:
        end += 1
    return [batch for batch in (hypotheses[:end], hypotheses[end:]) if batch]


def screen(
    hypotheses: list[Hypothesis], pyramid: list[PyramidLevel], cfg: AlignConfig, *, workspace: Workspace
) -> tuple[list[Candidate], int]:
    """Refine hypotheses coarsely: those of the best finder patterns; the others if none is clearly a code.

    Parameters
    ----------
    hypotheses : list of Hypothesis
        Of one search, best first.
    pyramid : list of PyramidLevel
        The images of that search.
    cfg : AlignConfig
        Settings.
    workspace : Workspace
        Buffers.

    Returns
    -------
    candidates : list of Candidate
        Best first.
    iterations : int
        Of Gauss-Newton.
    """
    if not hypotheses:
        return [], 0
    levels = [_level_for(guess.pose, pyramid, cfg) for guess in hypotheses]
    candidates: list[Candidate] = []
    iterations = 0
    # a size and its neighbours agree with a large code nearly alike, so all of some patterns are tried
    first = [k for k, guess in enumerate(hypotheses) if guess.patterns == hypotheses[0].patterns]
    others = [k for k, guess in enumerate(hypotheses) if guess.patterns != hypotheses[0].patterns]
    for batch in (first, others):
        groups: dict[tuple[CodeSpace, int], list[int]] = {}
        for k in batch:
            groups.setdefault((hypotheses[k].space, levels[k]), []).append(k)
        for (space, level), members in groups.items():
            entry = pyramid[level]
            start = compose(entry.from_px, np.array([hypotheses[k].pose for k in members]))
            found = align(entry.image, start, space, coarse_levels(cfg), cfg, workspace=workspace)
            iterations += int(found.iterations.max())
            refined = compose(entry.to_px, found.pose)
            refined /= refined[:, 2:, 2:]
            candidates += [
                Candidate(space, pose, score)
                for pose, score in zip(refined, found.score.tolist(), strict=True)
            ]
        if max(candidate.score for candidate in candidates) >= cfg.clear_score:
            break
    candidates.sort(key=lambda candidate: -candidate.score)
    return candidates, iterations


def _level_for(pose: NDArray[np.float64], pyramid: list[PyramidLevel], cfg: AlignConfig) -> int:
    """Give the level whose cells are nearest to the wanted part of a module."""
    # affine, so a module is as large everywhere
    (a, b, _), (d, e, _), _ = pose.tolist()
    wanted = math.sqrt(abs(a * e - b * d)) / cfg.cells_a_module
    return min(range(len(pyramid)), key=lambda k: max(pyramid[k].cell / wanted, wanted / pyramid[k].cell))
