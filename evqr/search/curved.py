"""QR codes on cylinders: bends that three finder patterns suggest, and windows as if they were unrolled.

A cylinder is seen from far away, its axis in the plane of the image.  What is d px from its crest is
R asin(d / R) from it on the print.  Patterns of a flat print have one shape; on a cylinder each is the
narrower across the axis the further it is from the crest.  So from a radius, a direction and a crest follow
the places and shapes that three patterns have on the print: of one shape, a whole number of modules apart.
The bend with which they are so best is taken.

Events that are moved to where they are on the print then show a flat code.  What an edge causes there is as
strong as on a flat print across the axis, and by the cosine of the slope weaker along it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray
from evqr.events.window import Window
from evqr.motion import Motion
from evqr.search.tilted import Patterns
from evqr.search.triples import three_cornered

MIN_PATTERN = 0.6
"""Correlation of the worst of three patterns: those of codes were seen to have 0.63 and more, others mostly
less than 0.6."""

MAX_MISFIT = 0.1
"""How much the shapes of three patterns may differ [modules]."""

RADII = (0.45, 0.5, 0.56, 0.63, 0.71, 0.8, 0.9)
"""Radii that are tried, over the width of the code."""

ANGLES = 18
"""Directions of the axis that are tried."""

OFF = (-0.15, 0.0, 0.15)
"""How far the crest may lie from the middle of the code, over its width."""

TURN, SHIFT, RATIOS = 0.1, 0.06, (0.92, 1.08)
"""How much bends differ that are tried beside one: angle [rad], crest over the width, radius."""

SLOPE = 0.98
"""Sine of the slope up to which a cylinder is looked at."""


@dataclass(frozen=True, eq=False)
class Bend:
    """A cylinder.

    Attributes
    ----------
    crest : (float, float) [px]
        A place on its crest.
    across : (float, float)
        Direction across its axis, of length 1.
    radius : float [px]
        Its radius.
    reach : float [px]
        How far from the crest's place there may be a code.
    """

    crest: tuple[float, float]
    across: tuple[float, float]
    radius: float
    reach: float

    def beside(self) -> list[Bend]:
        """Give bends that differ a little from it in one thing each."""
        (n_x, n_y), shift = self.across, SHIFT * self.reach
        turned = []
        for turn in (-TURN, TURN):
            cos, sin = math.cos(turn), math.sin(turn)
            turned.append(replace(self, across=(cos * n_x - sin * n_y, sin * n_x + cos * n_y)))
        moved = [
            replace(self, crest=(self.crest[0] + off * n_x, self.crest[1] + off * n_y))
            for off in (-shift, shift)
        ]
        return [*turned, *moved, *(replace(self, radius=self.radius * ratio) for ratio in RATIOS)]


def bends_of(patterns: Patterns, window: int) -> list[Bend]:
    """Give the bend with which patterns of a window are most likely those of a code.

    Parameters
    ----------
    patterns : Patterns
        Aligned.
    window : int
        Which of the windows that were given.

    Returns
    -------
    bends : list of Bend
        One, or none.
    """
    rows = np.flatnonzero((patterns.place == window) & (patterns.worst >= MIN_PATTERN))
    found = [_bend_of(patterns.centre[k], patterns.shape[k]) for k in rows[:3].tolist()]
    misfit, bend = min(found, key=lambda one: one[0], default=(np.inf, None))
    return [bend] if bend is not None and misfit <= MAX_MISFIT else []


def _bend_of(centre: NDArray[np.float64], shape: NDArray[np.float64]) -> tuple[float, Bend]:
    """Give the bend of three patterns, of any size of code, and the misfit that is left [modules]."""
    log_leg, _ = three_cornered()
    legs = np.hypot(*(centre[1:] - centre[0]).T)
    module = np.sqrt(np.abs(shape[:, 0, 0] * shape[:, 1, 1] - shape[:, 0, 1] * shape[:, 1, 0]).mean())
    # bent, a leg is shorter, and so are modules
    fits = np.abs(log_leg - np.log(legs.max() / max(module, 1e-6))) < 0.35
    best: tuple[float, Bend] = np.inf, Bend((0.0, 0.0), (1.0, 0.0), 1.0, 0.0)
    for modules in np.exp(log_leg[fits]).tolist():
        width = (modules + 7.0) / modules * float(legs.max())
        turns = np.arange(ANGLES) * np.pi / ANGLES
        grid = np.stack(np.meshgrid(turns, RADII, OFF, indexing="ij"), axis=-1).reshape(-1, 3)
        for step in (1.0, 0.4):
            misfit = _misfits(grid, centre, shape, modules, width)
            k = int(misfit.argmin())
            turn, radius, off = grid[k].tolist()
            if misfit[k] < best[0]:
                across = math.cos(turn), math.sin(turn)
                x, y = (0.5 * (centre[1] + centre[2])).tolist()
                crest = x + off * width * across[0], y + off * width * across[1]
                best = float(misfit[k]), Bend(crest, across, radius * width, width)
            near = np.linspace(-step, step, 5)
            grid = np.stack(
                np.meshgrid(
                    turn + near * np.pi / ANGLES, radius * np.exp(0.12 * near), off + 0.15 * near,
                    indexing="ij",
                ),
                axis=-1,
            ).reshape(-1, 3)  # fmt: skip
    return best


def _misfits(
    grid: NDArray[np.float64],
    centre: NDArray[np.float64],
    shape: NDArray[np.float64],
    modules: float,
    width: float,
) -> NDArray[np.float64]:
    """Give how much three patterns differ from those of a flat print [modules], for bends (N, 3).

    A bend: direction across the axis, radius and place of the crest over the width of the code.
    """
    turn, radius, off = grid.T
    across = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    radius = (radius * width)[:, None]
    away = np.einsum("nj,kj->nk", across, centre - 0.5 * (centre[1] + centre[2])) - (off * width)[:, None]
    sine = np.clip(away / radius, -SLOPE, SLOPE)
    print_ = centre + (radius * np.arcsin(sine) - away)[..., None] * across[:, None]
    stretch = 1.0 / np.sqrt(1.0 - sine * sine) - 1.0
    along = np.einsum("nj,kji->nki", across, shape)
    flat = shape + stretch[..., None, None] * across[:, None, :, None] * along[:, :, None, :]
    legs = np.stack([print_[:, 1] - print_[:, 0], print_[:, 2] - print_[:, 0]], axis=2) / modules
    size = np.abs(legs[:, 0, 0] * legs[:, 1, 1] - legs[:, 0, 1] * legs[:, 1, 0])
    off_by = np.square(flat - legs[:, None]).mean(axis=(1, 2, 3))
    return np.sqrt(off_by / np.maximum(size, 1e-9))


def unrolled(window: Window, motion: Motion, bend: Bend) -> Window:
    """Give a window's events where they are on the print of a cylinder, all at the window's middle.

    Parameters
    ----------
    window : Window
        Of events.
    motion : Motion
        Of the cylinder, at the middle of the window.
    bend : Bend
        The cylinder, then.

    Returns
    -------
    window : Window
        Of the same bounds; without what is not on the cylinder.
    """
    events, middle_us = window.events, window.middle_us
    x, y = motion.transport(
        events.x.astype(np.float64), events.y.astype(np.float64), (events.t - middle_us) * 1e-6
    )
    x, y = x - bend.crest[0], y - bend.crest[1]
    (n_x, n_y), radius = bend.across, bend.radius
    away, along = n_x * x + n_y * y, n_x * y - n_y * x
    sine = np.clip(away / radius, -SLOPE, SLOPE)
    further = radius * np.arcsin(sine) - away
    x, y = (np.rint(x + n_x * further + bend.crest[0]), np.rint(y + n_y * further + bend.crest[1]))
    there = (np.abs(away) < SLOPE * radius) & (np.abs(along) < bend.reach)
    there &= (x >= 0) & (y >= 0) & (x < events.width) & (y < events.height)
    columns, rows = (place[there].astype(np.uint16) for place in (x, y))
    times = np.full(len(columns), middle_us, np.int64)
    flat = EventArray(times, columns, rows, events.p[there], events.width, events.height)
    return Window(flat, window.start_us, window.end_us)
