"""QR codes whose plane is tilted: three finder patterns that differ in size and are no squares.

The search takes patterns for upright, so that its peaks lie up to a module off and tell little of their
shapes.  Here each pattern of the best triples is aligned alone, as if it were a symbol, from the shape that
the legs of its triple suggest.  The frames of the three then tell the perspective: along a line a module is
seen in 1 / w^2 of its size, w the depth, and two places that are d px apart have d / sqrt(s_a s_b) modules
between them, s the sizes of a module there.

Edges along the motion cause no events: what they alone would tell is taken from the triple and from the other
axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig
from evqr.search.finder import Found
from evqr.search.hypothesis import Hypotheses
from evqr.search.models import pattern
from evqr.search.pyramid import Pyramid
from evqr.search.score import score
from evqr.search.singles import aligned_patterns
from evqr.search.triples import three_cornered
from evqr.workspace import Workspace

MOST_TRIPLES = 100
"""Triples of a window whose patterns are looked at, those that respond best."""

TRIPLES = 6
"""Triples whose patterns are aligned, those that respond best, and as many whose patterns are seen best."""

MIN_PATTERN = 0.45
"""Correlation of the worst of three aligned patterns."""

STARTS = (-1.0, 0.0, 1.0)
"""How far along an axis a pattern may lie from its peak [modules]."""

SIZES = 0.8, 1.0, 1.25
"""How much larger patterns may be than their peaks say."""

SHOWN = 0.02
"""Share of the motion along an axis, squared, from which on a pattern's size along it is seen."""

LEAST_SIZE = 0.25
"""Area of a module below which a pattern is none [px^2]."""

MODULES = 0.15
"""How well the number of modules between two patterns is known, |log|."""


@dataclass(frozen=True, eq=False)
class Patterns:
    """Finder patterns of N triples, aligned, those whose worst is seen best first.

    Attributes
    ----------
    peaks : (N, 3) intp
        Which they are in their windows: at the corner, along u and along v.
    place : (N,) intp
        Of the windows that were given, which each is of.
    inverted : (N,) bool
        Light modules on dark.
    worst : (N,) float64
        Correlation of the worst of the three.
    centre : (N, 3, 2) float64 [px]
        Of the patterns.
    shape : (N, 3, 2, 2) float64 [px]
        Columns: a module along u and along v, at each pattern.
    shown : (N, 2) float64
        How well sizes along u and v are seen, 0 to 1.
    """

    peaks: NDArray[np.intp]
    place: NDArray[np.intp]
    inverted: NDArray[np.bool_]
    worst: NDArray[np.float64]
    centre: NDArray[np.float64]
    shape: NDArray[np.float64]
    shown: NDArray[np.float64]


