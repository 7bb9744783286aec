"""Scores of poses against models of few points; the formulas are in ``warp_backend/pose_score.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.pose import make_bilinear_in_part, make_project


@cache
def make_score_poses(dtype):
    """Build the kernel; one thread per pose."""
    bilinear_in_part = make_bilinear_in_part(dtype)
    project = make_project(dtype)

    @ti.func
    def correlation(gain_u, gain_v, sums):
        model = gain_u * gain_u * sums[2] + dtype(2.0) * gain_u * gain_v * sums[3] + gain_v * gain_v * sums[4]
        cross = -(gain_u * sums[0] + gain_v * sums[1])
        return cross / ti.sqrt(ti.max(model * sums[5], dtype(1.0e-20)))

    @ti.kernel
    def score_poses(
        image: array(dtype, 3),
        image_idx: array(ti.i32, 1),
        image_part: array(ti.i32, 2),
        pose: array(dtype, 2),
        model_idx: array(ti.i32, 1),
        model_ptr: array(ti.i32, 2),
        model: array(dtype, 2),
        ridge: dtype,
        score_out: array(dtype, 2),
    ):
        for h in range(score_out.shape[0]):
            b = image_idx[h]
            top = image_part[h, 0]
            height = image_part[h, 1]
            width = image_part[h, 2]
            k = model_idx[h]
            sums = ti.Matrix.zero(dtype, 2, 6)
            for part in ti.static(range(2)):
                for s in range(model_ptr[k, part], model_ptr[k, part + 1]):
                    x, y = project(pose, h, model[s, 0], model[s, 1])
                    e = bilinear_in_part(image, b, top, height, width, x, y)
                    along_u = model[s, 2]
                    along_v = model[s, 3]
                    sums[part, 0] += e * along_u
                    sums[part, 1] += e * along_v
                    sums[part, 2] += along_u * along_u
                    sums[part, 3] += along_u * along_v
                    sums[part, 4] += along_v * along_v
                    sums[part, 5] += e * e
            first = ti.Vector([sums[0, c] for c in range(6)])
            second = ti.Vector([sums[1, c] for c in range(6)])
            both = first + second
            extra = ridge * (both[2] + both[4]) + dtype(1.0e-12)
            determinant = (both[2] + extra) * (both[4] + extra) - both[3] * both[3]
            gain_u = -((both[4] + extra) * both[0] - both[3] * both[1]) / determinant
            gain_v = -((both[2] + extra) * both[1] - both[3] * both[0]) / determinant
            score_out[h, 0] = correlation(gain_u, gain_v, both)
            score_out[h, 1] = correlation(gain_u, gain_v, first)
            score_out[h, 2] = correlation(gain_u, gain_v, second)

    return score_poses


def score_poses(
    image, image_idx, image_part, pose, model_idx, model_ptr, model, ridge: float, score_out
) -> None:  # fmt: skip
    """Launch; overwrites."""
    if 0 in score_out.shape:
        return
    kernel = make_score_poses(float_of(image))
    launch(kernel, image, image_idx, image_part, pose, model_idx, model_ptr, model, ridge, score_out)
