"""Normal equations of a step on a pose; the formulas are in ``warp_backend/pose_normal.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def pose_normal_equations(moments, gram, terms, factors, ridge, gain_out, matrix_out, rhs_out) -> None:
    """Gain, matrix and right-hand side from moments; overwrites."""
    gain_gram = gram[-2:, -2:]
    solvable = gain_gram + ridge * np.trace(gain_gram) * np.eye(2, dtype=gram.dtype)
    for h in range(len(moments)):
        gain_out[h] = -np.linalg.solve(solvable, moments[h, -3:-1])
        # term by term, so that what is no number stays where it is used
        share = np.array([0.0, *gain_out[h], 1.0], gram.dtype)[factors]
        each = gram[terms[:, :, None, None], terms]
        matrix_out[h] = np.einsum("pk,qm,pkqm->pq", share, share, each)
        rhs_out[h] = (share * (moments[h, :-1] + gram[:, -2:] @ gain_out[h])[terms]).sum(axis=1)


def jacobian_of(gain: NDArray, terms: NDArray, factors: NDArray, columns: int) -> NDArray:
    """Give the share (P + 2, C) of each column of the table in each parameter's derivative."""
    value = np.array([0.0, gain[0], gain[1], 1.0], gain.dtype)
    jacobian = np.zeros((len(terms), columns), gain.dtype)
    for parameter, (columns_of, kinds) in enumerate(zip(terms, factors, strict=True)):
        np.add.at(jacobian[parameter], columns_of, value[kinds])
    return jacobian
