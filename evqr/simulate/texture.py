"""What there is to see: the object with its prints as a texture, and the background.

The texture's rows lie along the direction of travel, because each pixel walks along one row; it is finer
along the rows, whose texels are the knots of the pixels' signals, than across them.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import erf

import numpy as np
from numpy.typing import NDArray

from evqr.errors import UsageError
from evqr.simulate.config import SceneConfig
from evqr.simulate.geometry import Matrix, Motion, code_corners, code_to_object, transform
from evqr.simulate.printed import PrintedSymbol

#: Texels a px along the travel and across it.  With the default blur of 0.6 px, 6 knots a px put a crossing
#: within 0.011 px (rms 0.004 px) of where the continuous signal has it.
TEXELS = np.array([6.0, 2.0])
#: The object reaches this far beyond its prints, along the travel and across it [px].
MARGIN_PX = np.array([45.0, 25.0])
#: Half the size of an object without codes [px].
BARE_HALF_PX = np.array([170.0, 130.0])

Image = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Texture:
    """The moving object, blurred.

    Attributes
    ----------
    light : (V, U) float32
        Of the object times its coverage; row across, column along the travel.
    cover_along, cover_across : (U,) and (V,) float32
        Factors of the coverage: 1 inside the object, 0 outside.
    origin : (2,) float64
        (column, row) of the object's centre.
    """

    light: Image
    cover_along: Image
    cover_across: Image
    origin: NDArray[np.float64]

    def seen_by(self, motion: Motion, time_us: float, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Give the texture (column, row) that each pixel of a sensor sees at a time, (height, width, 2)."""
        return pixels_in(motion.object_to_image(time_us), shape) * TEXELS + self.origin

    def columns_a_us(self, motion: Motion) -> float:
        """Give how many columns pass a pixel in a microsecond."""
        return float(TEXELS[0]) * motion.speed


def pixels_in(to_image: Matrix, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Give where the pixels of an image (height, width) are in a frame, (height, width, 2)."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return transform(np.linalg.inv(to_image), np.stack([columns, rows], axis=-1).astype(np.float64))


def gaussian_blur(image: Image, sigma: tuple[float, float]) -> Image:
    """Blur by a Gaussian of standard deviations (rows, columns), edges continued."""
    for axis, width in enumerate(sigma):
        reach = int(np.ceil(4.0 * width))
        taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
        taps = (taps / taps.sum()).astype(np.float32)
        pad = [(reach, reach) if a == axis else (0, 0) for a in range(2)]
        padded = np.pad(image, pad, mode="edge")
        length = image.shape[axis]
        image = np.zeros_like(image)
        for shift, tap in enumerate(taps):
            image += tap * (
                padded[shift : shift + length] if axis == 0 else padded[:, shift : shift + length]
            )
    return image


def _blurred_box(position: NDArray[np.float64], half: float, sigma: float) -> Image:
    """1 inside [-half, half], 0 outside, blurred by a Gaussian of standard deviation ``sigma``."""
    scale = 1.0 / (sigma * np.sqrt(2.0))
    return np.array([0.5 * (erf((half - x) * scale) + erf((half + x) * scale)) for x in position], np.float32)


def _print_code(
    light: Image,
    origin: NDArray[np.float64],
    printed: NDArray[np.bool_],
    symbol: PrintedSymbol,
    scene: SceneConfig,
) -> None:
    """Print a code and its quiet zone into ``light``; ``printed`` says where codes are, to refuse overlaps.

    A texel is the mean of the modules under it: bilinear interpolation between modules, steepened to the
    texel's width, is exactly the convolution of the modules' squares with a box of that width.
    """
    to_object = code_to_object(symbol, scene.direction)
    quiet = symbol.space.quiet_zone
    corners = transform(to_object, code_corners(symbol, quiet)) * TEXELS + origin
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 1, 0)
    high = np.ceil(corners.max(axis=0)).astype(int) + 2
    window = np.s_[low[1] : high[1], low[0] : high[0]]
    along = (np.arange(low[0], high[0]) - origin[0]) / TEXELS[0]
    across = (np.arange(low[1], high[1]) - origin[1]) / TEXELS[1]
    to_code = np.linalg.inv(to_object)
    width = np.hypot(to_code[:2, 0] / TEXELS[0], to_code[:2, 1] / TEXELS[1])

    # One ring outside the quiet zone has coverage 0.
    ring = quiet + 1
    dark = np.pad(symbol.modules.astype(bool), ring) ^ symbol.placement.invert
    cover = np.pad(np.ones(np.array(symbol.modules.shape) + 2 * quiet, np.float32), 1)
    value = np.where(dark, scene.black, scene.white).astype(np.float32) * cover
    cells, steps = [], []
    for axis in range(2):
        at = (to_code[axis, 0] * along + (to_code[axis, 1] * across)[:, None] + to_code[axis, 2]).astype(
            np.float32
        )
        at = np.clip(at + np.float32(ring - 0.5), 0.0, cover.shape[1 - axis] - 1.001)
        cell = at.astype(np.int32)
        cells.append(cell)
        steps.append(
            np.clip((at - cell - np.float32(0.5)) / np.float32(width[axis]) + np.float32(0.5), 0.0, 1.0)
        )
    column, row = cells
    du, dv = steps
    below = cover.shape[1]
    index = row * below + column

    def mean_under(modules: Image) -> Image:
        flat = modules.ravel()
        top = flat[index] + du * (flat[index + 1] - flat[index])
        bottom = flat[index + below]
        bottom = bottom + du * (flat[index + below + 1] - bottom)
        return top + dv * (bottom - top)

    label = mean_under(cover)
    if (printed[window] & (label > 0.5)).any():
        raise UsageError(
            f"simulate: the code {symbol.placement.text!r} overlaps another one; set offset_px further apart"
        )
    printed[window] |= label > 0.5
    light[window] += mean_under(value) - label * light[window]


