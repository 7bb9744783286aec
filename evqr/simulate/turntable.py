"""The object on a turntable: its texture in circles around the axis.

A pixel sees one circle of what turns, at a constant number of degrees a microsecond.  So the texture's rows
are circles, its columns angles, and pixels walk along a row as they do where something passes straight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.simulate.geometry import Motion
from evqr.simulate.texture import TEXELS, Image, Texture, pixels_in

#: The disc reaches this far beyond the object [px].
RIM_PX = 4.0
#: Rows that are drawn at once.
ROWS = 64


@dataclass(frozen=True, kw_only=True, eq=False)
class TurningTexture(Texture):
    """The disc with the object on it: row distance from the axis, column angle.

    Attributes
    ----------
    columns_a_radian : float
        Texels along a circle.
    """

    columns_a_radian: float

    def seen_by(self, motion: Motion, time_us: float, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Give the texture (column, row) that each pixel of a sensor sees at a time, (height, width, 2)."""
        along, across = np.moveaxis(pixels_in(motion.object_to_image(time_us), shape), -1, 0)
        across = across - motion.radius
        angle = np.arctan2(across, along) % (2.0 * math.pi)
        columns, rows = angle * self.columns_a_radian, np.hypot(along, across) * TEXELS[1]
        return np.stack([columns, rows], axis=-1) + self.origin

    def columns_a_us(self, motion: Motion) -> float:
        """Give how many columns pass a pixel in a microsecond."""
        return self.columns_a_radian * motion.speed / motion.radius


def on_turntable(texture: Texture, motion: Motion, rng: np.random.Generator) -> TurningTexture:
    """Put an object on a disc of one grey, which covers what is behind it."""
    height, width = texture.light.shape
    axis = texture.origin + np.array([0.0, motion.radius * TEXELS[1]])
    corners = np.array([[x, y] for x in (0, width - 1) for y in (0, height - 1)])
    reach = float(np.hypot(*((corners - axis) / TEXELS).T).max()) + RIM_PX
    columns_a_radian = float(TEXELS[0]) * reach
    # so much passes a pixel, beside the circle that it sees all of: the run-in is short against a turn
    passed = math.ceil(2.2 * math.pi * columns_a_radian)
    columns = math.ceil(2.0 * math.pi * columns_a_radian) + passed + 2
    rows = math.ceil(reach * TEXELS[1]) + 1
    angle = (np.arange(columns) - passed) / columns_a_radian
    around = np.stack([np.cos(angle), np.sin(angle)]) * TEXELS[:, None]
    grey = np.float32(rng.uniform(0.22, 0.35))
    bare = grey * (1.0 - texture.cover_across[:, None] * texture.cover_along)
    lit = (texture.light + bare).astype(np.float32)
    flat: Image = np.pad(lit, 1, constant_values=grey)
    light = np.empty((rows, columns), np.float32)
    for first in range(0, rows, ROWS):
        radius = np.arange(first, min(first + ROWS, rows)) / TEXELS[1]
        light[first : first + ROWS] = _between(flat, around * radius[:, None, None] + axis[:, None] + 1.0)
    return TurningTexture(
        light=light,
        cover_along=np.ones(columns, np.float32),
        cover_across=np.ones(rows, np.float32),
        origin=np.array([passed, 0.0]),
        columns_a_radian=columns_a_radian,
    )


def _between(image: Image, at: NDArray[np.float64]) -> Image:
    """Interpolate an image at places (..., 2, columns) of (column, row), its edge continued."""
    high = np.array(image.shape[::-1])[:, None] - 1.001
    at = np.clip(at, 0.0, high)
    cell = at.astype(np.int32)
    u, v = np.moveaxis((at - cell).astype(np.float32), -2, 0)
    column, row = np.moveaxis(cell, -2, 0)
    top = image[row, column] * (1.0 - u) + image[row, column + 1] * u
    return top + v * (image[row + 1, column] * (1.0 - u) + image[row + 1, column + 1] * u - top)
