"""A code in an image, found as the paper finds one in the images of its rivals (section 4.4).

The one-dimensional pattern 1:1:3:1:1 of a finder is matched along rows and along columns at changing scales,
and peaks in either direction count.  A line through a finder's centre shows that pattern at any angle, only
longer.  Three peaks that make the corners of a square of the version's size are the code; of several such
triples the one whose known modules agree best.  Modules are means around their centres; where the paper
binarises at 0 the threshold here is half way between the known dark and the known light modules, because an
image's own zero is arbitrary.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.symbol import qr

Image = NDArray[np.float32]

SCALES_PX = tuple(3.2 * 1.14**k for k in range(10))
"""Lengths of the pattern's module tried, 3.2 to 10.4 px."""


@dataclass(frozen=True)
class Pattern:
    """A one-dimensional kernel of stripes.

    Attributes
    ----------
    stripes : tuple of (float, float)
        Where each begins [modules from the centre of the kernel], and its sign.
    end : float
        Where the last one ends; the first begins as far on the other side.
    """

    stripes: tuple[tuple[float, float], ...]
    end: float


LIGHT = Pattern(
    ((-4.5, 1.0), (-3.5, -1.0), (-2.5, 1.0), (-1.5, -1.0), (1.5, 1.0), (2.5, -1.0), (3.5, 1.0)), 4.5
)
"""The luminance of a finder, light outside: the paper's Figure 5, left."""

STEP = 2
"""Distance between the places that are tried [px]; peaks are found to a fraction of it."""

PEAKS = 24
MIN_RESPONSE = 0.4
MIN_AGREEMENT = 0.3
"""Correlation with the known modules below which three peaks are no code."""


def find_code(image: NDArray[Any], version: int) -> NDArray[np.float32] | None:
    """Read the modules of a code from an image.

    Parameters
    ----------
    image : (Y, X) float
        Larger is lighter, any offset and unit.
    version : int
        Of the code.

    Returns
    -------
    modules : (r, r) float or None
        < 0 dark, > 0 light; None where no code is found.
    """
    image = np.asarray(image, np.float32)
    response, module, position = find_patterns(image)
    best, agreement = None, MIN_AGREEMENT
    for pose in triples_of(response, module, position, version):
        values = _sample(image, pose, qr.space(version).size)
        if values is None:
            continue
        found = _agreement(values, version)
        if found > agreement:
            best, agreement = values, found
    return None if best is None else _levelled(best, version)


def find_patterns(image: Image) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Find finder patterns.

    Returns
    -------
    response : (N,)
        Of the better direction, and of the other one where it agrees: 0 to 2.
    module : (N,) [px]
        Length of a module along rows and columns.
    position : (N, 2) float64 [px]
        Centres, column and row.
    """
    level = image - image.mean()
    spread = float(level.std())
    if spread <= 0.0:
        return np.empty(0), np.empty(0), np.empty((0, 2))
    level /= spread
    turned = np.ascontiguousarray(level.T)
    shape = tuple(-(-extent // STEP) for extent in image.shape)
    best, module = np.full(shape, -1.0, np.float32), np.zeros(shape, np.float32)
    for scale in SCALES_PX:
        rows, columns = along_rows(level, scale, LIGHT), along_rows(turned, scale, LIGHT).T
        # either direction is enough, but where both see a finder they agree about its centre
        found = np.maximum(rows, columns) + np.maximum(np.minimum(rows, columns), 0.0)
        better = found > best
        best[better] = found[better]
        module[better] = scale
    return peaks_of(best, module)


def along_rows(lines: Image, scale: float, pattern: Pattern) -> Image:
    """Normalised correlation of a pattern with every ``STEP``-th row, at every ``STEP``-th place of it.

    Rows are means over a module; the result is -1 where the pattern does not fit in.
    """
    width = lines.shape[1]
    half = max(1, round(scale / 2))
    down = np.cumsum(np.pad(lines, ((half + 1, half), (0, 0)), mode="edge"), axis=0)
    sums = down[2 * half + 1 :: STEP] - down[: -2 * half - 1 : STEP]
    means: Image = (sums / np.float32(2 * half + 1)).astype(np.float32, copy=False)
    reach = STEP * (int(np.ceil(pattern.end * scale)) // STEP + 1)
    out = np.full((len(means), -(-width // STEP)), -1.0, np.float32)
    places = out[:, reach // STEP : (width - reach) // STEP]
    if not places.size:
        return out
    sums = np.zeros((len(means), width + 1), np.float32)
    squares = np.zeros_like(sums)
    np.cumsum(means, axis=1, out=sums[:, 1:])
    np.cumsum(means * means, axis=1, out=squares[:, 1:])

    def upto(total: Image, offset: float) -> Image:
        """Sum of what lies before ``offset`` modules from each place."""
        at = offset * scale + 0.5
        whole = int(np.floor(at))
        first = reach + whole
        ends = [first + k + STEP * places.shape[1] for k in (0, 1)]
        left, right = total[:, first : ends[0] : STEP], total[:, first + 1 : ends[1] : STEP]
        return (left + np.float32(at - whole) * (right - left)).astype(np.float32)

    begins, signs = zip(*pattern.stripes, strict=True)
    edges = [upto(sums, begin) for begin in (*begins, pattern.end)]
    lengths = np.diff([*begins, pattern.end])
    extent = 2 * pattern.end
    weights = np.array(signs) - float(np.array(signs) @ lengths) / extent
    product = -weights[0] * edges[0] + weights[-1] * edges[-1]
    for k in range(1, len(weights)):
        product += (weights[k - 1] - weights[k]) * edges[k]
    norm = np.sqrt(float(weights**2 @ lengths) * scale)
    total = edges[-1] - edges[0]
    energy = upto(squares, pattern.end) - upto(squares, -pattern.end) - total * total / (extent * scale)
    # a floor: a faint ripple that happens to fit is no pattern
    places[:] = product / (norm * np.sqrt(np.maximum(energy, 0.05 * extent * scale)))
    return out


def peaks_of(response: Image, module: Image) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Local maxima, strongest first, none within two modules of a stronger one."""
    inner = response[1:-1, 1:-1]
    top = inner > MIN_RESPONSE
    height, width = response.shape
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1), (0, -1), (-1, 0), (-1, -1), (-1, 1)):
        top &= inner >= response[1 + dy : height - 1 + dy, 1 + dx : width - 1 + dx]
    rows, columns = np.nonzero(top)
    order = np.argsort(-inner[rows, columns], kind="stable")[: 40 * PEAKS]
    rows, columns = rows[order] + 1, columns[order] + 1
    kept: list[int] = []
    for k in range(len(rows)):
        size = module[rows[k], columns[k]] / STEP
        if all(np.hypot(rows[k] - rows[j], columns[k] - columns[j]) > 2.0 * size for j in kept):
            kept.append(k)
            if len(kept) == PEAKS:
                break
    rows, columns = rows[kept], columns[kept]
    value = response[rows, columns]

    def offset(before: NDArray[Any], after: NDArray[Any]) -> NDArray[Any]:
        return np.clip(0.5 * (after - before) / np.maximum(2.0 * value - before - after, 1e-6), -0.5, 0.5)

    x = columns + offset(response[rows, columns - 1], response[rows, columns + 1])
    y = rows + offset(response[rows - 1, columns], response[rows + 1, columns])
    return value, module[rows, columns], STEP * np.stack([x, y], axis=1).astype(np.float64)