class _Canvas:
    """Boxes drawn in the object's frame [px]."""

    def __init__(self, light: Image, origin: NDArray[np.float64]):
        self.light = light
        self.origin = origin

    def box(self, along: float, across: float, length: float, width: float, value: float) -> None:
        """Fill the box whose corner of smallest coordinates is at (along, across)."""
        low = np.rint(np.array([along, across]) * TEXELS + self.origin).astype(int).clip(0)
        high = np.rint(np.array([along + length, across + width]) * TEXELS + self.origin).astype(int).clip(0)
        self.light[low[1] : high[1], low[0] : high[0]] = value


def _draw_body(canvas: _Canvas, half: NDArray[np.float64], rng: np.random.Generator) -> None:
    """Stripes at the object's front and back, bolts, and lettering-like specks between them."""
    for side in (-1.0, 1.0):
        stripe = side * (half[0] - rng.uniform(12, 20)) - 4.0
        canvas.box(stripe, -half[1], rng.uniform(4, 9), 2 * half[1], rng.uniform(0.08, 0.7))
        canvas.box(side * (half[0] - 36) - 1.5, -half[1] + 4, 3, 2 * half[1] - 8, rng.uniform(0.08, 0.5))
        for across in np.linspace(-0.8, 0.8, 4) * half[1]:
            canvas.box(side * (half[0] - 27) - 2, across - 2, 4, 4, 0.06)
    for _ in range(24):
        along, across = rng.uniform(-0.8, 0.8, 2) * half
        canvas.box(along, across, rng.uniform(1.5, 5), rng.uniform(1, 4), rng.uniform(0.1, 0.5))
    for side in (-1.0, 1.0):
        canvas.box(-0.7 * half[0], side * (half[1] - 7) - 1, 1.4 * half[0], 2, rng.uniform(0.08, 0.6))


