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

from evqr.symbol.space import SEPARATED, CodeSpace, Landmark, closed

MOST_QUIET_MODULES = 3
"""Modules of quiet zone around the symbol that the model covers at most; that of a QR code is four wide."""

PROFILE_WIDTHS = 7
"""A module is seen so many standard deviations of its blur beyond its edge: what is left of its profile and
of its derivatives there is lost in a table of single precision."""

MOMENTS = 20
"""Functions in a pose table: see `PoseTable`."""


def _phi(z: NDArray[np.float64]) -> NDArray[np.float64]:
    scaled = z / math.sqrt(2.0)
    # np.vectorize takes three times as long
    erf = np.fromiter(map(math.erf, scaled.ravel().tolist()), np.float64, scaled.size)
    return 0.5 * (1.0 + erf.reshape(scaled.shape))


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
    samples = _samples(space, samples_a_module, beyond_patterns)
    l_u, l_v, l_uu, l_uv, l_vv = _derivatives(space, sigma, samples_a_module, samples)
    values = np.zeros((MOMENTS, len(samples.points)))
    np.multiply(l_uu, samples.functions[:5], out=values[:5])
    np.multiply(l_uv, samples.functions, out=values[5:12])
    np.multiply(l_vv, samples.functions[:3], out=values[12:15])
    np.multiply(l_vv, samples.functions[5:], out=values[15:17])
    values[18:] = l_u, l_v
    return PoseTable(
        points=samples.points,
        table=closed(np.ascontiguousarray(values.T, np.float32)),
        gram=closed(_gram(values)),
        centre=samples.centre,
        scale=samples.centre,
    )


def _gram(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give the products (C, C) of all functions (C, S) with each other: half of them are the other half."""
    gram = np.empty((len(values), len(values)))
    for first in range(0, len(values), 5):
        block = slice(first, first + 5)
        gram[block, first:] = np.einsum("is,js->ij", values[block], values[first:])
        gram[first:, block] = gram[block, first:].T
    return gram


@dataclass(frozen=True, eq=False)
class _Samples:
    """The samples whose whole footprint lies on known modules, for any blur.

    Attributes
    ----------
    points : (S, 2) float32 [modules]
        Code coordinates.
    rows : (S,) int
        Row of samples that each is in.
    modules, places : (S,) int
        Column of modules that it is in, and which of the module's samples it is.
    functions : (7, S) float64
        1, u', v', w_u u', w_u v', w_v u', w_v v': see `PoseTable`.
    centre : (float, float) [modules]
        Of the code.
    """

    points: NDArray[np.float32]
    rows: NDArray[np.intp]
    modules: NDArray[np.intp]
    places: NDArray[np.intp]
    functions: NDArray[np.float64]
    centre: tuple[float, float]


@functools.lru_cache(maxsize=128)
def _samples(space: CodeSpace, samples_a_module: int, beyond_patterns: bool) -> _Samples:
    across, down = lattices(space, samples_a_module)
    use = _on_known(space, samples_a_module)
    if beyond_patterns:
        for anchor in space.anchors:
            if anchor.kind is not Landmark.FINDER_PATTERN:
                continue
            beside_u, beside_v = (
                np.abs(axis - at) > SEPARATED for axis, at in ((across, anchor.u), (down, anchor.v))
            )
            use &= beside_v[:, None] | beside_u
    rows, columns = use.nonzero()
    modules, places = np.divmod(columns, samples_a_module)
    u, v = across[columns], down[rows]
    centre = space.columns / 2.0, space.rows / 2.0
    along_u, along_v = u - centre[0], v - centre[1]
    linear = [along_u / centre[0], along_v / centre[1]]
    tilted = [along / max(centre) * each for along in (along_u, along_v) for each in linear]
    return _Samples(
        points=closed(np.stack([u, v], axis=1).astype(np.float32)),
        rows=closed(rows),
        modules=closed(modules),
        places=closed(places),
        functions=closed(np.stack([np.ones_like(u), *linear, *tilted])),
        centre=centre,
    )


def _on_known(space: CodeSpace, samples_a_module: int) -> NDArray[np.bool_]:
    """Whether no unknown module is nearer to a sample than its own size, for all samples."""
    unknown = np.pad(~space.known, quiet_modules(space) + 1)
    side = np.sign(_within(samples_a_module) - 0.5).astype(np.intp)
    own, beside = (
        [(np.arange(1, count - 1)[:, None] + towards).ravel() for count in unknown.shape]
        for towards in (np.zeros_like(side), side)
    )
    unknown = unknown[own[0]] | unknown[beside[0]]
    return ~(unknown[:, own[1]] | unknown[:, beside[1]])


def _within(samples_a_module: int) -> NDArray[np.float64]:
    """Where the samples of a module are in it."""
    return (np.arange(samples_a_module) + 0.5) / samples_a_module


@functools.lru_cache(maxsize=32)
def _weights(sigma: float, samples_a_module: int) -> NDArray[np.float64]:
    """Give b, b' and b'' of the modules that a sample sees, (3, samples_a_module, 2 reach + 1).

    They are the same in all modules, and a profile ends some widths of its blur away: few numbers an axis.
    """
    reach = int(1.0 + PROFILE_WIDTHS * sigma)
    offset = _within(samples_a_module)[:, None] - np.arange(-reach, reach + 1)
    return closed(np.stack(profiles(offset, sigma)))


def _derivatives(
    space: CodeSpace, sigma: float, samples_a_module: int, samples: _Samples
) -> NDArray[np.float64]:
    """L_u, L_v, L_uu, L_uv and L_vv at some samples, (5, S), what is not known taken for light."""
    weights = _weights(sigma, samples_a_module)
    reach = weights.shape[2] // 2
    above_light = np.pad(np.where(space.known, space.values - 1.0, 0.0), quiet_modules(space) + reach)
    # along v for all modules of a row; along u only where it is asked for, some tenth of all samples
    height, width = len(above_light) - 2 * reach, above_light.shape[1]
    along_v = np.zeros((3, height, samples_a_module, width))
    for step in range(2 * reach + 1):
        along_v += weights[:, None, :, step, None] * above_light[step : step + height, None, :]
    of_v, of_u = along_v.reshape(3, -1)[[0, 1, 0, 1, 2]], weights[[1, 0, 2, 1, 0]]
    first = samples.rows * width + samples.modules
    found = np.zeros((5, len(first)))
    for step in range(2 * reach + 1):
        found += of_u[:, :, step].take(samples.places, axis=1) * of_v.take(first + step, axis=1)
    return found
