"""Image of a grid under an affine map; the formulas are in ``warp_backend/render.py``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


def render_affine(grid, affine, outside, image_out) -> None:
    """Image of a grid under an affine map, bilinear; overwrites."""
    for b in range(len(grid)):
        cell = _cells(grid[b], affine[b], outside[b], image_out.shape[1:])
        (q00, q01), (q10, q11) = cell.nodes
        top, bottom = q00 + cell.fu * (q01 - q00), q10 + cell.fu * (q11 - q10)
        image_out[b] = outside[b]
        image_out[b][cell.near] = top + cell.fv * (bottom - top)


def render_affine_adjoint(grid, affine, outside, adj_image, rows_out, adj_grid_out, adj_affine_out) -> None:
    """Adjoint of `render_affine` in grid and affine; overwrites."""
    for b in range(len(grid)):
        cell = _cells(grid[b], affine[b], outside[b], adj_image.shape[1:])
        adj = adj_image[b][cell.near]
        (q00, q01), (q10, q11) = cell.nodes
        adj_u = adj * ((1 - cell.fv) * (q01 - q00) + cell.fv * (q11 - q10))
        adj_v = adj * ((1 - cell.fu) * (q10 - q00) + cell.fu * (q11 - q01))
        y, x = (axis.astype(grid.dtype) for axis in np.nonzero(cell.near))
        adj_affine_out[b] = [np.sum(along * by) for along in (adj_u, adj_v) for by in (x, y, np.ones_like(x))]

        adj_padded = np.zeros((grid.shape[1] + 2, grid.shape[2] + 2), grid.dtype)
        for dj, share_v in ((0, 1 - cell.fv), (1, cell.fv)):
            for di, share_u in ((0, 1 - cell.fu), (1, cell.fu)):
                np.add.at(adj_padded, (cell.row + dj, cell.column + di), adj * share_v * share_u)
        adj_grid_out[b] = adj_padded[1:-1, 1:-1]


class _Cells(NamedTuple):
    """Where the V pixels that the grid reaches fall in the grid, which gets a border of ``outside`` first."""

    near: NDArray  # (Y, X) whether the grid reaches the pixel
    row: NDArray  # (V,) of the cell's first node, in the grid with its border
    column: NDArray
    fu: NDArray  # (V,) position in the cell
    fv: NDArray
    nodes: tuple[tuple[NDArray, NDArray], tuple[NDArray, NDArray]]  # (V,) each: the cell's four nodes


def _cells(grid: NDArray, affine: NDArray, outside, shape: tuple[int, ...]) -> _Cells:
    rows, columns = grid.shape
    y, x = (axis.astype(grid.dtype) for axis in np.indices(shape))
    u = affine[0] * x + affine[1] * y + affine[2]
    v = affine[3] * x + affine[4] * y + affine[5]
    near = (u > -1) & (v > -1) & (u < columns) & (v < rows)
    u, v = u[near], v[near]
    left, above = np.floor(u), np.floor(v)
    padded = np.pad(grid, 1, constant_values=outside)
    row, column = above.astype(int) + 1, left.astype(int) + 1
    nodes = (
        (padded[row, column], padded[row, column + 1]),
        (padded[row + 1, column], padded[row + 1, column + 1]),
    )
    return _Cells(near, row, column, u - left, v - above, nodes)
