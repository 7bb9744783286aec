"""Images seen through poses; the formulas are in ``warp_backend/pose.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def sample_moments(image, image_idx, pose, active, points, table, chunks_out, moments_out) -> None:
    """Moments of images seen through poses; overwrites those of active poses."""
    for h in np.flatnonzero(active):
        e = bilinear(image[image_idx[h]], *project(pose[h], points[:, 0], points[:, 1]))
        seen = e != 0  # nothing counts no times what is not finite
        moments_out[h, :-1] = e[seen] @ table[seen]
        moments_out[h, -1] = e @ e


def sample_moments_adjoint(image, image_idx, pose, active, points, table, adj_moments, adj_image_out) -> None:
    """Adjoint of `sample_moments` in the image; accumulates."""
    for h in np.flatnonzero(active):
        b = image_idx[h]
        x, y = project(pose[h], points[:, 0], points[:, 1])
        adj_e = table @ adj_moments[h, :-1] + 2 * bilinear(image[b], x, y) * adj_moments[h, -1]
        for row, column, share, use in corners(adj_image_out[b].shape, x, y):
            np.add.at(adj_image_out[b], (row, column), np.where(use, share * adj_e, 0))


def project(pose: NDArray, u: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
    """Map code coordinates to image pixels; positions at infinity or beyond become NaN or infinite."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        depth = pose[6] * u + pose[7] * v + pose[8]
        return (pose[0] * u + pose[1] * v + pose[2]) / depth, (pose[3] * u + pose[4] * v + pose[5]) / depth


def part_of(image: NDArray, part: NDArray) -> NDArray:
    """Give the part of an image that a pose looks at: first row, rows and columns."""
    top, rows, columns = part
    return image[top : top + rows, :columns]


def corners(
    shape: tuple[int, int], x: NDArray, y: NDArray
) -> list[tuple[NDArray, NDArray, NDArray, NDArray]]:
    """(row, column, share, inside) of the four pixels around each position."""
    height, width = shape
    if not height * width:
        return []
    inside = (x >= 0) & (y >= 0) & (x < width - 1) & (y < height - 1)
    x, y = np.where(inside, x, 0), np.where(inside, y, 0)
    column, row = x.astype(int), y.astype(int)
    fx, fy = x - column.astype(x.dtype), y - row.astype(y.dtype)
    # of a position outside the index is of no matter, but it must exist
    row_below, column_right = np.minimum(row + 1, height - 1), np.minimum(column + 1, width - 1)
    return [
        (row, column, (1 - fx) * (1 - fy), inside),
        (row, column_right, fx * (1 - fy), inside),
        (row_below, column, (1 - fx) * fy, inside),
        (row_below, column_right, fx * fy, inside),
    ]


def bilinear(image: NDArray, x: NDArray, y: NDArray) -> NDArray:
    """Bilinear look-up, 0 where any of the four pixels is outside the image."""
    value = np.zeros(x.shape, image.dtype)
    for row, column, share, inside in corners(image.shape, x, y):
        value += np.where(inside, share * image[row, column], 0)
    return value
