"""Gauss-Newton on poses; the formulas are in ``warp_backend/align.py``."""

from __future__ import annotations

import numpy as np

from evqr_kernels.numpy_backend.pose import bilinear, part_of, project
from evqr_kernels.numpy_backend.pose_normal import jacobian_of


def align_poses(
    image, image_idx, image_part, table_idx, points, table, table_ptr, gram, terms, factors, parameters,
    settings, max_iterations, pose_inout, result_out,
) -> None:  # fmt: skip
    """Refine poses; overwrites the results."""
    for h, m in enumerate(table_idx):
        part = slice(*table_ptr[m])
        # those of the parameters that are free, and of the gain
        rows = np.r_[: min(parameters[m], len(terms) - 2), len(terms) - 2 : len(terms)]
        _align_pose(
            part_of(image[image_idx[h]], image_part[h]), points[part], table[part],
            gram[m].astype(np.float64), terms[rows], factors[rows], settings[m], max_iterations,
            pose_inout[h], result_out[h],
        )  # fmt: skip


def _align_pose(image, points, table, gram, terms, factors, settings, max_iterations, pose, result) -> None:
    """Refine one pose in place."""
    centre_u, centre_v, scale_u, scale_v, ridge, damping, tolerance = (float(value) for value in settings)
    longer = max(scale_u, scale_v)
    gain_gram = gram[-2:, -2:]
    solvable = gain_gram + ridge * np.trace(gain_gram) * np.eye(2)
    to_centre = np.array([[1.0, 0.0, -centre_u], [0.0, 1.0, -centre_v], [0.0, 0.0, 1.0]])
    iterations, last = 0, False
    while True:
        e = bilinear(image, *project(pose, points[:, 0], points[:, 1]))
        moments, energy = (e @ table).astype(np.float64), float(e @ e)
        gain = -np.linalg.solve(solvable, moments[-2:])
        model, cross = gain @ gain_gram @ gain, -gain @ moments[-2:]
        noise = max(energy - 2.0 * cross + model, 0.0) / max(len(points), 1)
        score = cross / np.sqrt(max(model * energy, 1e-20))
        result[:] = (*gain, score, noise, iterations)
        if last or iterations >= max_iterations:
            break
        jacobian = jacobian_of(gain, terms, factors, len(gram))
        matrix = jacobian @ gram @ jacobian.T
        diagonal = np.diag(matrix)
        matrix = matrix + np.diag(damping * diagonal + 1e-7 * diagonal.sum() + 1e-12)
        step = np.zeros(8)
        solved = -np.linalg.solve(matrix, jacobian @ (moments + gram[:, -2:] @ gain))[:-2]
        step[: len(solved)] = solved
        size = np.abs(step).sum()
        step /= max(size, 1.0)
        warp = np.array(
            [
                [1.0 + step[1] / scale_u, step[2] / scale_v, step[0]],
                [step[4] / scale_u, 1.0 + step[5] / scale_v, step[3]],
                [-step[6] / (longer * scale_u), -step[7] / (longer * scale_v), 1.0],
            ]
        )
        moved = (
            pose.reshape(3, 3).astype(np.float64) @ np.linalg.inv(to_centre) @ np.linalg.inv(warp) @ to_centre
        )
        pose[:] = (moved / moved[2, 2]).ravel()
        iterations += 1
        last = size < tolerance
