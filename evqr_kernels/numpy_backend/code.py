"""Stage two's right-hand side; the formula is in ``warp_backend/code.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evqr_kernels.numpy_backend.pose import bilinear, project


def code_rhs(
    image, pose, lattice, profile, slope, gain, samples_a_module, samples_out, rows_out, rhs_out
) -> None:
    """Sample images on the lattice and fold them with the model's profiles; overwrites."""
    modules = rhs_out.shape[1]
    b = _along_axis(profile, len(lattice), modules, samples_a_module)
    b_slope = _along_axis(slope, len(lattice), modules, samples_a_module)
    v, u = np.meshgrid(lattice, lattice, indexing="ij")
    for k in range(len(pose)):
        samples_out[k] = bilinear(image[k], *project(pose[k], u, v))
        rows_out[k, 0] = samples_out[k] @ b
        rows_out[k, 1] = samples_out[k] @ b_slope
        rhs_out[k] = gain[k, 0] * (b.T @ rows_out[k, 1]) + gain[k, 1] * (b_slope.T @ rows_out[k, 0])


def _along_axis(profile: NDArray, samples: int, modules: int, samples_a_module: int) -> NDArray:
    """Make the (samples, modules) matrix with the profile of each module in its column."""
    matrix = np.zeros((samples, modules), profile.dtype)
    for j in range(modules):
        first = j * samples_a_module - (len(profile) - samples_a_module) // 2
        begin, end = max(first, 0), min(first + len(profile), samples)
        matrix[begin:end, j] = profile[begin - first : end - first]
    return matrix