def patterns_of_triples(
    found: Sequence[Found],
    windows: Sequence[int],
    directions: NDArray[np.float64],
    pyramid: Pyramid,
    cfg: AlignConfig,
    *,
    workspace: Workspace,
) -> Patterns:
    """Align the patterns of the best triples.

    Parameters
    ----------
    found : sequence of Found
        Patterns of some windows and triples of them.
    windows : sequence of int
        Which windows they are.
    directions : (N, 2) float64
        Of the motion in each, of length 1.
    pyramid : Pyramid
        What was searched.
    cfg : AlignConfig
        Settings.
    workspace : Workspace
        Buffers.

    Returns
    -------
    patterns : Patterns
        Of all windows.  What comes out of one does not depend on the others.
    """
    triples = [one.triples[:MOST_TRIPLES] for one in found]
    which = np.concatenate([some[:, 1:4] for some in triples]).astype(np.intp)
    of_each = np.repeat(np.arange(len(found)), [len(some) for some in triples])
    if not len(which):
        return _no_patterns()
    pairs = zip(found, triples, strict=True)
    peaks = np.concatenate([one.peaks.table[some[:, 1:4].astype(np.intp)] for one, some in pairs])
    place, inverted = peaks[..., 1:3].astype(np.float64), peaks[:, 0, 0] < 0.0
    modules = np.exp(np.concatenate([some[:, 4] for some in triples]).astype(np.float64))[:, None]
    frame = np.zeros((len(which), 3, 3, 3))
    frame[..., :2, 0] = ((place[:, 1] - place[:, 0]) / modules)[:, None]
    frame[..., :2, 1] = ((place[:, 2] - place[:, 0]) / modules)[:, None]
    frame[..., :2, 2] = place
    frame[..., 2, 2] = 1.0
    image = np.asarray(windows, np.intp)[of_each]
    frame, seen = _best_starts(frame, (0.0,), image, pyramid, cfg, workspace)
    best = _promising(seen, of_each)
    of_each, image = of_each[best], image[best]
    frame, _ = _best_starts(frame[best], STARTS, image, pyramid, cfg, workspace)
    place = frame[..., :2, 2].copy()
    frame[..., :2, 2] -= 4.5 * frame[..., :2, :2].sum(axis=-1)
    aligned = aligned_patterns(frame.reshape(-1, 3, 3), image.repeat(3), pyramid, cfg, workspace=workspace)
    centre, shape, shown = _as_seen(aligned.pose.reshape(-1, 3, 3, 3), place, directions[of_each])
    worst = aligned.score.reshape(-1, 3).min(axis=1)
    order = np.argsort(-worst, kind="stable")
    order = order[(worst[order] >= MIN_PATTERN) & (shown[order].max(axis=1) > 0.0)]
    chosen = best[order]
    return Patterns(
        which[chosen], of_each[order], inverted[chosen], worst[order], centre[order], shape[order],
        shown[order],
    )  # fmt: skip


def _no_patterns() -> Patterns:
    number, size = np.zeros(0, np.intp), np.zeros(0)
    return Patterns(
        np.zeros((0, 3), np.intp), number, number.astype(bool), size, np.zeros((0, 3, 2)),
        np.zeros((0, 3, 2, 2)), np.zeros((0, 2)),
    )  # fmt: skip


def codes_of_tilted(patterns: Patterns, windows: int) -> list[Hypotheses]:
    """Give the codes that patterns could be the corners of, seen in perspective.

    Parameters
    ----------
    patterns : Patterns
        Of so many windows.
    windows : int
        How many.

    Returns
    -------
    hypotheses : list of Hypotheses
        Of each window, those whose patterns are seen best first.
    """
    row, size, pose = _in_perspective(patterns.centre, patterns.shape, patterns.shown)
    made = Hypotheses.of(size, pose, patterns.peaks[row], patterns.inverted[row])
    return [made[patterns.place[row] == k] for k in range(windows)]


def _promising(seen: NDArray[np.float32], of_each: NDArray[np.intp]) -> NDArray[np.intp]:
    """Give the triples of windows that respond best, which are their first, and those that are seen best."""
    chosen = []
    for k in np.unique(of_each):
        rows = np.flatnonzero(of_each == k)
        chosen.append(np.union1d(rows[:TRIPLES], rows[np.argsort(-seen[rows], kind="stable")[:TRIPLES]]))
    return np.concatenate(chosen)


