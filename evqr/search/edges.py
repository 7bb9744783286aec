"""Straight edges of a window: what the solid border of a symbol without finder patterns looks like in events.

An edge is as light or as dark in the event image all along as the motion crosses it.  The best runs along
lines of many directions are measured on the finest level of the pyramid (`line_runs`), those of one edge are
taken together, and the edge is moved to where it is strongest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.config import EdgeConfig
from evqr.search.pyramid import Pyramid
from evqr.workspace import Step, Workspace

ANGLES = 32
"""Directions of lines, over half a turn."""

MOST = 3.0
"""Strength beyond which an edge is no better, in thresholds."""

LINES_AN_EDGE = 4
"""Lines that are looked at for each edge that is kept: several run along one edge."""

STEPS = (0.7, 0.35, 0.17)
"""How far the ends of an edge are moved across it, in turn [cells]."""

ACROSS = np.array([(a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
"""Ways to move both ends."""

SAMPLES = 24
"""Places along an edge at which its strength is measured."""

PLACES = 160
"""The same, where its ends are looked for."""

BESIDE = 12
"""The same, where it is looked at what is beside it."""

BESIDE_CELLS, BESIDE_SHARE = (2.0, 3.2, 4.6, 6.0), (0.05, 0.1, 0.17, 0.25)
"""How far off that is: a few cells, where modules are small; parts of its length, where they are large."""

BUSY = 0.5
"""Strength from which on something happens at a place, in that of the edge."""


@dataclass(frozen=True, eq=False)
class Edges:
    """N straight edges of a window, the longest and clearest first.

    Attributes
    ----------
    start, end : (N, 2) float64 [px]
        Where they begin and end.
    sign : (N,) float64
        1 where the event image is light along the edge, -1 where it is dark.
    busy : (N, 2) float64
        Share of places beside the edge at which something happens: on the side to which the way along it is
        turned by a right angle from x to y, and on the other.
    """

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    sign: NDArray[np.float64]
    busy: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.sign)


_ANGLE = (np.arange(ANGLES // 2) + 0.5) * math.pi / ANGLES - 0.25 * math.pi
SLOPE = np.tile(np.tan(_ANGLE), 2)
"""Of the lines: the first half cross the columns of the image, the others its rows."""
STEEP = np.repeat([0, 1], ANGLES // 2)
DIRECTION = (
    np.where(
        STEEP[:, None] == 0, np.stack([np.ones(ANGLES), SLOPE], 1), np.stack([SLOPE, np.ones(ANGLES)], 1)
    )
    / np.sqrt(1.0 + SLOPE**2)[:, None]
)


class LineRuns(Step):
    """Measures lines through the finest level of a pyramid."""

    def __init__(self, pyramid: Pyramid, workspace: Workspace) -> None:
        super().__init__(workspace)
        self._image = pyramid.finest
        count, rows, columns = self._image.shape
        self._slope = workspace.table(("slope of lines",), SLOPE.astype(np.float32))
        self._steep = workspace.table(("steep lines",), STEEP.astype(np.int32))
        self.threshold = self._staging.input((count, ANGLES))
        self.runs = self._staging.output((count, ANGLES, 2, rows + columns))

    def launch(self) -> None:
        """Launch the kernel."""
        self._backend.line_runs(
            self._image, self._slope, self._steep, self.threshold.device, MOST, self.runs.device
        )


def straight_edges(
    pyramid: Pyramid,
    windows: Sequence[int],
    directions: NDArray[np.float64],
    cfg: EdgeConfig,
    *,
    workspace: Workspace,
) -> list[Edges]:
    """Find the straight edges of some windows.

    Parameters
    ----------
    pyramid : Pyramid
        What was searched.
    windows : sequence of int
        Which of its windows.
    directions : (N, 2) float64
        Of the motion in each of them, of length 1.
    cfg : EdgeConfig
        Settings.
    workspace : Workspace
        Buffers.

    Returns
    -------
    edges : list of Edges
        One a window.
    """
    images = pyramid.finest_of(windows)
    step = pyramid.images.once(("line runs",), lambda: LineRuns(pyramid, workspace))
    step.threshold.host[:] = 0.0
    thresholds = [_thresholds(*each, cfg) for each in zip(images, directions, strict=True)]
    step.threshold.host[list(windows)] = thresholds
    step.run()
    runs = step.runs.read()
    finest = pyramid.levels[0]
    cell = finest.cell
    found = []
    for k, image, threshold in zip(windows, images, thresholds, strict=True):
        start, end, sign = _edges(image, (finest.rows, finest.columns), runs[k], threshold, cfg)
        busy = _busy(image, start, end, sign)
        corner = np.array([pyramid.regions[k].x, pyramid.regions[k].y])
        found.append(Edges(corner + cell * (start + 0.5), corner + cell * (end + 0.5), sign, busy))
    return found


def _thresholds(
    image: NDArray[np.float32], direction: NDArray[np.float64], cfg: EdgeConfig
) -> NDArray[np.float64]:
    """Give what counts as an edge of each direction (A,): the less the more it runs along the motion."""
    energy = float(np.square(image).sum()) / max(np.count_nonzero(image), 1)
    across = np.abs(DIRECTION[:, 0] * direction[1] - DIRECTION[:, 1] * direction[0])
    return math.sqrt(energy) * cfg.strength * np.maximum(across, cfg.least_across)


def _edges(
    image: NDArray[np.float32],
    whole: tuple[int, int],
    runs: NDArray[np.float32],
    threshold: NDArray[np.float64],
    cfg: EdgeConfig,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Give starts and ends (N, 2) [cells, from the middle of the first], and signs (N,)."""
    best = runs >= cfg.least_sum
    best[..., 1:] &= runs[..., 1:] > runs[..., :-1]
    best[..., :-1] &= runs[..., :-1] >= runs[..., 1:]
    angle, side, line = np.nonzero(best)
    long = runs[best] * np.sqrt(1.0 + SLOPE[angle] ** 2)
    order = np.argsort(-long, kind="stable")[: LINES_AN_EDGE * cfg.most]
    angle, side, line = angle[order], side[order], line[order]
    sign = np.where(side == 0, 1.0, -1.0)
    parts = [np.flatnonzero(STEEP[angle] == steep) for steep in (0, 1)]
    start, end = np.zeros((2, len(order), 2))
    for steep, part in enumerate(parts):
        if not len(part):
            continue
        seen = image.T if steep else image
        a = angle[part]
        place = line[part] - (SLOPE[a] > 0.0) * whole[1 - steep]
        for ends, at in zip(
            (start, end), _run(seen, place, SLOPE[a], sign[part] / threshold[a]), strict=True
        ):
            across = place + SLOPE[a] * at
            ends[part] = np.stack([across, at] if steep else [at, across], axis=1)
    kept = _apart(start, end, sign, cfg.most)
    return (*_moved(image, start[kept], end[kept], sign[kept]), sign[kept])