def _draw_decoys(
    canvas: _Canvas, half: NDArray[np.float64], scene: SceneConfig, rng: np.random.Generator
) -> None:
    """Look-alikes of a code: barcode, text, checkerboard, boxes, finder patterns around random modules."""
    white, black = scene.white, scene.black
    place = [(x * half[0], y * half[1]) for x in (-0.72, -0.22, 0.28) for y in (-0.75, 0.1)]
    rng.shuffle(place)
    pitch = rng.uniform(3.0, 7.0)

    def label(corner: tuple[float, float]) -> tuple[float, float, float, float]:
        length, width = 0.45 * half[0], 0.7 * half[1]
        canvas.box(*corner, length, width, white)
        return corner[0] + 5, corner[1] + 5, length - 10, width - 10

    x, y, length, width = label(place[0])
    at = x
    while at < x + length:
        bar = rng.uniform(1.0, 4.0)
        canvas.box(at, y, min(bar, x + length - at), width, black)
        at += bar + rng.uniform(1.0, 4.0)
    x, y, length, width = label(place[1])
    for line in np.arange(y, y + width - 8, 11):
        for letter in np.arange(x, x + length - 5, 7):
            for stroke in rng.random((3, 2)):
                canvas.box(
                    letter + 3 * stroke[0], line + 5 * stroke[1], rng.uniform(1, 3), rng.uniform(1, 3), black
                )
    x, y, length, width = label(place[2])
    for i in range(int(width / pitch)):
        for j in range(i % 2, int(length / pitch), 2):
            canvas.box(x + j * pitch, y + i * pitch, pitch, pitch, black)
    x, y, length, width = label(place[3])
    for _ in range(12):
        corner = rng.uniform(0, 0.8, 2) * (length, width)
        canvas.box(
            x + corner[0], y + corner[1], rng.uniform(4, 15), rng.uniform(4, 15), rng.choice([black, white])
        )
    x, y, length, width = label(place[4])
    module = min(length, width) / 21
    for i, j in np.argwhere(rng.random((21, 21)) < 0.5):
        canvas.box(x + j * module, y + i * module, module, module, black)
    for i, j in ((0, 0), (0, 14), (14, 0)):
        for inset, value in ((-1, white), (0, black), (1, white), (2, black)):
            size = (7 - 2 * inset) * module
            canvas.box(x + (j + inset) * module, y + (i + inset) * module, size, size, value)


def draw_object(scene: SceneConfig, symbols: list[PrintedSymbol], rng: np.random.Generator) -> Texture:
    """Draw the object as large as its prints need; raise UsageError where codes overlap."""
    half = BARE_HALF_PX
    if symbols:
        prints = np.concatenate(
            [
                transform(code_to_object(s, scene.direction), code_corners(s, s.space.quiet_zone))
                for s in symbols
            ]
        )
        half = np.abs(prints).max(axis=0) + MARGIN_PX
    blur = scene.psf_px * TEXELS
    border = np.ceil(4.0 * blur).astype(int) + 2
    origin = np.ceil(half * TEXELS) + border
    size = (2 * origin + 1).astype(int)
    along = (np.arange(size[0]) - origin[0]) / TEXELS[0]
    across = (np.arange(size[1]) - origin[1]) / TEXELS[1]

    light = np.full((size[1], size[0]), rng.uniform(0.22, 0.35), np.float32)
    canvas = _Canvas(light, origin)
    _draw_body(canvas, half, rng)
    printed = np.zeros(light.shape, bool)
    for symbol in symbols:
        _print_code(light, origin, printed, symbol, scene)
    if not symbols:
        _draw_decoys(canvas, half, scene, rng)

    # Grain of about 1 px and 1 %, and light that falls off by a tenth towards one side.
    px = TEXELS.astype(int)
    grain = rng.standard_normal((size[1] // px[1] + 1, size[0] // px[0] + 1), np.float32)
    grain = grain.repeat(px[1], axis=0).repeat(px[0], axis=1)
    light *= 1.0 + 0.01 * grain[: size[1], : size[0]]
    slope = rng.uniform(-0.05, 0.05, 2) / half
    light *= (1.0 + slope[0] * along + slope[1] * across[:, None]).astype(np.float32)

    inside = [np.abs(x) <= h for x, h in zip((along, across), half, strict=True)]
    light *= inside[0] & inside[1][:, None]
    return Texture(
        light=gaussian_blur(light, (blur[1], blur[0])),
        cover_along=_blurred_box(along, half[0], scene.psf_px),
        cover_across=_blurred_box(across, half[1], scene.psf_px),
        origin=origin,
    )


def draw_background(scene: SceneConfig, rng: np.random.Generator) -> Image:
    """(height, width) light of the still background: boxes of many greys, with grain."""
    light = np.full((scene.height, scene.width), 0.12, np.float32)
    for _ in range(40):
        x, y = rng.integers(0, scene.width), rng.integers(0, scene.height)
        w, h = rng.integers(5, 80, 2)
        light[y : y + h, x : x + w] = rng.uniform(0.04, 0.5)
    light *= 1.0 + 0.02 * rng.standard_normal(light.shape, np.float32)
    return gaussian_blur(light, (scene.psf_px, scene.psf_px))
