"""Image of a grid under a map; the formulas are in ``warp_backend/render.py``."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

EDGE = 6.0
"""Standard deviations from an edge of a module at which its blur ends."""


def _erf(z: NDArray) -> NDArray[np.float64]:
    return np.array([math.erf(value) for value in z.ravel()]).reshape(z.shape)


def render_code(grid, to_grid, outside, sigma, image_out) -> None:
    """Image of a grid under an affine map or a homography; overwrites."""
    for b in range(len(grid)):
        seen = seen_by(grid[b], to_grid[b], outside[b], sigma, image_out.shape[1:])
        image_out[b] = outside[b]
        image_out[b][seen.near] = np.einsum("pj,pi,pji->p", seen.share_v, seen.share_u, seen.nodes)


class Seen(NamedTuple):
    """What the V pixels that see the grid see: T nodes along each axis."""

    near: NDArray  # (Y, X) whether the pixel sees a node
    u: NDArray  # (V,) where it looks
    v: NDArray
    inverse_depth: NDArray
    row: NDArray  # (V, T) of the nodes, which may lie beyond the grid
    column: NDArray
    share_u: NDArray  # (V, T) the modules' profile
    share_v: NDArray
    slope_u: NDArray
    slope_v: NDArray
    nodes: NDArray  # (V, T, T)


def seen_by(grid: NDArray, to_grid: NDArray, outside, sigma: float, shape: tuple[int, ...]) -> Seen:
    """Find the pixels that see the grid, and what they see."""
    dtype, (rows, columns) = grid.dtype, grid.shape
    reach = dtype.type(0.5 + EDGE * sigma if sigma else 1.0)
    w = np.append(to_grid, np.zeros(8 - len(to_grid), dtype))
    y, x = (axis.astype(dtype) for axis in np.indices(shape))
    depth = w[6] * x + (w[7] * y + 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse_depth = np.where(depth > 0, 1 / depth, 0)
        u = (w[0] * x + (w[1] * y + w[2])) * inverse_depth
        v = (w[3] * x + (w[4] * y + w[5])) * inverse_depth
    near = (
        (inverse_depth > 0) & (u > -reach) & (v > -reach) & (u < columns - 1 + reach) & (v < rows - 1 + reach)
    )
    u, v = u[near], v[near]
    column, share_u, slope_u = _profile(u, sigma, reach)
    row, share_v, slope_v = _profile(v, sigma, reach)
    j, i = np.broadcast_arrays(row[:, :, None], column[:, None, :])
    inside = are_inside(j, i, grid.shape)
    nodes = np.where(inside, grid[np.where(inside, j, 0), np.where(inside, i, 0)], outside)
    return Seen(near, u, v, inverse_depth[near], row, column, share_u, share_v, slope_u, slope_v, nodes)


def are_inside(row: NDArray, column: NDArray, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Tell which nodes are those of the grid."""
    return (row >= 0) & (column >= 0) & (row < shape[0]) & (column < shape[1])


def _profile(u: NDArray, sigma: float, reach) -> tuple[NDArray, NDArray, NDArray]:
    """Nodes (V, T) that positions see along an axis, and the profile and its slope there."""
    taps = math.ceil(2.0 * (0.5 + EDGE * sigma)) if sigma else 2
    first = np.floor(u - reach).astype(int) + 1 if sigma else np.floor(u).astype(int)
    node = first[:, None] + np.arange(taps)
    s = u[:, None] - node.astype(u.dtype)
    if not sigma:
        return node, 1 - np.abs(s), np.where(s < 0, 1, -1).astype(u.dtype)
    half, inverse_sigma = u.dtype.type(0.5), u.dtype.type(1.0 / sigma)
    before, before_slope = _edge((s + half) * inverse_sigma)
    after, after_slope = _edge((s - half) * inverse_sigma)
    return node, before - after, (before_slope - after_slope) * inverse_sigma


def _edge(z: NDArray) -> tuple[NDArray, NDArray]:
    """Give the blurred edge and its slope; from `EDGE` on it is 0 or 1."""
    stretch = 1.0 / math.erf(EDGE * math.sqrt(0.5))
    value = 0.5 + 0.5 * stretch * _erf(z * math.sqrt(0.5))
    value = np.where(z >= EDGE, 1.0, np.where(z > -EDGE, value, 0.0))
    slope = np.where(np.abs(z) < EDGE, stretch * np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi), 0.0)
    return value.astype(z.dtype), slope.astype(z.dtype)
