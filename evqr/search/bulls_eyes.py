"""Symbols about a bull's eye: Aztec.

To the matched filter of a finder pattern a bull's eye is one of opposite polarity, by its squares of seven,
five and three modules; so there is no filter of its own.  The bull's eye is aligned alone, then as the core
of a compact symbol and as that of one of full range.  Size and direction are told by the mode message, once
it is read.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig
from evqr.geometry import compose
from evqr.search.hypothesis import Hypotheses
from evqr.search.models import sizes
from evqr.search.pyramid import Pyramid
from evqr.search.screen import aligned
from evqr.search.singles import LEVELS
from evqr.symbol.space import CodeSpace, Landmark
from evqr.symbology import Symbology
from evqr.workspace import Workspace

SIDE = 9
"""Modules a side of the bull's eye of compact symbols, which is the middle of the other."""

MIN_SCORE = 0.75
"""Correlation of a bull's eye, aligned, for symbols to be made up about it: those of codes were seen to have
0.93 and more, finder patterns up to 0.82."""

FULL_SHARE = 0.75
"""Of the correlation with a compact bull's eye that one of full range needs, where that is what it is."""


@functools.cache
def _bulls_eye() -> CodeSpace:
    """Make a symbol of a bull's eye alone."""
    ring = np.abs(np.indices((SIDE, SIDE)) - SIDE // 2).max(axis=0)
    values = np.where(ring % 2, 1, -1).astype(np.int8)
    return CodeSpace(
        symbology=Symbology.AZTEC, version="bull's eye", known=values != 0, values=values, anchors=(),
        quiet_zone=0,
    )  # fmt: skip


@functools.cache
def _symbols() -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Sizes about a bull's eye: index, and map (N, 3, 3) to `_bulls_eye`."""
    found = [k for k, size in enumerate(sizes()) if size.anchors[0].kind is Landmark.BULLS_EYE]
    maps = np.tile(np.eye(3), (len(found), 1, 1))
    for each, k in zip(maps, found, strict=True):
        each[:2, 2] = 0.5 * SIDE - np.array((sizes()[k].anchors[0].u, sizes()[k].anchors[0].v))
    return np.array(found, np.intp), maps


def codes_of_bulls_eyes(
    peaks: NDArray[np.float32],
    which: NDArray[np.intp],
    window: NDArray[np.intp],
    pyramid: Pyramid,
    cfg: AlignConfig,
    *,
    workspace: Workspace,
) -> tuple[Hypotheses, NDArray[np.intp], NDArray[np.float32]]:
    """Give the codes that peaks could be the bull's eyes of.

    Parameters
    ----------
    peaks : (N, 5) float32
        Response, x, y, size of a module and angle.
    which : (N,) intp
        Indices of the peaks in their windows.
    window : (N,) intp
        The windows of the peaks.
    pyramid : Pyramid
        What was searched.
    cfg : AlignConfig
        Settings.
    workspace : Workspace
        Buffers.

    Returns
    -------
    hypotheses : Hypotheses
        Aligned.
    window : (M,) intp
        The window of each.
    score : (M,) float32
        Correlation with all that is known.
    """
    _, x, y, module_px, angle = peaks.T.astype(np.float64)
    cos, sin = module_px * np.cos(angle), module_px * np.sin(angle)
    pose = np.zeros((len(peaks), 3, 3))
    pose[:, 0, 0], pose[:, 0, 1], pose[:, 1, 0], pose[:, 1, 1] = cos, -sin, sin, cos
    pose[:, 0, 2], pose[:, 1, 2] = x - 0.5 * SIDE * (cos - sin), y - 0.5 * SIDE * (sin + cos)
    pose[:, 2, 2] = 1.0
    eyes = [_bulls_eye()] * len(peaks)
    found = aligned(pyramid, window, pose, eyes, LEVELS, cfg, workspace=workspace)
    poses = found.pose
    poses[:, 2, :2] = 0.0
    good = np.flatnonzero(found.score >= MIN_SCORE)
    size, turns = _symbols()
    count = len(size)
    made = Hypotheses.of(
        np.tile(size, len(good)),
        compose(poses[good][:, None], turns).reshape(-1, 3, 3),
        np.repeat(which[good], 3 * count).reshape(-1, 3),
        np.repeat(peaks[good, 0] > 0.0, count),
    )
    of_each = np.repeat(window[good], count)
    if not len(made):
        return made, of_each, np.zeros(0, np.float32)
    spaces = [made.space(k) for k in range(len(made))]
    found = aligned(pyramid, of_each, made.pose, spaces, LEVELS, cfg, workspace=workspace)
    scores = found.score.astype(np.float32)
    # what is compact is a part of what is not, so it agrees with both
    compact, full = scores.reshape(-1, count).T
    of_full = full >= FULL_SHARE * compact
    best = np.arange(len(good)) * count + of_full
    made = made[best]
    found = Hypotheses.of(made.size, found.pose[best], made.peaks, made.inverted)
    return found, of_each[best], scores[best]
