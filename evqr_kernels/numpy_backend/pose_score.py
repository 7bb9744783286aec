"""Scores of poses against models of few points; the formulas are in ``warp_backend/pose_score.py``."""

from __future__ import annotations

import numpy as np

from evqr_kernels.numpy_backend.pose import bilinear, part_of, project


def score_poses(
    image, image_idx, image_part, pose, model_idx, model_ptr, model, ridge, score_out
) -> None:  # fmt: skip
    """Correlate images seen through poses with models; overwrites."""
    for h in range(len(pose)):
        first, second, end = model_ptr[model_idx[h]]
        u, v, slope = model[first:end, 0], model[first:end, 1], model[first:end, 2:].astype(np.float64)
        part = part_of(image[image_idx[h]], image_part[h])
        e = bilinear(part, *project(pose[h], u, v)).astype(np.float64)
        gram = slope.T @ slope
        solvable = gram + (ridge * np.trace(gram) + 1e-12) * np.eye(2)
        expected = slope @ np.linalg.solve(solvable, slope.T @ e)
        for k, part in enumerate((slice(None), slice(second - first), slice(second - first, None))):
            energy = (expected[part] @ expected[part]) * (e[part] @ e[part])
            score_out[h, k] = expected[part] @ e[part] / np.sqrt(max(energy, 1e-20))
