"""Poses: where a code of V x U modules lies in the image.  No events, no device.

Code coordinates (u, v) are (column, row) in modules from the outer corner of the top-left module.  The shape
of a code is (V, U): its rows and columns of modules.

Three by three is too little for BLAS, and its threads are not ours: what is multiplied or inverted here is so
in Python, or by NumPy's own loops.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray


def compose(outer: NDArray[np.float64], inner: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give the map that does one after the other, as a product of matrices.

    Parameters
    ----------
    outer, inner : (..., 3, 3) float64
        What is done last, and first; stacks of maps broadcast.

    Returns
    -------
    both : (..., 3, 3) float64
        ``outer`` of ``inner``.
    """
    if outer.ndim > 2 or inner.ndim > 2:
        return np.einsum("...ij,...jk->...ik", outer, inner)
    (a, b, c), (d, e, f), (g, h, i) = inner.tolist()
    return np.array(
        [[x * a + y * d + z * g, x * b + y * e + z * h, x * c + y * f + z * i] for x, y, z in outer.tolist()]
    )


def inverse(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give the map back, from px to code coordinates.

    Parameters
    ----------
    pose : (3, 3) float64
        Code coordinates to px, or any such map.

    Returns
    -------
    back : (3, 3) float64
        Its inverse.

    Raises
    ------
    ZeroDivisionError
        It has none.
    """
    (a, b, c), (d, e, f), (g, h, i) = pose.tolist()
    first, second, third = e * i - f * h, f * g - d * i, d * h - e * g
    scale = 1.0 / (a * first + b * second + c * third)
    return np.array(
        [
            [first * scale, (c * h - b * i) * scale, (b * f - c * e) * scale],
            [second * scale, (a * i - c * g) * scale, (c * d - a * f) * scale],
            [third * scale, (b * g - a * h) * scale, (a * e - b * d) * scale],
        ]
    )


def _corners(pose: Any, shape: Any, margin: Any) -> tuple[list[Any], list[Any]]:
    """Columns and rows of the corners of a code, in the order of `outline` [px].

    Of numbers, or of arrays of them, a code each: both come to the same, to the bit.
    """
    # written out: four corners of one code are too few for NumPy to be faster
    (a, b, p), (d, e, q), (g, h, r) = pose
    left, right, bottom = -margin, shape[1] + margin, shape[0] + margin
    a0, d0, g0, b0, e0, h0 = a * left, d * left, g * left, b * left, e * left, h * left
    a1, d1, g1, b1, e1, h1 = a * right, d * right, g * right, b * bottom, e * bottom, h * bottom
    w, x, y, z = g0 + h0 + r, g1 + h0 + r, g1 + h1 + r, g0 + h1 + r
    return (
        [(a0 + b0 + p) / w, (a1 + b0 + p) / x, (a1 + b1 + p) / y, (a0 + b1 + p) / z],
        [(d0 + e0 + q) / w, (d1 + e0 + q) / x, (d1 + e1 + q) / y, (d0 + e1 + q) / z],
    )


def _at_centre(pose: Any, shape: Any) -> tuple[tuple[Any, Any], tuple[Any, Any, Any, Any]]:
    """Centre of a code and the Jacobian there, likewise: see `at_centre`."""
    u, v = shape[1] / 2.0, shape[0] / 2.0
    (a, b, p), (d, e, q), (g, h, r) = pose
    w = g * u + h * v + r
    x, y = (a * u + b * v + p) / w, (d * u + e * v + q) / w
    return (x, y), ((a - x * g) / w, (b - x * h) / w, (d - y * g) / w, (e - y * h) / w)


def outline(pose: NDArray[np.float64], shape: tuple[int, int], margin: float = 0.0) -> NDArray[np.float64]:
    """Give the corners of a code, with a margin around it.

    Parameters
    ----------
    pose : (3, 3) float64
        Code coordinates to px.
    shape : (int, int) [modules]
        Rows and columns of the code.
    margin : float [modules]
        Around it.

    Returns
    -------
    corners : (4, 2) float64 [px]
        Top-left, top-right, bottom-right, bottom-left.
    """
    return np.array(_corners(pose.tolist(), shape, margin)).T


def bounds(
    pose: NDArray[np.float64], shape: tuple[int, int], margin: float = 0.0
) -> tuple[float, float, float, float]:
    """Left, top, right and bottom end of a code in the image, with a margin around it [modules] [px]."""
    x, y = _corners(pose.tolist(), shape, margin)
    return min(x), min(y), max(x), max(y)


def bounds_each(
    pose: NDArray[np.float64], shape: NDArray[Any], margin: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give where codes begin and end in their images, each with a margin around it.

    Parameters
    ----------
    pose : (N, 3, 3) float64
        Code coordinates to px.
    shape : (N, 2) int [modules]
        Rows and columns of the codes.
    margin : (N,) float [modules]
        Around them.

    Returns
    -------
    begin, end : (N, 2) float64 [px]
        Left and top, right and bottom.
    """
    corners = np.array(_corners(np.moveaxis(pose, 0, -1), shape.T, margin))
    return corners.min(axis=1).T, corners.max(axis=1).T


def module_px_each(pose: NDArray[np.float64], shape: NDArray[Any]) -> NDArray[np.float64]:
    """Sizes (N,) of a module at the centres of codes (N, 3, 3) of shapes (N, 2) [px]."""
    _, (x_u, x_v, y_u, y_v) = _at_centre(np.moveaxis(pose, 0, -1), shape.T)
    return np.sqrt(np.abs(x_u * y_v - x_v * y_u))


def at_centre(
    pose: NDArray[np.float64], shape: tuple[int, int]
) -> tuple[tuple[float, float], tuple[float, float, float, float]]:
    """Centre of a code [px], and the Jacobian there [px a module]: x_u, x_v, y_u, y_v."""
    return _at_centre(pose.tolist(), shape)


def module_px(pose: NDArray[np.float64], shape: tuple[int, int]) -> float:
    """Size of a module at the centre of a code [px]."""
    _, (x_u, x_v, y_u, y_v) = at_centre(pose, shape)
    return math.sqrt(abs(x_u * y_v - x_v * y_u))


def affine_to_code(pose: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Give W of the paper, (2, 3): px to modules, integers at their centres.

    Perspective is linearised at the code's centre.
    """
    (x, y), (x_u, x_v, y_u, y_v) = at_centre(pose, shape)
    determinant = x_u * y_v - x_v * y_u
    u_x, u_y, v_x, v_y = y_v / determinant, -x_v / determinant, -y_u / determinant, x_u / determinant
    u, v = (shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0
    return np.array([[u_x, u_y, u - u_x * x - u_y * y], [v_x, v_y, v - v_x * x - v_y * y]])