def _run(
    seen: NDArray[np.float32],
    place: NDArray[Any],
    slope: NDArray[np.float64],
    scale: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give the first and last step of the best run of each line."""
    across, along = seen.shape
    t = np.arange(along)
    at = place[:, None] + slope[:, None] * t
    inside = (at >= 0.0) & (at < across - 1)
    first = np.where(inside, at, 0.0).astype(np.intp)
    near = seen[first, t]
    e = np.where(inside, near + (at - first) * (seen[first + 1, t] - near), 0.0)
    return _best_run(np.clip(scale[:, None] * e, -MOST, MOST) - 1.0)


def _best_run(excess: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give the first and the last step of the run with the greatest sum of each row."""
    total = np.cumsum(excess, axis=1)
    lowest = np.minimum.accumulate(np.minimum(total - excess, 0.0), axis=1)
    last = (total - lowest).argmax(axis=1)
    rows = np.arange(len(last))
    before = total - excess
    first = np.argmax(before <= lowest[rows, last][:, None] + 1e-9, axis=1)
    return first.astype(np.float64), last.astype(np.float64)


def _apart(
    start: NDArray[np.float64], end: NDArray[np.float64], sign: NDArray[np.float64], most: int
) -> list[int]:
    """Give which edges are none that a better one before them is already."""
    kept: list[int] = []
    free = np.ones(len(sign), np.bool_)
    middle, length = 0.5 * (start + end), np.hypot(*(end - start).T)
    for k in range(len(sign)):
        if not free[k] or length[k] < 4.0:
            continue
        kept.append(k)
        if len(kept) == most:
            break
        along = (end[k] - start[k]) / length[k]
        off = middle - middle[k]
        beside = np.abs(off[:, 0] * along[1] - off[:, 1] * along[0])
        before = np.abs(off[:, 0] * along[0] + off[:, 1] * along[1])
        way = end - start
        turned = np.abs(way[:, 0] * along[1] - way[:, 1] * along[0])
        same = (beside < 1.6) & (before < 0.5 * length[k] + 1.0) & (turned < 0.25 * length + 2.0)
        free &= ~(same & (sign == sign[k]))
    return kept


def _moved(
    image: NDArray[np.float32],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    sign: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give edges moved to where they are strongest, with their ends where they are half as strong.

    A line that is slightly turned leaves its edge: so edges are lengthened, and moved again.
    """
    if not len(start):
        return start, end
    for steps, beyond in ((STEPS[:2], 1.0), (STEPS, 0.25)):
        start, end = _ended(image, *_across(image, start, end, sign, steps), sign, beyond)
    return start, end


def _across(
    image: NDArray[np.float32],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    sign: NDArray[np.float64],
    steps: Sequence[float],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give edges with their ends moved across them to where all of it is strongest."""
    share = np.linspace(0.06, 0.94, SAMPLES)
    for step in steps:
        way = end - start
        normal = np.stack([-way[:, 1], way[:, 0]], 1) / np.hypot(*way.T)[:, None]
        off = step * (ACROSS[:, :1] * (1.0 - share) + ACROSS[:, 1:] * share)  # (9, S)
        x, y = (
            start[:, c, None, None] + way[:, c, None, None] * share + normal[:, c, None, None] * off
            for c in (0, 1)
        )
        best = _seen(image, x, y).sum(axis=2) * sign[:, None]
        ways = step * ACROSS[best.argmax(axis=1)]
        start, end = start + normal * ways[:, :1], end + normal * ways[:, 1:]
    return start, end


def _ended(
    image: NDArray[np.float32],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    sign: NDArray[np.float64],
    beyond: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give edges that end where they are half as strong, at most so much of their length beyond."""
    way = end - start
    length = np.hypot(*way.T)
    share = np.linspace(-beyond, 1.0 + beyond, PLACES)
    strength = sign[:, None] * _seen(image, *(start[:, c, None] + way[:, c, None] * share for c in (0, 1)))
    inner = np.flatnonzero((share > 0.1) & (share < 0.9))
    level = np.maximum(np.median(strength[:, inner], axis=1), 1e-9)
    first, last = _best_run(np.clip(2.0 * strength / level[:, None], -2.0, MOST) - 1.0)
    step = (share[1] - share[0]) * np.ones_like(length)
    first, last = (-beyond + step * (each + off) for each, off in ((first, -0.5), (last, 0.5)))
    return start + way * first[:, None], start + way * last[:, None]


def _busy(
    image: NDArray[np.float32],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    sign: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Give `Edges.busy`: the more of what is a few cells off, and of what is a part of the length off."""
    way = end - start
    length = np.maximum(np.hypot(*way.T), 1e-9)
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1) / length[:, None]
    share = (np.arange(BESIDE) + 0.5) / BESIDE
    on_edge = start[:, None] + way[:, None] * share[:, None]  # (N, BESIDE, 2)
    x, y = np.moveaxis(on_edge, -1, 0)
    least = BUSY * np.maximum(np.median(sign[:, None] * _seen(image, x, y), axis=1), 1e-9)
    off = np.stack([np.tile(BESIDE_CELLS, (len(way), 1)), length[:, None] * BESIDE_SHARE], axis=1)
    off = np.stack([off, -off], axis=1)[..., None, None] * normal[:, None, None, None, None]
    places = np.rint(on_edge[:, None, None, None] + off).astype(np.intp)  # (N, side, kind, depth, BESIDE, 2)
    column, row = np.moveaxis(places, -1, 0)
    rows, columns = image.shape
    inside = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
    there = np.abs(image.ravel()[np.where(inside, row * columns + column, 0)])
    happens = inside & (there > least[:, None, None, None, None])
    return happens.mean(axis=(3, 4)).max(axis=2)


def _seen(image: NDArray[np.float32], x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Look up between pixels, 0 outside the image."""
    rows, columns = image.shape
    inside = (x >= 0.0) & (y >= 0.0) & (x < columns - 1) & (y < rows - 1)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    column, row = x.astype(np.intp), y.astype(np.intp)
    at, flat = row * columns + column, image.ravel()
    x, y = x - column, y - row
    above, below = flat[at], flat[at + columns]
    above = above + x * (flat[at + 1] - above)
    below = below + x * (flat[at + columns + 1] - below)
    return np.where(inside, above + y * (below - above), 0.0)
