"""The printed code as a smooth function of code coordinates, and the tables that the two stages need of it.

A module is a box blurred by sigma modules, so the luminance over code coordinates (u, v) is

    L(u, v) = 1 + sum_ij (q_ij - 1) b(v - i) b(u - j),      b(s) = Phi(s / sigma) - Phi((s - 1) / sigma)

(everything outside the symbol is its quiet zone: light, q = 1).  The bilinear model of the paper's equation
5 has second derivatives that vanish almost everywhere; Gauss-Newton on the pose needs them.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.symbol.space import CodeSpace, Landmark, closed

MOST_QUIET_MODULES = 3
"""Modules of quiet zone around the symbol that the model covers at most; that of a QR code is four wide."""

PATTERN_REACH = 4.5
"""Half of the width of a finder pattern and its separator [modules]."""

PROFILE_WIDTHS = 7
"""A module is seen so many standard deviations of its blur beyond its edge: what is left of its profile and
of its derivatives there is lost in a table of single precision."""

MOMENTS = 20
"""Functions in a pose table: see `PoseTable`."""


def _phi(z: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.5 * (1.0 + np.vectorize(math.erf)(z / math.sqrt(2.0)))


def quiet_modules(space: CodeSpace) -> int:
    """Give the modules of quiet zone that the model covers: they are light, whatever is printed around."""
    return min(MOST_QUIET_MODULES, space.quiet_zone)


def lattice(size: int, quiet: int, samples_a_module: int) -> NDArray[np.float64]:
    """Sample positions along one axis of so many modules, quiet zone included [modules from the edge]."""
    count = (size + 2 * quiet) * samples_a_module
    return (np.arange(count) + 0.5) / samples_a_module - quiet


def lattices(space: CodeSpace, samples_a_module: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sample positions of a code along u and along v, quiet zone included [modules]."""
    quiet = quiet_modules(space)
    return lattice(space.columns, quiet, samples_a_module), lattice(space.rows, quiet, samples_a_module)


