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
    places = pyramid.places(np.asarray(window, np.intp), hypotheses.pose, cfg.cells_a_module)
    spaces = [hypotheses.space(k) for k in range(len(hypotheses))]
    found = align(
        pyramid.images,
        places.in_cells(hypotheses.pose),
        spaces,
        coarse_levels(cfg),
        cfg,
        workspace=workspace,
        image_idx=places.image_idx,
        image_part=places.image_part,
    )
    scores, iterations = found.score.tolist(), found.iterations.tolist()
    poses = places.in_px(found.pose)
    return [Candidate(*one) for one in zip(spaces, poses, scores, iterations, strict=True)]
