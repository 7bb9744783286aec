"""The modules of a planar code, solved for in one go; the method is in ``warp_backend/banded.py``."""

from __future__ import annotations

import numpy as np

from evqr_kernels.numpy_backend.solve import apply_stencil


def solve_code_banded(rhs, stencil, damping, free, band_out, q_inout) -> None:
    """Dense solution over the free modules; q is updated in place, the band is not used."""
    is_free = free != 0
    if not free.size:
        return
    for b in range(len(rhs)):
        right = -rhs[b] - apply_stencil(stencil[b], np.where(is_free, 0, q_inout[b]))
        units = np.eye(free.size, dtype=rhs.dtype).reshape(-1, *free.shape)[is_free.ravel()]
        columns = [apply_stencil(stencil[b], unit)[is_free] for unit in units]
        if columns:
            matrix = np.stack(columns, axis=1) + damping[b] * np.eye(len(columns), dtype=rhs.dtype)
            q_inout[b][is_free] = np.linalg.solve(matrix, right[is_free])
