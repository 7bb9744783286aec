"""The small picture of a trial: what its method made of the place where the code is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evqr.geometry import outline
from evqr.paper.dataset.manifest import Sequence
from evqr.paper.methods.method import Outcome

SIZE = 160
"""Pixels a side."""

MARGIN = 3.0
"""Modules around the code that are shown."""


def picture_of(outcome: Outcome, time_us: float, sequence: Sequence) -> NDArray[np.uint8] | None:
    """Draw an outcome, (SIZE, SIZE); None where there is nothing to draw.

    An image is shown around the true place of the code, or whole where that is not known or the image has
    other axes than the sensor's.  Modules are drawn by the pose that the method found, as in the paper.

    Parameters
    ----------
    outcome : Outcome
        Of a method, with an image or with modules.
    time_us : float [us]
        That the outcome is of.
    sequence : Sequence
        The recording, with its poses.
    """
    shape = (sequence.events.height, sequence.events.width)
    box = _box(time_us, sequence) if outcome.image is None or outcome.image.shape == shape else None
    if outcome.image is not None:
        low, step = box or (np.zeros(2), max(outcome.image.shape) / SIZE)
        at = low[:, None] + step * (np.arange(SIZE) + 0.5)
        x, y = np.floor(at).astype(int)
        height, width = outcome.image.shape
        picture = outcome.image[np.clip(y, 0, height - 1)[:, None], np.clip(x, 0, width - 1)].astype(
            np.float64
        )
        outside = ((y < 0) | (y >= height))[:, None] | ((x < 0) | (x >= width))
        return _stretched(picture, ~outside)
    if outcome.modules is None or outcome.pose is None:
        return None
    if box is None:
        corners = outline(outcome.pose, outcome.modules.shape, MARGIN)
        box = corners.min(axis=0), float(np.ptp(corners, axis=0).max()) / SIZE
    low, step = box
    x, y = np.meshgrid(*(low[:, None] + step * (np.arange(SIZE) + 0.5)))
    u, v, z = np.tensordot(np.linalg.inv(outcome.pose), np.stack([x, y, np.ones_like(x)]), axes=1)
    ringed = np.pad(np.sign(outcome.modules), int(MARGIN), constant_values=1)
    u, v = np.floor(u / z + MARGIN).astype(int), np.floor(v / z + MARGIN).astype(int)
    inside = (u >= 0) & (v >= 0) & (u < len(ringed)) & (v < len(ringed))
    value = ringed[np.clip(v, 0, len(ringed) - 1), np.clip(u, 0, len(ringed) - 1)]
    return np.where(inside, np.where(value > 0, 255, 0), 128).astype(np.uint8)


def _box(time_us: float, sequence: Sequence) -> tuple[NDArray[np.float64], float] | None:
    """Corner of the picture and step between its pixels [px]."""
    pose = sequence.pose_at(time_us)
    if pose is None:
        return None
    corners = outline(pose, sequence.truth.modules.shape, MARGIN)
    side = float(np.ptp(corners, axis=0).max())
    return corners.mean(axis=0) - side / 2, side / SIZE


def _stretched(picture: NDArray[np.float64], use: NDArray[np.bool_]) -> NDArray[np.uint8]:
    low, high = np.percentile(picture[use], (2.0, 98.0)) if use.any() else (0.0, 1.0)
    scaled = 255.0 * (picture - low) / max(high - low, 1e-9)
    return np.where(use, np.clip(scaled, 0.0, 255.0), 128.0).astype(np.uint8)
