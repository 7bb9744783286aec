"""Where the paper's descent starts from: its sections 3.5 and 4.4, motion by PCA and pose by 1:1:3:1:1.

- *motion*: the events of an edge lie in a plane of space-time, and the motion common to all edges lies in all
  of these planes.  The smallest principal component of the events in a small part of the view is the normal
  of its plane; the motion is what comes closest to being at right angles to all normals.  PCA of all events
  at once, the other reading, finds the extent of the code, and is wrong by as much as the motion and more.
- *pattern*: six edges at distances 1:1:3:1:1 with events of alternating sign (Figure 5, right), in the image
  of the events transported by that motion.  Along rows if the motion is nearer to them, else along columns:
  edges along the motion have no events.  A line through a finder's centre shows the pattern at any angle.
- *triple*: of those that make a code of the version's size, the one on whose known modules the events agree
  best with equation 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.events.window import Window
from evqr.fit.model import pose_table
from evqr.paper.methods.event_image import event_image
from evqr.paper.methods.pattern import SCALES_PX, STEP, Image, Pattern, along_rows, peaks_of, triples_of
from evqr.symbol import qr
from evqr.workspace import Workspace

TILE_PX = 7
"""Side of a part of the view; a window is taken to be as long."""

FEWEST_EVENTS = 8
"""Events of one sign below which a part of the view says nothing."""

PULL = 1e-3
"""Towards no motion, relative to the normals' own: where all edges are parallel, along them."""

EDGES = Pattern(
    tuple(
        stripe
        for k, edge in enumerate((-3.5, -2.5, -1.5, 1.5, 2.5, 3.5))
        for stripe in ((edge - 0.4, (-1.0) ** k), (edge + 0.4, 0.0))
    )[:-1],
    3.9,
)
"""The events of a finder along its motion, from the edge that trails: there light takes the place of dark."""

CLIP = 3.0
"""Standard deviations at which the image is clipped, for the sake of pixels that always fire."""

BLUR_MODULES, SAMPLES_A_MODULE = 0.25, 3
"""Of the known modules with which triples are compared."""

MIN_AGREEMENT = 0.3
"""Correlation of events and known modules below which a triple is no code."""


def principal_motion(window: Window) -> NDArray[np.float64] | None:
    """Give the motion (2,) by local PCA [px per window]; None where too few parts of the view have events."""
    moments = []
    across = window.width // TILE_PX + 1
    for sign in (1, -1):
        of = window.events.p == sign
        x, y = window.events.x[of].astype(np.intp), window.events.y[of].astype(np.intp)
        _, tile = np.unique(y // TILE_PX * across + x // TILE_PX, return_inverse=True)
        t = window.t[of].astype(np.float64) * (TILE_PX / window.seconds)
        place = np.stack([x % TILE_PX, y % TILE_PX, t, np.ones(len(t))])
        products = [[np.bincount(tile, a * b) for b in place] for a in place]
        moments.append(np.moveaxis(np.array(products).reshape(4, 4, -1), -1, 0))
    sums = np.concatenate(moments)
    sums = sums[sums[:, 3, 3] >= FEWEST_EVENTS]
    if len(sums) < 2:
        return None
    count = sums[:, 3, 3]
    mean = sums[:, :3, 3] / count[:, None]
    spread, axes = np.linalg.eigh(
        sums[:, :3, :3] / count[:, None, None] - mean[:, :, None] * mean[:, None, :]
    )
    normal = axes[:, :, 0]
    # as far as it is a plane, and no ball
    weight = count * (1.0 - spread[:, 0] / np.maximum(spread[:, 1], 1e-9))
    common = np.einsum("k,ki,kj->ij", weight, normal, normal)
    pull = (PULL * np.trace(common[:2, :2]) + 1e-12) * np.eye(2)
    return -TILE_PX * np.linalg.solve(common[:2, :2] + pull, common[:2, 2])


def find_pose(
    window: Window, motion: NDArray[np.float64], version: int, *, epsilon_px: float, workspace: Workspace
) -> NDArray[np.float64] | None:
    """Find the three finder patterns of a code.

    Parameters
    ----------
    window : Window
        Events of one window.
    motion : (2,) float64 [px per window]
        Displacement that is undone.
    version : int
        Of the symbol.
    epsilon_px : float [px]
        Standard deviation of an event's splat.
    workspace : Workspace
        Whose buffers are used.

    Returns
    -------
    pose : (3, 3) float64 or None
        Code coordinates to px; None where there are no three patterns that agree with the events.
    """
    image = event_image(window, motion, epsilon_px=epsilon_px, workspace=workspace)
    best, agreement = None, MIN_AGREEMENT
    for patterns in event_patterns(image, motion):
        for affine in triples_of(*patterns, version):
            found = agreement_of(image, affine, motion, version)
            if found > agreement:
                best, agreement = np.vstack([affine, (0.0, 0.0, 1.0)]), found
    return best


def event_patterns(
    image: Image, motion: NDArray[np.float64]
) -> Iterator[tuple[NDArray[Any], NDArray[Any], NDArray[Any]]]:
    """Find finder patterns in the image of events, in two ways: as `methods.pattern.find_patterns`.

    First by single lines, then by lines and those beside them: where a code lies along the lines, all that
    cross the middle of a finder are alike, and only together they tell where it is.
    """
    axis = int(np.abs(motion).argmax())
    spread = float(image.std())
    if spread <= 0.0:
        return
    # the events of a code that moves back are those of its negative that moves on
    level = np.clip(image * np.float32(np.sign(motion[axis]) / spread), -CLIP, CLIP)
    lines = level if axis == 0 else np.ascontiguousarray(level.T)
    matched = [along_rows(lines, scale, EDGES) for scale in SCALES_PX]
    beside = [found + _mean_of_lines(found, scale) for found, scale in zip(matched, SCALES_PX, strict=True)]
    for responses in (np.stack(matched), np.stack(beside)):
        best = responses.max(axis=0)
        module = np.array(SCALES_PX, np.float32)[responses.argmax(axis=0)]
        yield peaks_of(best, module) if axis == 0 else peaks_of(best.T, module.T)


def _mean_of_lines(response: Image, scale: float) -> Image:
    """Mean over the lines that cross the middle of the same finder."""
    half = max(1, round(1.5 * scale / STEP))
    sums = np.cumsum(np.pad(np.maximum(response, 0.0), ((half + 1, half), (0, 0))), axis=0)
    return ((sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1)).astype(np.float32)


def agreement_of(
    image: Image, affine: NDArray[np.float64], motion: NDArray[np.float64], version: int
) -> float:
    """Correlation of E with -grad L . m at known modules and quiet zone; E is 0 beyond the image."""
    table = pose_table(qr.space(version), BLUR_MODULES, SAMPLES_A_MODULE)
    x, y = np.rint(table.points @ affine[:, :2].T + affine[:, 2]).astype(np.intp).T
    inside = (x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0])
    expected = -(table.table[:, -2:] @ np.linalg.solve(affine[:, :2], motion))
    seen = np.where(inside, image[y * inside, x * inside], 0.0)
    return float(seen @ expected / max(np.sqrt(float(seen @ seen) * float(expected @ expected)), 1e-12))