def triples_of(
    response: NDArray[Any], module: NDArray[Any], position: NDArray[Any], version: int, *, most: int = 60
) -> list[NDArray[np.float64]]:
    """Poses (2, 3), modules to px, of the triples that could be a code, strongest first."""
    if len(response) < 3:
        return []
    to = position[None] - position[:, None]
    leg = np.maximum(np.hypot(to[..., 0], to[..., 1]), 1e-9)
    # along a row or column a module looks longer by the cosine to the nearer axis
    steep = np.abs(to).max(axis=-1) / leg
    true = 0.5 * (module[:, None] + module[None]) * steep
    wanted = 10 + 4 * version
    fits = np.abs(np.log(leg / np.maximum(true * wanted, 1e-9))) < 0.25
    i, j, k = np.nonzero(fits[:, :, None] & fits[:, None, :])
    cross = to[i, j, 0] * to[i, k, 1] - to[i, j, 1] * to[i, k, 0]
    dot = (to[i, j] * to[i, k]).sum(axis=-1)
    product = leg[i, j] * leg[i, k]
    square = (cross > 0.9 * product) & (np.abs(dot) < 0.2 * product)
    square &= np.abs(np.log(leg[i, j] / leg[i, k])) < 0.15
    i, j, k = i[square], j[square], k[square]
    order = np.argsort(-(response[i] + response[j] + response[k]), kind="stable")[:most]
    poses = []
    for t in order:
        per_u, per_v = to[i[t], j[t]] / wanted, to[i[t], k[t]] / wanted
        poses.append(np.column_stack([per_u, per_v, position[i[t]] - 3.5 * per_u - 3.5 * per_v]))
    return poses


@functools.cache
def _offsets(size: int) -> NDArray[np.float64]:
    """(3, 25 r r) homogeneous places in modules: five by five in the middle of each."""
    steps = np.arange(size)[:, None] + 0.5 + np.linspace(-0.3, 0.3, 5)
    v, u = np.meshgrid(steps.ravel(), steps.ravel(), indexing="ij")
    return np.stack([u.ravel(), v.ravel(), np.ones(u.size)])


def _sample(image: Image, pose: NDArray[np.float64], size: int) -> NDArray[np.float32] | None:
    """Mean of each module (r, r); None where the code reaches beyond the image."""
    x, y = pose @ _offsets(size)
    height, width = image.shape
    if min(x.min(), y.min()) < 0 or x.max() > width - 1.001 or y.max() > height - 1.001:
        return None
    column, row = x.astype(np.int32), y.astype(np.int32)
    du, dv = (x - column).astype(np.float32), (y - row).astype(np.float32)
    upper = image[row, column] * (1 - du) + image[row, column + 1] * du
    lower = image[row + 1, column] * (1 - du) + image[row + 1, column + 1] * du
    values = upper * (1 - dv) + lower * dv
    return values.reshape(size, 5, size, 5).mean(axis=(1, 3))


def _agreement(values: NDArray[np.float32], version: int) -> float:
    """Correlation with the known modules."""
    space = qr.space(version)
    seen, true = values[space.known], space.values[space.known].astype(np.float32)
    seen, true = seen - seen.mean(), true - true.mean()
    return float(seen @ true / max(float(np.sqrt((seen @ seen) * (true @ true))), 1e-12))


def _levelled(values: NDArray[np.float32], version: int) -> NDArray[np.float32]:
    """Less the threshold, half way between known dark and known light."""
    space = qr.space(version)
    dark, light = (float(values[space.known & (space.values == sign)].mean()) for sign in (-1, 1))
    return values - np.float32(0.5 * (dark + light))
