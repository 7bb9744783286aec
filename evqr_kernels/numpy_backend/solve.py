"""The modules of a planar code, solved for; the method is in ``warp_backend/solve.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def solve_code(
    rhs, stencil, damping, free, max_iterations, tolerance, residual_out, direction_out, next_direction_out,
    product_out, sums_out, next_sums_out, q_inout, iterations_out,
) -> None:  # fmt: skip
    """Conjugate gradients over the free modules; q is updated in place, the scratch is not used."""
    for b in range(len(rhs)):
        iterations_out[b] = _solve_window(
            rhs[b], stencil[b], damping[b], free != 0, q_inout[b], max_iterations, tolerance
        )


def _solve_window(rhs, stencil, damping, free, q, max_iterations, tolerance) -> int:
    def system(field: NDArray) -> NDArray:
        return np.where(free, apply_stencil(stencil, field) + damping * field, 0).astype(rhs.dtype)

    residual = np.where(free, -rhs, 0) - system(q)
    direction = np.zeros_like(residual)
    norm = before = start = np.sum(residual * residual)
    for iteration in range(max_iterations):
        if norm <= tolerance**2 * start:
            return iteration
        direction = residual + norm / before * direction
        product = system(direction)
        step = norm / np.sum(direction * product)
        q += step * direction
        residual = residual - step * product
        before, norm = norm, np.sum(residual * residual)
    return max_iterations


def apply_stencil(stencil: NDArray, field: NDArray) -> NDArray:
    """Correlate with the stencil; outside the grid everything is 0."""
    reach = len(stencil) // 2
    rows, columns = field.shape
    padded = np.pad(field, reach)
    total = np.zeros_like(field)
    for k in range(2 * reach + 1):
        for m in range(2 * reach + 1):
            total += stencil[k, m] * padded[k : k + rows, m : m + columns]
    return total
