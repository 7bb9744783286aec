"""Symbols with a single finder pattern: Micro QR and rMQR codes.

A peak tells the place of a finder pattern, but size and angle only to half a step of the search; a symbol's
timing lies further out.  So the pattern itself is aligned first, alone, as if it were a symbol.  What several
long sizes begin with, their head, is aligned next; all its sizes are made up from there.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig
from evqr.fit.align import Align, Alignment
from evqr.fit.image import count_for
from evqr.fit.tables import Codes, Level
from evqr.geometry import compose
from evqr.search.hypothesis import Hypotheses
from evqr.search.models import heads, kinds_of, sizes
from evqr.search.pyramid import Pyramid
from evqr.search.score import score
from evqr.search.screen import screen
from evqr.symbol.space import Anchor, CodeSpace, Landmark
from evqr.symbology import Symbology
from evqr.workspace import Workspace

QUARTERS = 4
"""Ways to turn a symbol about its finder pattern, which looks alike turned by a right angle."""

LEVELS = (Level(sigma=0.5, samples=2, tilt=False, tolerance=0.05),)
"""How a finder pattern is aligned alone."""

SHIFTS = 3
"""Places of a pattern along an axis that the motion does not show, a module apart."""

HEADS_A_PATTERN = 6
"""Heads of a pattern that are aligned, the best."""

MIN_HEAD_MATCH = 0.55
"""Mean correlation of a head with finder pattern and timing for it to be aligned: those of codes were seen to
be 0.61 and more, what is none mostly less."""

SEEN_SHARE = 0.1
"""Share of the motion along an axis, squared, from which on the pattern's size along it is seen."""


@functools.cache
def _pattern() -> CodeSpace:
    """Make a symbol of a finder pattern in its separator alone."""
    values = np.ones((9, 9), np.int8)
    for edge, value in ((1, -1), (2, 1), (3, -1)):
        values[edge : 9 - edge, edge : 9 - edge] = value
    anchors = (Anchor(Landmark.FINDER_PATTERN, 4.5, 4.5),)
    return CodeSpace(
        symbology=Symbology.QR_CODE, version="finder pattern", known=values != 0, values=values,
        anchors=anchors, quiet_zone=0,
    )  # fmt: skip


