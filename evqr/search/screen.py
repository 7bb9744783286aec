"""Hypotheses that could be codes, aligned coarsely with all that is known of their size.

Stage one's coarse levels run on the images that the search made already.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig
from evqr.fit.align import Alignment, align, coarse_levels
from evqr.fit.tables import Level
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
    spaces = [hypotheses.space(k) for k in range(len(hypotheses))]
    of_each, levels = np.asarray(window, np.intp), coarse_levels(cfg)
    found = aligned(pyramid, of_each, hypotheses.pose, spaces, levels, cfg, workspace=workspace)
    scores, iterations = found.score.tolist(), found.iterations.tolist()
    return [Candidate(*one) for one in zip(spaces, found.pose, scores, iterations, strict=True)]


def aligned(
    pyramid: Pyramid,
    window: NDArray[np.intp],
    pose: NDArray[np.float64],
    spaces: Sequence[CodeSpace],
    levels: tuple[Level, ...],
    cfg: AlignConfig,
    *,
    workspace: Workspace,
) -> Alignment:
    """Refine poses (N, 3, 3) [px] of codes in windows (N,), each in the level that suits its modules."""
    places = pyramid.places(window, pose, cfg.cells_a_module)
    found = align(
        pyramid.images, places.in_cells(pose), spaces, levels, cfg,
        workspace=workspace, image_idx=places.image_idx, image_part=places.image_part,
    )  # fmt: skip
    return replace(found, pose=places.in_px(found.pose))
