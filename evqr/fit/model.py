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
    across, down = lattices(space, samples_a_module)
    b_u, b_v = (
        profiles(axis[:, None] - np.arange(size), sigma)
        for axis, size in ((across, space.columns), (down, space.rows))
    )
    above_light = np.where(space.known, space.values.astype(np.float64) - 1.0, 0.0)

    near_u, near_v = (
        (np.abs(axis[:, None] - (np.arange(size) + 0.5)) < 1.0).astype(np.float64)
        for axis, size in ((across, space.columns), (down, space.rows))
    )
    use = near_v @ (~space.known).astype(np.float64) @ near_u.T < 0.5

    if beyond_patterns:
        for anchor in space.anchors:
            if anchor.kind is not Landmark.FINDER_PATTERN:
                continue
            beside_u, beside_v = (
                np.abs(axis - at) > PATTERN_REACH for axis, at in ((across, anchor.u), (down, anchor.v))
            )
            use &= beside_v[:, None] | beside_u

    def derivative(of_v: int, of_u: int) -> NDArray[np.float64]:
        return (b_v[of_v] @ above_light @ b_u[of_u].T)[use]

    v, u = (grid[use] for grid in np.meshgrid(down, across, indexing="ij"))
    centre = scale = space.columns / 2.0, space.rows / 2.0
    along_u, along_v = u - centre[0], v - centre[1]
    affine = [np.ones_like(u), along_u / scale[0], along_v / scale[1]]
    tilt_u, tilt_v = ([along / max(scale) * each for each in affine[1:]] for along in (along_u, along_v))
    seconds = (derivative(0, 2), affine + tilt_u), (derivative(1, 1), affine + tilt_u + tilt_v)
    seconds = *seconds, (derivative(2, 0), affine + tilt_v)
    columns = [second * weight for second, weights in seconds for weight in weights]
    table = np.stack([*columns, np.zeros_like(u), derivative(0, 1), derivative(1, 0)], axis=1)
    return PoseTable(
        points=closed(np.stack([u, v], axis=1).astype(np.float32)),
        table=closed(table.astype(np.float32)),
        gram=closed(table.T @ table),
        centre=centre,
        scale=scale,
    )
