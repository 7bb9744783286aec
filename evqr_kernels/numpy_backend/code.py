"""Right-hand side of the equations of modules; the formula is in ``warp_backend/code.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evqr_kernels.numpy_backend.pose import bilinear, project


def code_rhs(
    image, pose, space_idx, lattice_u, lattice_v, sides, profile, slope, gain, samples_a_module, samples_out,
    rows_out, rhs_out,
) -> None:  # fmt: skip
    """Sample images on their lattices and fold them with the model's profiles; the scratch is not used."""
    rhs_out[:] = 0
    for b, m in enumerate(space_idx):
        rows, columns = sides[m]
        across, down = lattice_u[m, : columns * samples_a_module], lattice_v[m, : rows * samples_a_module]
        b_u, slope_u = (_along_axis(f, columns, samples_a_module) for f in (profile, slope))
        b_v, slope_v = (_along_axis(f, rows, samples_a_module) for f in (profile, slope))
        v, u = np.meshgrid(down, across, indexing="ij")
        samples = bilinear(image[b], *project(pose[b], u, v))
        along_u, along_v = gain[b, 0] * (b_v.T @ samples), gain[b, 1] * (slope_v.T @ samples)
        rhs_out[b, :rows, :columns] = along_u @ slope_u + along_v @ b_u


def _along_axis(profile: NDArray, modules: int, samples_a_module: int) -> NDArray:
    """Make the (samples, modules) matrix with the profile of each module in its column."""
    samples = modules * samples_a_module
    matrix = np.zeros((samples, modules), profile.dtype)
    for j in range(modules):
        first = j * samples_a_module - (len(profile) - samples_a_module) // 2
        begin, end = max(first, 0), min(first + len(profile), samples)
        matrix[begin:end, j] = profile[begin - first : end - first]
    return matrix
