"""Adjoint of the image of a grid; the formulas are in ``warp_backend/render_adjoint.py``."""

from __future__ import annotations

import numpy as np

from evqr_kernels.numpy_backend.render import are_inside, seen_by


def render_code_adjoint(
    grid, to_grid, outside, sigma, adj_image, rows_out, adj_grid_out, adj_to_grid_out
) -> None:
    """Adjoint of `render_code` in grid and map; overwrites."""
    for b in range(len(grid)):
        seen = seen_by(grid[b], to_grid[b], outside[b], sigma, adj_image.shape[1:])
        adj = adj_image[b][seen.near]
        image_du = np.einsum("pj,pi,pji->p", seen.share_v, seen.slope_u, seen.nodes)
        image_dv = np.einsum("pj,pi,pji->p", seen.slope_v, seen.share_u, seen.nodes)
        y, x = (axis.astype(grid.dtype) for axis in np.nonzero(seen.near))
        adj_u, adj_v = adj * image_du * seen.inverse_depth, adj * image_dv * seen.inverse_depth
        sums = [np.sum(along * by) for along in (adj_u, adj_v) for by in (x, y, np.ones_like(x))]
        sums += [-np.sum((adj_u * seen.u + adj_v * seen.v) * by) for by in (x, y)]
        adj_to_grid_out[b] = sums[: to_grid.shape[1]]

        share = adj[:, None, None] * seen.share_v[:, :, None] * seen.share_u[:, None, :]
        row, column = np.broadcast_arrays(seen.row[:, :, None], seen.column[:, None, :])
        inside = are_inside(row, column, grid.shape[1:])
        adj_grid_out[b] = 0
        np.add.at(adj_grid_out[b], (row[inside], column[inside]), share[inside])
