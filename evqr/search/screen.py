"""Hypotheses that could be codes, aligned coarsely with all that is known of their size.

Stage one's coarse levels run on the images that the search made already.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig
from evqr.fit.align import align, coarse_levels
from evqr.geometry import compose
from evqr.search.hypothesis import Hypotheses
from evqr.search.pyramid import Pyramid
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
    iterations : int
        Gauss-Newton steps.
    """

    space: CodeSpace
    pose: NDArray[np.float64]
    score: float
    iterations: int


def screen(
    hypotheses: Hypotheses,
    window: Sequence[int],
    pyramid: Pyramid,
    cfg: AlignConfig,
    *,
    workspace: Workspace,
) -> list[Candidate]:
    """Refine hypotheses coarsely.

    Parameters
    ----------
    hypotheses : Hypotheses
        Any number, of any windows.
    window : sequence of int
        The window of each.
    pyramid : Pyramid
        What was searched.
    cfg : AlignConfig
        Settings.
    workspace : Workspace
        Buffers.

    Returns
    -------
    candidates : list of Candidate
        In the same order.
    """
    windows = np.asarray(window, np.intp)
    level = pyramid.level_for(windows, hypotheses.pose, cfg.cells_a_module)
    start = compose(pyramid.from_px(windows, level), hypotheses.pose)
    spaces = [hypotheses.space(k) for k in range(len(hypotheses))]
    found = align(
        pyramid.images,
        start,
        spaces,
        coarse_levels(cfg),
        cfg,
        workspace=workspace,
        image_idx=windows.astype(np.int32),
        image_part=pyramid.parts[windows, level],
    )
    poses = compose(pyramid.to_px(windows, level), found.pose)
    poses /= poses[:, 2:, 2:]
    scores, iterations = found.score.tolist(), found.iterations.tolist()
    return [Candidate(*one) for one in zip(spaces, poses, scores, iterations, strict=True)]
