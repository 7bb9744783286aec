"""Stage two as a textbook would write it: a dense matrix in float64, straight from the model's definition."""

import math

import numpy as np

QUIET = 3
"""Modules of quiet zone that are looked at, light and known."""


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


def system(image, pose, gain, size, sigma, samples):
    """Matrix A (S, r r) and vector e (S,) of one window: residuals are e + A (q - 1).

    Parameters
    ----------
    image : (Y, X)
    pose : (3, 3)   code coordinates to cells
    gain : (2,)
    """
    axis = (np.arange((size + 2 * QUIET) * samples) + 0.5) / samples - QUIET
    b, slope = _box(axis[:, None] - np.arange(size), sigma)
    matrix = gain[0] * np.einsum("ai,bj->abij", b, slope) + gain[1] * np.einsum("ai,bj->abij", slope, b)
    v, u = (grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij"))
    return matrix.reshape(len(u), size * size), _sampled(image, pose, u, v)


def solve(systems, known, values, damping):
    """Modules q (r, r) that fit several weighted windows best.

    Parameters
    ----------
    systems            of (matrix, vector, weight)
    known, values      (r, r) bool and their modules
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
