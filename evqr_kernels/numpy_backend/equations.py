"""Windows' equations, summed; the formulas are in ``warp_backend/equations.py``."""

from __future__ import annotations

import numpy as np

LEAST_NOISE = 1e-12
"""What less noise counts as."""


def sum_equations(
    rhs, gain, noise, products, rhs_before, stencil_before, score, least, space_idx, known, damping,
    least_damping, most_damping, rhs_out, stencil_out, peak_out, damping_out, q_out,
    solved_idx_out,
) -> None:  # fmt: skip
    """Add windows to earlier ones, and give what the solution of sums begins with; overwrites."""
    dtype = rhs.dtype.type
    weight = (1 / np.maximum(noise, dtype(LEAST_NOISE)))[:, None, None]
    a_u, a_v = gain[:, 0, None, None], gain[:, 1, None, None]
    across, down, mixed = products
    own = a_u * a_u * across + a_v * a_v * down + a_u * a_v * mixed
    stencil_out[:] = stencil_before + weight * own
    reach = products.shape[1] // 2
    middle = stencil_out[:, reach, reach]
    peak_out[:] = np.where(middle == 0, 1, middle)
    stencil_out[:] /= peak_out[:, None, None]
    rhs_out[:] = (rhs_before + weight * rhs) / peak_out[:, None, None]
    damping_out[:] = np.minimum(np.maximum(damping / peak_out, least_damping), most_damping)
    rows, columns = rhs.shape[1:]
    q_out[:] = known[space_idx, :rows, :columns]
    solved_idx_out[:] = np.where(score >= least, space_idx, 0)
