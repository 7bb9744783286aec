"""Symbols with two solid sides: Data Matrix.

They have no finder pattern, but an L: two edges, straight and dark all along, that meet in a corner.  One of
them is enough, for the other may run along the motion and cause no events: every straight edge of a window
could be either leg, with the corner at either end, of a symbol of any size.  Which it is the dashed sides
tell, across from the L.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from evqr.config import ReadConfig
from evqr.fit.tables import Level
from evqr.geometry import compose
from evqr.search.edges import Edges
from evqr.search.hypothesis import Hypotheses
from evqr.search.models import dashes, kinds_of, sizes
from evqr.search.pyramid import Pyramid
from evqr.search.score import score
from evqr.search.screen import aligned
from evqr.symbol.space import Landmark
from evqr.symbol.symbols import SYMBOLS
from evqr.symbology import Symbology
from evqr.workspace import Workspace

LEVELS = (Level(sigma=0.5, samples=2, tilt=False, tolerance=0.05),)
"""How a symbol is aligned by its sides."""

SIZES_AN_EDGE = 6
"""Hypotheses of one edge that are aligned, the best."""

END_PX = 1.5
"""How well the length of an edge is known."""

LEAST_BUSY = 0.3
"""Share of places beside an edge at which something happens, where the symbol would be: in symbols it was
seen to be 0.75 and more, 0.4 in a window with few events, and nearly 0 where nothing is printed."""

ALONG = 0.35
"""Share of the motion across a leg, below which it is not taken for granted that it is found."""

FAR_STEP = 1.2
"""Places of a far side that are tried are so far apart [modules]."""

OFF = (-0.6, 0.0, 0.6)
"""How far each end of an edge, and the far side, may be off [modules]."""


@functools.cache
def _legs(
    symbologies: tuple[Symbology, ...],
) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.bool_]]:
    """Sizes with an L, by the legs that an edge could be.

    Which of `sizes` (N,); its modules (N, 2) along the edge and across; whether the edge is the bottom (N,).
    """
    found = []
    for k in np.flatnonzero(kinds_of(symbologies)).tolist():
        if sizes()[k].anchors[0].kind is Landmark.SOLID_CORNER:
            rows, columns = SYMBOLS[sizes()[k].symbology].sizes[sizes()[k].version]
            found += [(k, rows, columns, False), (k, columns, rows, True)]
    table = np.array(found, np.intp).reshape(-1, 4)
    return table[:, 0], table[:, 1:3].astype(np.float64), table[:, 3].astype(np.bool_)


def with_solid_corners(symbologies: tuple[Symbology, ...]) -> bool:
    """Whether symbols of some kinds have two solid sides."""
    return bool(len(_legs(symbologies)[0]))


def _hypotheses(edges: Edges, direction: NDArray[np.float64], first: int, cfg: ReadConfig) -> Hypotheses:
    """Give all codes of a window that edges could be legs of."""
    size, modules, bottom = _legs(cfg.symbologies)
    square = modules[:, 0] == modules[:, 1]
    way = edges.end - edges.start
    length = np.hypot(*way.T)
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
    # light turns dark where the motion goes into what is dark
    dark_side = np.sign((normal * direction).sum(axis=1)) * edges.sign
    module_px = length[:, None] / modules[:, 0]
    fits = (module_px >= 0.93 * cfg.finder.smallest_module_px) & (module_px <= cfg.finder.largest_module_px)
    edge, leg = np.nonzero(fits)
    shown = np.abs((way * direction).sum(axis=1)) / np.maximum(length, 1e-9)  # how well the other leg is
    edge, leg, stretched = _stretched(edge, leg, modules, module_px, shown)
    made = []
    for inverted in (False, True):
        side = -dark_side if inverted else dark_side
        into = normal * side[:, None]
        full = np.where(side > 0.0, edges.busy[:, 0], edges.busy[:, 1]) >= LEAST_BUSY
        for swapped in (False, True):
            corner, along = (edges.end, -way) if swapped else (edges.start, way)
            # a square and its mirror image have one outline: one of the two is enough
            turned = (along[:, 0] * into[:, 1] - along[:, 1] * into[:, 0]) > 0.0
            keep = (~square[leg] | (turned[edge] != bottom[leg])) & full[edge]
            e, n, stretch = edge[keep], leg[keep], stretched[keep]
            px = module_px[e, n][:, None]
            a, b = along[e] / length[e, None] * px, into[e] * px * stretch[:, None]
            on_u = bottom[n][:, None]
            u, v = np.where(on_u, a, b), -np.where(on_u, b, a)
            pose = np.zeros((len(e), 3, 3))
            pose[:, :2, 0], pose[:, :2, 1] = u, v
            rows = np.where(bottom[n], modules[n, 1], modules[n, 0])
            pose[:, :2, 2] = corner[e] - rows[:, None] * v
            pose[:, 2, 2] = 1.0
            made.append(
                Hypotheses.of(
                    size[n], pose, np.repeat(first + e, 3).reshape(-1, 3), np.full(len(e), inverted)
                )
            )
    return Hypotheses.joined(made)


def _evidence(
    pyramid: Pyramid, window: NDArray[np.intp], codes: Hypotheses, cfg: ReadConfig, workspace: Workspace
) -> NDArray[np.float64]:
    """Give how much the dashed sides say for codes, whatever their phase, in nats.

    By chance small symbols match more easily, and one of the sides may run along the motion.
    """
    known, count = dashes(), len(codes)
    both = np.concatenate([2 * codes.size, 2 * codes.size + 1])
    poses = np.concatenate([codes.pose, codes.pose])
    seen = score(pyramid, np.tile(window, 2), both, poses, cfg.align, workspace=workspace, known=known)[:, 0]
    points = 0.5 * (known.ptr[both, 1] - known.ptr[both, 0])
    said = -0.5 * points * np.log1p(-np.square(np.minimum(seen, 0.99).astype(np.float64))) - 1.0
    return np.maximum(said[:count], 0.0) + np.maximum(said[count:], 0.0)


def _nudged(codes: Hypotheses) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Give sizes and poses of codes with their corners moved a little, `OFF`, those of each in turn."""
    nudges = []
    for begin in OFF:
        for end in OFF:
            nudges += [(begin, end, far) for far in OFF]
    shape = np.array([SYMBOLS[sizes()[k].symbology].sizes[sizes()[k].version] for k in codes.size.tolist()])
    rows, columns = shape.T.astype(np.float64)
    begin, end, far = np.array(nudges).T
    # in code coordinates: from the corner of the L, up and to the right
    moved = np.tile(np.eye(3), (len(codes), len(nudges), 1, 1))
    moved[:, :, 0, 0] += end / columns[:, None]
    moved[:, :, 1, 1] += far / rows[:, None]
    moved[:, :, 0, 2] += begin
    moved[:, :, 1, 2] -= far
    pose = compose(codes.pose[:, None], moved)
    return np.repeat(codes.size, len(nudges)), pose.reshape(-1, 3, 3)


