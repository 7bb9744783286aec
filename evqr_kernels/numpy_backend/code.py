"""Right-hand side of the equations of modules; the formula is in ``warp_backend/code.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evqr_kernels.numpy_backend.pose import bilinear, project


def code_rhs(
    image, pose, lattice_u, lattice_v, profile, slope, gain, samples_a_module, samples_out, rows_out, rhs_out
) -> None:
    """Sample images on the lattice and fold them with the model's profiles; overwrites."""
    rows, columns = rhs_out.shape[1:]
    b_u, slope_u = (_along_axis(f, len(lattice_u), columns, samples_a_module) for f in (profile, slope))
    b_v, slope_v = (_along_axis(f, len(lattice_v), rows, samples_a_module) for f in (profile, slope))
    v, u = np.meshgrid(lattice_v, lattice_u, indexing="ij")
    for k in range(len(pose)):
        samples_out[k] = bilinear(image[k], *project(pose[k], u, v))
        rows_out[k, 0] = samples_out[k] @ b_u
        rows_out[k, 1] = samples_out[k] @ slope_u
        rhs_out[k] = gain[k, 0] * (b_v.T @ rows_out[k, 1]) + gain[k, 1] * (slope_v.T @ rows_out[k, 0])


def _along_axis(profile: NDArray, samples: int, modules: int, samples_a_module: int) -> NDArray:
    """Make the (samples, modules) matrix with the profile of each module in its column."""
    matrix = np.zeros((samples, modules), profile.dtype)
    for j in range(modules):
        first = j * samples_a_module - (len(profile) - samples_a_module) // 2
        begin, end = max(first, 0), min(first + len(profile), samples)
        matrix[begin:end, j] = profile[begin - first : end - first]
    return matrix
