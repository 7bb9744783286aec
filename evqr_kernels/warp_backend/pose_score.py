"""Scores of poses against models of few points: which of many are worth a closer look.

A model is a list of points with the slope of the printed luminance there, (u, v, L_u, L_v), in two parts; one
list holds the models of all kinds and sizes of codes, one behind the other.  With e_s the image seen through
the pose (`pose.py`) and one gain for all of a model's points,

    a = -(G + ridge trace(G) I)^-1 sum_s e_s (L_u, L_v)_s,     G = sum_s (L_u, L_v)_s (L_u, L_v)_s^T
    score = sum_s e_s x_s / sqrt(sum_s e_s^2 sum_s x_s^2),     x_s = -a . (L_u, L_v)_s

over all points, over those of the first part and over those of the second: what the first part says of the
gain must hold for the second.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import last_axis_as_vector, launch, module_of, neighbours, vector
from evqr_kernels.warp_backend.pose import make_bilinear_in_part, make_project


@cache
def make_score_poses(dtype: type) -> wp.Kernel:
    """Build the kernel; launch: one thread per pose."""
    vec_pair = vector(2, dtype)
    vec_point = vector(4, dtype)
    vec_sums = vector(6, dtype)
    bilinear_in_part = make_bilinear_in_part(dtype)
    project = make_project(dtype)

    @wp.func
    def correlation(gain_u: dtype, gain_v: dtype, sums: vec_sums) -> dtype:
        model = gain_u * gain_u * sums[2] + dtype(2.0) * gain_u * gain_v * sums[3] + gain_v * gain_v * sums[4]
        cross = -(gain_u * sums[0] + gain_v * sums[1])
        return cross / wp.sqrt(wp.max(model * sums[5], dtype(1.0e-20)))

    @wp.kernel(module=module_of("pose_score", dtype))
    def score_poses(
        pairs: wp.array3d(dtype=vec_pair),
        image_idx: wp.array(dtype=wp.int32),
        image_part: wp.array2d(dtype=wp.int32),
        pose: wp.array2d(dtype=dtype),
        model_idx: wp.array(dtype=wp.int32),
        model_ptr: wp.array2d(dtype=wp.int32),
        model: wp.array(dtype=vec_point),
        ridge: dtype,
        score_out: wp.array2d(dtype=dtype),
    ):
        h = wp.tid()
        b = image_idx[h]
        top = image_part[h, 0]
        height = image_part[h, 1]
        width = image_part[h, 2]
        k = model_idx[h]
        sums = vec_sums()
        first = vec_sums()
        for s in range(model_ptr[k, 0], model_ptr[k, 2]):
            if s == model_ptr[k, 1]:
                first = sums
                sums = vec_sums()
            point = model[s]
            x, y = project(pose, h, point[0], point[1])
            e = bilinear_in_part(pairs, b, top, height, width, x, y)
            sums += vec_sums(
                e * point[2],
                e * point[3],
                point[2] * point[2],
                point[2] * point[3],
                point[3] * point[3],
                e * e,
            )
        if model_ptr[k, 1] == model_ptr[k, 2]:
            first = sums
            sums = vec_sums()
        both = first + sums
        extra = ridge * (both[2] + both[4]) + dtype(1.0e-12)
        determinant = (both[2] + extra) * (both[4] + extra) - both[3] * both[3]
        gain_u = -((both[4] + extra) * both[0] - both[3] * both[1]) / determinant
        gain_v = -((both[2] + extra) * both[1] - both[3] * both[0]) / determinant
        score_out[h, 0] = correlation(gain_u, gain_v, both)
        score_out[h, 1] = correlation(gain_u, gain_v, first)
        score_out[h, 2] = correlation(gain_u, gain_v, sums)

    return score_poses


def score_poses(
    image, image_idx, image_part, pose, model_idx, model_ptr, model, ridge: float, score_out
) -> None:  # fmt: skip
    """Launch; overwrites."""
    if not score_out.size:
        return
    launch(
        make_score_poses(image.dtype),
        score_out.shape[0],
        inputs=[
            neighbours(image, 2), image_idx, image_part, pose, model_idx, model_ptr,
            last_axis_as_vector(model), ridge,
        ],
        outputs=[score_out],
        device=image.device,
    )  # fmt: skip
