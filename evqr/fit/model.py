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

from evqr.symbol.space import CodeSpace, read_only

QUIET_MODULES = 3
"""Modules of quiet zone around the symbol that the model covers; the standard demands four."""

MOMENTS = 20
"""Functions in a pose table: {L_uu, L_uv, L_vv} x {1, u, v, uu, uv, vv}, then L_u, L_v."""


def _phi(z: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.5 * (1.0 + np.vectorize(math.erf)(z / math.sqrt(2.0)))


def lattice(size: int, samples_a_module: int) -> NDArray[np.float64]:
    """Sample positions along one axis, quiet zone included, in modules from the symbol's edge."""
    count = (size + 2 * QUIET_MODULES) * samples_a_module
    return (np.arange(count) + 0.5) / samples_a_module - QUIET_MODULES


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

    Attributes
    ----------
    points : (S, 2) float32        code coordinates [modules]
    table : (S, MOMENTS) float32   model functions at the points; their u, v centred, divided by half the size
    gram : (MOMENTS, MOMENTS)      table^T table
    centre, scale                  u_centred = (u - centre) / scale [modules]
    """

    points: NDArray[np.float32]
    table: NDArray[np.float32]
    gram: NDArray[np.float64]
    centre: float
    scale: float


@functools.lru_cache(maxsize=256)
def pose_table(space: CodeSpace, sigma: float, samples_a_module: int) -> PoseTable:
    """Build the table for a code space, a blur [modules] and a sampling; cached."""
    size = space.size
    axis = lattice(size, samples_a_module)
    b, b1, b2 = profiles(axis[:, None] - np.arange(size), sigma)
    above_light = np.where(space.known, space.values.astype(np.float64) - 1.0, 0.0)

    near = (np.abs(axis[:, None] - (np.arange(size) + 0.5)) < 1.0).astype(np.float64)
    use = near @ (~space.known).astype(np.float64) @ near.T < 0.5

    def of(rows: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
        return (rows @ above_light @ columns.T)[use]

    l_u, l_v = of(b, b1), of(b1, b)
    second = (of(b, b2), of(b1, b1), of(b2, b))
    v, u = (grid[use] for grid in np.meshgrid(axis, axis, indexing="ij"))
    centre = scale = size / 2.0
    uc, vc = (u - centre) / scale, (v - centre) / scale
    weights = (np.ones_like(uc), uc, vc, uc * uc, uc * vc, vc * vc)
    table = np.stack([s * w for s in second for w in weights] + [l_u, l_v], axis=1)
    return PoseTable(
        points=read_only(np.stack([u, v], axis=1).astype(np.float32)),
        table=read_only(table.astype(np.float32)),
        gram=read_only(table.T @ table),
        centre=centre,
        scale=scale,
    )
