"""Stage two as a textbook would write it: a dense matrix in float64, straight from the model's definition."""

import math

import numpy as np


def _box(offset, sigma):
    """Profile of a module and its slope."""
    z = np.stack([offset, offset - 1.0]) / sigma
    near, far = 0.5 * np.vectorize(math.erf)(z / math.sqrt(2.0))
    slope_near, slope_far = np.exp(-0.5 * z * z) / (math.sqrt(2.0 * math.pi) * sigma)
    return near - far, slope_near - slope_far


def _sampled(image, pose, u, v):
    """The image at code coordinates, bilinear, nothing outside."""
    x, y, z = pose @ np.stack([u, v, np.ones_like(u)])
    x, y = x / z, y / z
    padded = np.pad(image.astype(np.float64), 2)
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    total = np.zeros_like(x)
    for dy in (0, 1):
        for dx in (0, 1):
            weight = (1 - np.abs(x - x0 - dx)) * (1 - np.abs(y - y0 - dy))
            rows = np.clip(y0 + dy + 2, 0, padded.shape[0] - 1)
            columns = np.clip(x0 + dx + 2, 0, padded.shape[1] - 1)
            total += weight * padded[rows, columns]
    return total


def system(image, pose, gain, space, sigma, samples):
    """Matrix A (S, V U) and vector e (S,) of one window: residuals are e + A (q - 1).

    Parameters
    ----------
    image : (Y, X)
    pose : (3, 3)   code coordinates to cells
    gain : (2,)
    """
    quiet = min(3, space.quiet_zone)  # light and known
    down, across = (
        (np.arange((size + 2 * quiet) * samples) + 0.5) / samples - quiet for size in space.known.shape
    )
    b_v, slope_v = _box(down[:, None] - np.arange(space.rows), sigma)
    b_u, slope_u = _box(across[:, None] - np.arange(space.columns), sigma)
    along_u, along_v = (np.einsum("ai,bj->abij", *pair) for pair in ((b_v, slope_u), (slope_v, b_u)))
    v, u = (grid.ravel() for grid in np.meshgrid(down, across, indexing="ij"))
    matrix = (gain[0] * along_u + gain[1] * along_v).reshape(len(u), space.known.size)
    return matrix, _sampled(image, pose, u, v)


def solve(systems, known, values, damping):
    """Modules q (V, U) that fit several weighted windows best.

    Parameters
    ----------
    systems            of (matrix, vector, weight)
    known, values      (V, U) bool and their modules
    damping            relative to the largest diagonal entry; pulls the unknown modules to 0
    """
    normal = sum(w * a.T @ a for a, _, w in systems)
    rhs = -sum(w * a.T @ e for a, e, w in systems)
    free = np.flatnonzero(~known.ravel())
    fixed = np.where(known, values - 1.0, 0.0).ravel()
    pull = damping * normal.diagonal().max()
    matrix = normal[np.ix_(free, free)] + pull * np.eye(len(free))
    q = values.astype(np.float64).ravel()
    q[free] = 1.0 + np.linalg.solve(matrix, (rhs - normal @ fixed)[free] - pull)
    return q.reshape(known.shape)