def _best_starts(
    centred: NDArray[np.float64],
    starts: tuple[float, ...],
    window: NDArray[np.intp],
    pyramid: Pyramid,
    cfg: AlignConfig,
    workspace: Workspace,
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Give frames about centres of patterns (N, 3, 3, 3) as they are seen best, and how well (N,).

    Each is moved; the three of a triple are made larger or smaller together.
    """
    steps = np.array([(u, v) for u in starts for v in starts])
    tried = np.repeat(centred[:, :, None, None], len(SIZES), axis=2).repeat(len(steps), axis=3)
    tried[..., :2, :2] *= np.array(SIZES)[:, None, None, None]
    tried[..., :2, 2] += np.einsum("nksmij,mj->nksmi", tried[..., :2, :2], steps)
    flat = tried.reshape(-1, 3, 3)
    image, kind = window.repeat(len(flat) // len(window)), np.zeros(len(flat), np.intp)
    seen = score(pyramid, image, kind, flat, cfg, workspace=workspace, known=pattern())
    found = seen[:, 0].reshape(tried.shape[:4])
    together = found.max(axis=3).sum(axis=1)
    size = together.argmax(axis=1)[:, None]
    row, k = np.arange(len(centred))[:, None], np.arange(3)
    return tried[row, k, size, found[row, k, size].argmax(axis=2)], together.max(axis=1)


def _as_seen(
    frame: NDArray[np.float64], place: NDArray[np.float64], directions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Give centres (N, 3, 2), shapes (N, 3, 2, 2) and how well u and v are seen (N, 2) of frames."""
    shape = frame[..., :2, :2]
    (a, b), (c, d) = np.moveaxis(shape, (-2, -1), (0, 1))
    size = a * d - b * c
    flat = np.abs(size) < LEAST_SIZE
    inverse = np.moveaxis(np.array([[d, -b], [-c, a]]) / np.where(flat, 1.0, size), (0, 1), (-2, -1))
    share = np.einsum("nkij,nj->nki", inverse, directions) ** 2
    share = (share / np.maximum(share.sum(axis=-1, keepdims=True), 1e-12)).mean(axis=1)
    shown = np.where(flat.any(axis=1)[:, None], 0.0, np.minimum(share / SHOWN, 1.0))
    moved = 4.5 * shape.sum(axis=-1) + frame[..., :2, 2] - place
    along = np.einsum("nkij,nkj->nki", inverse, moved) * shown[:, None]
    return place + np.einsum("nkij,nkj->nki", shape, along), shape, shown


def _in_perspective(
    centre: NDArray[np.float64], shape: NDArray[np.float64], shown: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Give the codes of all sizes that fit three patterns: row, size, pose (M, 3, 3)."""
    long_u, long_v = (np.hypot(shape[..., 0, k], shape[..., 1, k]) for k in range(2))
    leg_u, leg_v = (np.hypot(*(centre[:, k] - centre[:, 0]).T) for k in (1, 2))
    along = np.log(leg_u) - 0.5 * np.log(long_u[:, 0] * long_u[:, 1])
    down = np.log(leg_v) - 0.5 * np.log(long_v[:, 0] * long_v[:, 2])
    modules = (shown * np.stack([along, down], axis=1)).sum(axis=1) / shown.sum(axis=1)
    depth_u = (long_u[:, 0] / long_u[:, 1]) ** (0.5 * shown[:, 0])
    depth_v = (long_v[:, 0] / long_v[:, 2]) ** (0.5 * shown[:, 1])
    log_leg, place = three_cornered()
    row, kind = np.nonzero(np.abs(modules[:, None] - log_leg) < MODULES)
    u, v, per_u, per_v, size = place[kind].T[..., None]
    corner = centre[row, 0]
    pose = np.zeros((len(row), 3, 3))
    pose[:, :2, 0] = (depth_u[row, None] * centre[row, 1] - corner) * per_u
    pose[:, :2, 1] = (depth_v[row, None] * centre[row, 2] - corner) * per_v
    pose[:, :2, 2] = corner
    pose[:, 2, 0], pose[:, 2, 1] = (depth_u[row] - 1.0) * per_u[:, 0], (depth_v[row] - 1.0) * per_v[:, 0]
    pose[:, 2, 2] = 1.0
    pose[..., 2] -= u * pose[..., 0] + v * pose[..., 1]
    before = pose[:, 2, 2] > 0.0  # else what is at 0 is behind the camera
    return row[before], size[before, 0].astype(np.intp), pose[before] / pose[before, 2:, 2:]
