"""Normal equations of modules; the formulas are in ``warp_backend/code_normal.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evqr_kernels.numpy_backend.code import code_rhs
from evqr_kernels.numpy_backend.solve import apply_stencil


def code_normal_equations(
    image, pose, space_idx, lattice_u, lattice_v, sides, profile, slope, gain, samples_a_module, samples_out,
    rows_out, stencil_out, rhs_out,
) -> None:  # fmt: skip
    """Stencil of A^T A, and A^T E; overwrites."""
    reach = stencil_out.shape[1] // 2
    bb, ss, bs = (
        _correlate(f, g, reach, samples_a_module)
        for f, g in ((profile, profile), (slope, slope), (profile, slope))
    )
    sb = bs[::-1]
    for b, (a_u, a_v) in enumerate(gain):
        stencil_out[b] = a_u * a_u * np.outer(bb, ss) + a_v * a_v * np.outer(ss, bb)
        stencil_out[b] += a_u * a_v * (np.outer(bs, sb) + np.outer(sb, bs))
    code_rhs(
        image, pose, space_idx, lattice_u, lattice_v, sides, profile, slope, gain, samples_a_module,
        samples_out, rows_out, rhs_out,
    )  # fmt: skip


def code_product(q, stencil, damping, free, product_out) -> None:
    """Product of (stencil + damping I) with modules, on the free ones; overwrites."""
    for b in range(len(q)):
        product_out[b] = np.where(free != 0, apply_stencil(stencil[b], q[b]) + damping[b] * q[b], 0)


def _correlate(f: NDArray, g: NDArray, reach: int, samples_a_module: int) -> NDArray:
    """Sum over s of f(s) g(s + k samples_a_module) for k = -reach to reach."""
    pad = reach * samples_a_module
    padded = np.pad(g, pad)
    return np.array([f @ padded[k : k + len(f)] for k in range(0, 2 * pad + 1, samples_a_module)])
