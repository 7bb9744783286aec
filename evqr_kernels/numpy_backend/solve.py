"""The modules of a planar code, solved for; the method is in ``warp_backend/solve.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def solve_code(
    rhs, stencil, damping, space_idx, free, bounds, unclear, enough, max_iterations, tolerance, fields_out,
    direction_out, q_inout, iterations_out,
) -> None:  # fmt: skip
    """Conjugate gradients over the free modules; q is updated in place, the scratch is not used."""
    iterations_out[:] = 0
    reach = stencil.shape[1] // 2
    for b, m in enumerate(space_idx):
        if unclear[b].sum() <= enough[m]:
            continue
        top, bottom, left, right = bounds[m]
        # with the neighbours of the free modules
        part = np.s_[max(top - reach, 0) : bottom + reach, max(left - reach, 0) : right + reach]
        is_free = np.zeros(free.shape[1:], bool)
        is_free[top:bottom, left:right] = free[m, top:bottom, left:right] != 0
        iterations_out[b] = _solve_window(
            rhs[b][part], stencil[b], damping[b], is_free[part], q_inout[b][part], max_iterations, tolerance
        )


def _solve_window(rhs, stencil, damping, free, q, max_iterations, tolerance) -> int:
    def system(field: NDArray) -> NDArray:
        return np.where(free, apply_stencil(stencil, field) + damping * field, 0).astype(rhs.dtype)

    residual = np.where(free, -rhs, 0) - system(q)
    direction = np.zeros_like(residual)
    norm = before = start = np.sum(residual * residual)
    for iteration in range(max_iterations):
        if not norm > tolerance**2 * start:  # also of what is not finite
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
    total = np.zeros_like(field)
    for k in range(-min(reach, rows), min(reach, rows) + 1):
        for m in range(-min(reach, columns), min(reach, columns) + 1):
            inside = np.s_[max(-k, 0) : rows - max(k, 0), max(-m, 0) : columns - max(m, 0)]
            there = np.s_[max(k, 0) : rows + min(k, 0), max(m, 0) : columns + min(m, 0)]
            total[inside] += stencil[k + reach, m + reach] * field[there]
    return total