def profiles(offset: NDArray[np.float64], sigma: float) -> tuple[NDArray[np.float64], ...]:
    """b, b' and b'' at ``offset`` modules from a module's near edge."""
    near, far = offset / sigma, (offset - 1.0) / sigma

    def density(z: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.exp(-0.5 * z * z) / (math.sqrt(2.0 * math.pi) * sigma)

    return (
        _phi(near) - _phi(far),
        density(near) - density(far),
        (far * density(far) - near * density(near)) / sigma,
    )


@dataclass(frozen=True, eq=False)
class PoseTable:
    """What stage one needs of the model, for the samples whose whole footprint lies on known modules.

    Its functions are, with (u', v') the coordinates from the centre over the scale along each axis, and
    (w_u, w_v) the same over the longer of the scales:

        L_uu {1, u', v', w_u u', w_u v'}                        columns 0 to 4
        L_uv {1, u', v', w_u u', w_u v', w_v u', w_v v'}                5 to 11
        L_vv {1, u', v', w_v u', w_v v'}                               12 to 16
        0, L_u, L_v                                                    17 to 19

    (the 0 makes their number what the vector units like).

    Attributes
    ----------
    points : (S, 2) float32 [modules]
        Code coordinates.
    table : (S, MOMENTS) float32
        The functions at the points.
    gram : (MOMENTS, MOMENTS) float64
        table^T table.
    centre : (float, float) [modules]
        Along u and v.
    scale : (float, float) [modules]
        Along u and v: half the size of the code.
    """

    points: NDArray[np.float32]
    table: NDArray[np.float32]
    gram: NDArray[np.float64]
    centre: tuple[float, float]
    scale: tuple[float, float]


@functools.lru_cache(maxsize=256)
def pose_table(
    space: CodeSpace, sigma: float, samples_a_module: int, beyond_patterns: bool = False
) -> PoseTable:
    """Build the table for a code space, a blur [modules] and a sampling; cached.

    With ``beyond_patterns`` it is for the samples outside the symbol's finder patterns and their separators.
    """
    down, across = (_Axis(count, quiet_modules(space), sigma, samples_a_module) for count in space.shape)
    use = _on_known(space, down, across)
    if beyond_patterns:
        for anchor in space.anchors:
            if anchor.kind is not Landmark.FINDER_PATTERN:
                continue
            beside_u, beside_v = (
                np.abs(axis.at - at) > PATTERN_REACH for axis, at in ((across, anchor.u), (down, anchor.v))
            )
            use &= beside_v[:, None] | beside_u
    rows, columns = use.nonzero()
    l_u, l_v, l_uu, l_uv, l_vv = _derivatives(space, down, across, rows, columns)

    u, v = across.at[columns], down.at[rows]
    centre = scale = space.columns / 2.0, space.rows / 2.0
    along_u, along_v = u - centre[0], v - centre[1]
    affine = [np.ones_like(u), along_u / scale[0], along_v / scale[1]]
    tilt_u, tilt_v = ([along / max(scale) * each for each in affine[1:]] for along in (along_u, along_v))
    seconds = (l_uu, affine + tilt_u), (l_uv, affine + tilt_u + tilt_v), (l_vv, affine + tilt_v)
    functions = [second * weight for second, weights in seconds for weight in weights]
    values = np.stack([*functions, np.zeros_like(u), l_u, l_v])
    return PoseTable(
        points=closed(np.stack([u, v], axis=1).astype(np.float32)),
        table=closed(np.ascontiguousarray(values.T, np.float32)),
        gram=closed(np.einsum("is,js->ij", values, values)),
        centre=centre,
        scale=scale,
    )


class _Axis:
    """Samples along one axis of a code, and how the modules beside each enter there.

    The samples in one module see its neighbours as those in the next one see theirs, and a profile ends
    some widths of its blur away: a few numbers are all that an axis is.

    Attributes
    ----------
    at : (n,) float64 [modules]
        Where the samples are.
    reach : int [modules]
        How far a module is seen.
    module : (n,) int
        Which one a sample is in, counted from the first that it could see.
    place : (n,) int
        Which of its module's samples it is.
    beside : (n,) int
        The neighbour that a sample's footprint lies on too, as ``module``; the same where there is none.
    weights : (3, samples_a_module, 2 reach + 1) float64
        b, b' and b'' of the modules from ``-reach`` to ``reach`` beside that of a sample.
    """

    def __init__(self, count: int, quiet: int, sigma: float, samples_a_module: int) -> None:
        self.at = lattice(count, quiet, samples_a_module)
        self.reach = int(1.0 + PROFILE_WIDTHS * sigma)
        of_module, self.place = np.divmod(np.arange(len(self.at)), samples_a_module)
        self.module = of_module + self.reach
        within, self.weights = _weights(self.reach, sigma, samples_a_module)
        self.beside = self.module + np.sign(within - 0.5).astype(np.intp)[self.place]


@functools.lru_cache(maxsize=32)
def _weights(
    reach: int, sigma: float, samples_a_module: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where samples are in their module, and what they see of those beside it: `_Axis.weights`."""
    within = (np.arange(samples_a_module) + 0.5) / samples_a_module
    offset = within[:, None] - np.arange(-reach, reach + 1)
    return closed(within), closed(np.stack(profiles(offset, sigma)))


def _on_known(space: CodeSpace, down: _Axis, across: _Axis) -> NDArray[np.bool_]:
    """Whether no unknown module is nearer to a sample than its own size, for all samples."""
    unknown = np.pad(~space.known, quiet_modules(space) + down.reach)
    unknown = unknown[down.module] | unknown[down.beside]
    return ~(unknown[:, across.module] | unknown[:, across.beside])


def _derivatives(
    space: CodeSpace, down: _Axis, across: _Axis, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> tuple[NDArray[np.float64], ...]:
    """L_u, L_v, L_uu, L_uv and L_vv at some samples (S,), what is not known taken for light."""
    reach = down.reach
    seen = 2 * reach + 1
    above_light = np.pad(np.where(space.known, space.values - 1.0, 0.0), quiet_modules(space) + reach)
    # along v for all modules of a row; along u only where it is asked for, some tenth of all samples
    height, width = len(above_light) - 2 * reach, above_light.shape[1]
    along_v = np.zeros((3, height, down.weights.shape[1], width))
    for step in range(seen):
        along_v += down.weights[:, None, :, step, None] * above_light[step : step + height, None, :]
    of_v, of_u = [0, 1, 0, 1, 2], [1, 0, 2, 1, 0]
    picked, weights = along_v[of_v].reshape(5, -1), across.weights[of_u]
    first = rows * width + across.module[columns] - reach  # rows are samples: modules, and places in them
    place = across.place[columns]
    found = np.zeros((5, len(rows)))
    for step in range(seen):
        found += weights[:, :, step].take(place, axis=1) * picked.take(first + step, axis=1)
    return tuple(found)