def _stretched(
    edge: NDArray[np.intp],
    leg: NDArray[np.intp],
    modules: NDArray[np.float64],
    module_px: NDArray[np.float64],
    shown: NDArray[np.float64],
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Give hypotheses stretched across their edges, too, where the far side may lie elsewhere.

    How long an edge is is known to `END_PX` alone.  Where the other leg runs along the motion, so that it is
    no edge that is found, it may be many times as long.
    """
    far = END_PX * modules[leg, 1] / modules[leg, 0] / module_px[edge, leg]  # how far off [modules]
    count = np.where(shown[edge] < ALONG, np.floor(far / FAR_STEP + 0.4), 0.0).astype(np.intp)
    repeated = np.repeat(np.arange(len(edge)), 2 * count + 1)
    first = np.cumsum(2 * count + 1) - (2 * count + 1)
    step = np.arange(len(repeated)) - first[repeated] - count[repeated]
    return edge[repeated], leg[repeated], 1.0 + step * FAR_STEP / modules[leg[repeated], 1]


def codes_of_edges(
    edges: Sequence[Edges],
    windows: Sequence[int],
    directions: NDArray[np.float64],
    first: Sequence[int],
    pyramid: Pyramid,
    cfg: ReadConfig,
    *,
    workspace: Workspace,
) -> tuple[Hypotheses, NDArray[np.intp], NDArray[np.float32]]:
    """Give the codes that edges could be a leg of.

    Parameters
    ----------
    edges : sequence of Edges
        Of some windows.
    windows : sequence of int
        Which windows they are.
    directions : (N, 2) float64
        Of the motion in each, of length 1.
    first : sequence of int
        Number of the first edge of each window: they are numbered behind its peaks.
    pyramid : Pyramid
        What was searched.
    cfg : ReadConfig
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
    parts = [_hypotheses(*each, cfg) for each in zip(edges, directions, first, strict=True)]
    every = Hypotheses.joined(parts)
    window = np.repeat(np.asarray(windows, np.intp), [len(part) for part in parts])
    if not len(every):
        return every, window, np.zeros(0, np.float32)
    match = _evidence(pyramid, window, every, cfg, workspace)
    chosen = []
    for k in windows:
        rows = np.flatnonzero((window == k) & (match >= cfg.edges.min_match))
        rows = rows[np.argsort(-match[rows], kind="stable")]
        of_edge: dict[int, int] = {}
        best = []
        for row, edge in zip(rows.tolist(), every.peaks[rows, 0].tolist(), strict=True):
            of_edge[edge] = of_edge.get(edge, 0) + 1
            if of_edge[edge] <= SIZES_AN_EDGE and len(best) < cfg.edges.tries:
                best.append(row)
        chosen += best
    made, of_each = every[np.array(chosen, np.intp)], window[chosen]
    if not chosen:
        return made, of_each, np.zeros(0, np.float32)
    size, pose = _nudged(made)
    ways = len(pose) // len(made)
    seen = score(pyramid, np.repeat(of_each, ways), size, pose, cfg.align, workspace=workspace)
    best = np.arange(len(made)) * ways + (seen[:, 0] + seen[:, 1]).reshape(-1, ways).argmax(axis=1)
    made = Hypotheses.of(made.size, pose[best], made.peaks, made.inverted)
    spaces = [made.space(k) for k in range(len(made))]
    found = aligned(pyramid, of_each, made.pose, spaces, LEVELS, cfg.align, workspace=workspace)
    pose = found.pose
    pose[:, 2, :2] = 0.0
    dashed = score(pyramid, of_each, made.size, pose, cfg.align, workspace=workspace)[:, 1]
    both = 0.5 * (found.score.astype(np.float32) + dashed)
    return Hypotheses.of(made.size, pose, made.peaks, made.inverted), of_each, both