@functools.cache
def _single(symbologies: tuple[Symbology, ...]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Sizes with one finder pattern and no head, in every direction: index, map (N, 3, 3) to `_pattern`."""
    beyond = set(np.concatenate([*heads().values(), np.array([*heads()], np.intp)]).tolist())
    return _turned([k for k in _with_one_pattern(symbologies) if k not in beyond], (1,))


@functools.cache
def _heads(symbologies: tuple[Symbology, ...]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Heads with one finder pattern, in every direction and mirrored, likewise.

    A mirrored square is its own outline, and told when it is decoded; a mirrored rectangle is not.
    """
    return _turned([k for k in _with_one_pattern(symbologies) if k in heads()], (1, -1))


def _with_one_pattern(symbologies: tuple[Symbology, ...]) -> list[int]:
    return [
        k
        for k in np.flatnonzero(kinds_of(symbologies)).tolist()
        if [anchor.kind for anchor in sizes()[k].anchors] == [Landmark.FINDER_PATTERN]
    ]


def _turned(which: list[int], hands: tuple[int, ...]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    found, maps = [], []
    for k in which:
        u, v = sizes()[k].anchors[0].u, sizes()[k].anchors[0].v
        for quarter in range(QUARTERS):
            for hand in hands:
                cos, sin = (1, 0, -1, 0)[quarter], (0, 1, 0, -1)[quarter]
                turn = np.array([[cos, -sin * hand, 4.5], [sin, cos * hand, 4.5], [0.0, 0.0, 1.0]])
                turn[:2, 2] -= np.einsum("ij,j->i", turn[:2, :2], (u, v))
                found.append(k)
                maps.append(turn)
    return np.array(found, np.intp), np.array(maps).reshape(-1, 3, 3)


def with_single_patterns(symbologies: tuple[Symbology, ...]) -> bool:
    """Whether symbols of some kinds have a single finder pattern."""
    return bool(_with_one_pattern(symbologies))


def codes_of_singles(
    peaks: NDArray[np.float32],
    which: NDArray[np.intp],
    window: NDArray[np.intp],
    direction: NDArray[np.float64],
    pyramid: Pyramid,
    cfg: AlignConfig,
    symbologies: tuple[Symbology, ...],
    *,
    workspace: Workspace,
) -> tuple[Hypotheses, NDArray[np.intp]]:
    """Give the codes that finder patterns could each be the only one of: all sizes, in all directions.

    Parameters
    ----------
    peaks : (N, 5) float32
        Response, x, y, size of a module and angle.
    which : (N,) intp
        Indices of the peaks in their windows.
    window : (N,) intp
        The windows of the peaks.
    direction : (N, 2) float64
        Of the motion there, of length 1.
    pyramid : Pyramid
        What was searched.
    cfg : AlignConfig
        Settings.
    symbologies : tuple of Symbology
        Kinds of symbols that they could be.
    workspace : Workspace
        Buffers.

    Returns
    -------
    hypotheses : Hypotheses
        Of each peak in turn all sizes without a head; then those that go with the heads that match.
    window : (M,) intp
        The window of each.
    """
    _, x, y, module_px, angle = peaks.T.astype(np.float64)
    cos, sin = module_px * np.cos(angle), module_px * np.sin(angle)
    pose = np.zeros((len(peaks), 3, 3))
    pose[:, 0, 0], pose[:, 0, 1], pose[:, 1, 0], pose[:, 1, 1] = cos, -sin, sin, cos
    pose[:, 0, 2], pose[:, 1, 2] = x - 4.5 * (cos - sin), y - 4.5 * (sin + cos)
    pose[:, 2, 2] = 1.0
    refined = aligned_patterns(pose, window, pyramid, cfg, workspace=workspace).pose
    refined = _as_seen(refined, direction)
    alone, of_alone = _hypotheses(refined, *_single(symbologies), peaks, which, window)
    begun, of_begun = _hypotheses(refined, *_heads(symbologies), peaks, which, window)
    if not len(begun):
        return alone, of_alone
    grown, of_grown = _grown(begun, of_begun, len(peaks), pyramid, cfg, workspace=workspace)
    return Hypotheses.joined([alone, grown]), np.concatenate([of_alone, of_grown])


def aligned_patterns(
    pose: NDArray[np.float64],
    window: NDArray[np.intp],
    pyramid: Pyramid,
    cfg: AlignConfig,
    *,
    workspace: Workspace,
) -> Alignment:
    """Align finder patterns alone, each as if it were a symbol of 9 modules with its separator.

    Parameters
    ----------
    pose : (N, 3, 3) float64
        Of each [px].
    window : (N,) intp
        The window of each.
    pyramid, cfg, workspace : as of `codes_of_singles`
        The same.

    Returns
    -------
    alignment : Alignment
        Poses in px.
    """
    places = pyramid.places(window, pose, cfg.cells_a_module)
    codes, images, count = Codes.of(workspace), pyramid.images, count_for(len(pose))
    numbers = [codes.number(_pattern())] * len(pose)
    tables = [codes.poses(each, cfg, numbers) for each in LEVELS]
    step = images.once(
        ("finder patterns", count, cfg, tuple(each.version for each in tables)),
        lambda: Align(images, count, tables, cfg.max_iterations, workspace),
    )
    step.write(places.in_cells(pose), places.image_idx, numbers, places.image_part)
    step.run()
    found = step.read()
    return replace(found, pose=places.in_px(found.pose))


def _hypotheses(
    patterns: NDArray[np.float64],
    size: NDArray[np.intp],
    turns: NDArray[np.float64],
    peaks: NDArray[np.float32],
    which: NDArray[np.intp],
    window: NDArray[np.intp],
) -> tuple[Hypotheses, NDArray[np.intp]]:
    """Give every size at every place (P, SHIFTS, 3, 3) of every pattern, and the window of each."""
    count = SHIFTS * len(size)
    made = Hypotheses.of(
        np.tile(size, SHIFTS * len(patterns)),
        compose(patterns[:, :, None], turns).reshape(-1, 3, 3),
        np.repeat(which, 3 * count).reshape(-1, 3),
        np.repeat(peaks[:, 0] < 0.0, count),
    )
    return made, np.repeat(window, count)


def _grown(
    begun: Hypotheses,
    window: NDArray[np.intp],
    n_patterns: int,
    pyramid: Pyramid,
    cfg: AlignConfig,
    *,
    workspace: Workspace,
) -> tuple[Hypotheses, NDArray[np.intp]]:
    """Give all sizes that begin with the heads that match best, aligned, and the window of each."""
    match = score(pyramid, window, begun.size, begun.pose, cfg, workspace=workspace).mean(axis=1)
    every = np.arange(len(begun)).reshape(n_patterns, SHIFTS, -1)
    rows = np.take_along_axis(every, match[every].argmax(axis=1)[:, None], axis=1)[:, 0]  # one place of each
    order = np.argsort(-match[rows], axis=1, kind="stable")[:, :HEADS_A_PATTERN]
    best = np.take_along_axis(rows, order, axis=1)
    best = best[match[best] >= MIN_HEAD_MATCH]
    if not len(best):
        return begun[best], window[best]
    chosen = begun[best]
    aligned = screen(chosen, window[best].tolist(), pyramid, cfg, workspace=workspace)
    # as they are, too: of a head that moves along an axis too little is seen to align it
    good = [k for k, each in enumerate(aligned) if each.score >= cfg.coarse_score]
    pose = np.concatenate([chosen.pose, *(aligned[k].pose[None] for k in good)])
    head = np.array([*range(len(chosen)), *good], np.intp)
    wider = [heads()[size] for size in chosen.size[head].tolist()]
    row = np.repeat(np.arange(len(head)), [len(some) for some in wider])
    of = head[row]
    grown = Hypotheses.of(np.concatenate(wider), pose[row], chosen.peaks[of], chosen.inverted[of])
    return grown, window[best][of]


def _as_seen(pose: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give poses (N, SHIFTS, 3, 3) of `_pattern` for poses (N, 3, 3), without what the motion does not show.

    Edges along the motion cause no events: of a pattern that moves along one of its axes size and place along
    the other are as good as unknown.  The size is taken to be the same, and the place to be one of several.
    """
    (a, b), (c, d) = np.moveaxis(pose[:, :2, :2], 0, -1)
    det = a * d - b * c
    u_x, u_y, v_x, v_y = d / det, -b / det, -c / det, a / det  # how u and v grow along x and y
    m_x, m_y = direction.T
    share_u, share_v = (u_x * m_x + u_y * m_y) ** 2, (v_x * m_x + v_y * m_y) ** 2
    share_u = share_u / (share_u + share_v)
    # turned and scaled alike along both axes, as the better seen says
    x = share_u * u_x + (1.0 - share_u) * v_y
    y = share_u * u_y - (1.0 - share_u) * v_x
    of_u, of_v = (np.minimum(share / SEEN_SHARE, 1.0) for share in (share_u, 1.0 - share_u))
    u_x, u_y = of_u * u_x + (1.0 - of_u) * x, of_u * u_y + (1.0 - of_u) * y
    v_x, v_y = of_v * v_x - (1.0 - of_v) * y, of_v * v_y + (1.0 - of_v) * x
    det = u_x * v_y - u_y * v_x
    seen = np.zeros_like(pose)
    seen[:, 0, 0], seen[:, 0, 1], seen[:, 1, 0], seen[:, 1, 1] = v_y / det, -u_y / det, -v_x / det, u_x / det
    # about the centre of the pattern
    seen[:, :2, 2] = pose[:, :2, 2] + 4.5 * (pose[:, :2, :2] - seen[:, :2, :2]).sum(axis=2)
    seen[:, 2, 2] = 1.0
    shifted = np.repeat(seen[:, None], SHIFTS, axis=1)
    steps = np.arange(SHIFTS) - SHIFTS // 2
    hidden = (1.0 - of_u)[:, None] * seen[:, :2, 0] + (1.0 - of_v)[:, None] * seen[:, :2, 1]
    shifted[:, :, :2, 2] += steps[:, None] * hidden[:, None]
    return shifted
