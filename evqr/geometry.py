"""Poses: where a code of so many modules lies in the image.  No events, no device."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def outline(pose: NDArray[np.float64], size: int, margin: float = 0.0) -> NDArray[np.float64]:
    """Corners (4, 2) of a code of ``size`` modules in px: top-left, top-right, bottom-right, bottom-left."""
    near, far = -margin, size + margin
    corners = pose @ np.array([[near, far, far, near], [near, near, far, far], [1.0, 1.0, 1.0, 1.0]])
    return (corners[:2] / corners[2]).T


def at_centre(
    pose: NDArray[np.float64], size: int
) -> tuple[tuple[float, float], tuple[float, float, float, float]]:
    """Centre of a code [px], and the Jacobian there [px a module]: x_u, x_v, y_u, y_v."""
    c = size / 2.0
    (a, b, p), (d, e, q), (g, h, r) = pose.tolist()
    w = c * (g + h) + r
    x, y = (c * (a + b) + p) / w, (c * (d + e) + q) / w
    return (x, y), ((a - x * g) / w, (b - x * h) / w, (d - y * g) / w, (e - y * h) / w)


def module_px(pose: NDArray[np.float64], size: int) -> float:
    """Size of a module at the centre of a code [px]."""
    _, (x_u, x_v, y_u, y_v) = at_centre(pose, size)
    return math.sqrt(abs(x_u * y_v - x_v * y_u))


def affine_to_code(pose: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Give W of the paper, (2, 3): px to modules, integers at their centres.

    Perspective is linearised at the code's centre.
    """
    (x, y), (x_u, x_v, y_u, y_v) = at_centre(pose, size)
    determinant = x_u * y_v - x_v * y_u
    u_x, u_y, v_x, v_y = y_v / determinant, -x_v / determinant, -y_u / determinant, x_u / determinant
    c = (size - 1) / 2.0
    return np.array([[u_x, u_y, c - u_x * x - u_y * y], [v_x, v_y, c - v_x * x - v_y * y]])
