"""Gauss-Newton on poses: the whole of a level of stage one.

With the moments of an image seen through a pose (``pose``), the model's table has C columns with Gram matrix
``gram``, of which the last two, L_u and L_v, carry the gain a = (a_u, a_v):

    a      = -(gram_LL + ridge tr(gram_LL) I)^-1 moments_L             least squares
    J      = (sum_k factor(p, k) e_terms(p, k))_p                      a row a parameter, last two: the gain
    step   = -(J gram J^T + damping diag)^-1 J (moments + gram_L a)    longer than 1: shortened to 1
    pose   = pose o (id + step)^-1

until the step is below the tolerance.  ``terms`` (P + 2, 4) holds for each parameter up to four columns of
the table and ``factors`` what each is multiplied with: 0 nothing, 1 a_u, 2 a_v, 3 one.  The first six
parameters are the affine ones (u: 1, u, v; v: 1, u, v), two more are perspective; coordinates are centred at
``centre`` and divided by ``scale``.

Results: gain, score (the normalised correlation of model and image), noise (the variance of what is left) and
iterations, all at the pose that is returned.

One thread owns one pose: a step is a few thousand multiply-adds, less than a launch costs on a CPU.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import last_axis_as_vector, launch, module_of, neighbours, vector
from evqr_kernels.warp_backend.pose import make_bilinear, make_project

MOST = 10
"""Parameters, the two of the gain included."""


@cache
def make_solve_positive(dtype: type) -> wp.Function:
    """Build the solution of a small symmetric positive system in place, by elimination without pivots."""
    matrix = wp.types.matrix(shape=(MOST, MOST), dtype=dtype)
    vec = vector(MOST, dtype)

    @wp.func
    def solve_positive(a: matrix, b: vec, n: int) -> vec:
        for k in range(n):
            inverse = dtype(1.0) / a[k, k]
            for i in range(k + 1, n):
                factor = a[i, k] * inverse
                for j in range(k + 1, n):
                    a[i, j] = a[i, j] - factor * a[k, j]
                b[i] = b[i] - factor * b[k]
        for r in range(n):
            k = n - 1 - r
            total = b[k]
            for j in range(k + 1, n):
                total -= a[k, j] * b[j]
            b[k] = total / a[k, k]
        return b

    return solve_positive


@cache
def make_align_poses(dtype: type, columns: int) -> wp.Kernel:
    """Build the kernel for a table of ``columns`` functions; launch: one thread per pose."""
    vec_columns = vector(columns, dtype)
    vec_pair = vector(2, dtype)
    vec_parameters = vector(MOST, dtype)
    matrix = wp.types.matrix(shape=(MOST, MOST), dtype=dtype)
    mat33 = wp.types.matrix(shape=(3, 3), dtype=dtype)
    bilinear = make_bilinear(dtype)
    project = make_project(dtype)
    solve_positive = make_solve_positive(dtype)

    @wp.func
    def gain_factor(kind: int, gain_u: dtype, gain_v: dtype) -> dtype:
        factor = dtype(0.0)
        if kind == 1:
            factor = gain_u
        elif kind == 2:
            factor = gain_v
        elif kind == 3:
            factor = dtype(1.0)
        return factor

    @wp.kernel(module=module_of(f"align_{columns}", dtype))
    def align_poses(
        pairs: wp.array3d(dtype=vec_pair),
        image_idx: wp.array(dtype=wp.int32),
        points: wp.array2d(dtype=dtype),
        table: wp.array(dtype=vec_columns),
        gram: wp.array2d(dtype=dtype),
        terms: wp.array2d(dtype=wp.int32),
        factors: wp.array2d(dtype=wp.int32),
        settings: wp.array(dtype=dtype),
        max_iterations: int,
        pose_inout: wp.array2d(dtype=dtype),
        result_out: wp.array2d(dtype=dtype),
    ):
        h = wp.tid()
        b = image_idx[h]
        centre = settings[0]
        scale = settings[1]
        ridge = settings[2]
        damping = settings[3]
        tolerance = settings[4]
        count = points.shape[0]
        n = terms.shape[0]
        parameters = n - 2
        first = columns - 2
        second = columns - 1
        iterations = wp.int32(0)
        moving = wp.int32(1)
        while moving > 0:
            moments = vec_columns()
            energy = dtype(0.0)
            for s in range(count):
                x, y = project(pose_inout, h, points[s, 0], points[s, 1])
                e = bilinear(pairs, b, x, y)
                if e != dtype(0.0):
                    moments += e * table[s]
                    energy += e * e
            guu = gram[first, first]
            guv = gram[first, second]
            gvv = gram[second, second]
            extra = ridge * (guu + gvv)
            determinant = (guu + extra) * (gvv + extra) - guv * guv
            gain_u = -((gvv + extra) * moments[first] - guv * moments[second]) / determinant
            gain_v = -((guu + extra) * moments[second] - guv * moments[first]) / determinant
            model = gain_u * gain_u * guu + dtype(2.0) * gain_u * gain_v * guv + gain_v * gain_v * gvv
            cross = -(gain_u * moments[first] + gain_v * moments[second])
            result_out[h, 0] = gain_u
            result_out[h, 1] = gain_v
            result_out[h, 2] = cross / wp.sqrt(wp.max(model * energy, dtype(1.0e-20)))
            result_out[h, 3] = wp.max(energy - dtype(2.0) * cross + model, dtype(0.0)) / dtype(count)
            result_out[h, 4] = dtype(iterations)
            if iterations >= max_iterations or moving == 2:
                moving = 0
            else:
                # normal matrix and right-hand side from the Gram matrix and the moments
                system = matrix()
                right = vec_parameters()
                for c in range(columns):
                    residual = moments[c] + gram[c, first] * gain_u + gram[c, second] * gain_v
                    for p in range(n):
                        weight = dtype(0.0)
                        for k in range(4):
                            if factors[p, k] != 0 and terms[p, k] == c:
                                weight += gain_factor(factors[p, k], gain_u, gain_v)
                        right[p] = right[p] - weight * residual
                for p in range(n):
                    for q in range(p + 1):
                        total = dtype(0.0)
                        for k in range(4):
                            if factors[p, k] != 0:
                                weight = gain_factor(factors[p, k], gain_u, gain_v)
                                for m in range(4):
                                    if factors[q, m] != 0:
                                        total += (
                                            weight
                                            * gain_factor(factors[q, m], gain_u, gain_v)
                                            * gram[terms[p, k], terms[q, m]]
                                        )
                        system[p, q] = total
                        system[q, p] = total
                trace = dtype(0.0)
                for p in range(n):
                    trace += system[p, p]
                for p in range(n):
                    system[p, p] = (
                        system[p, p] * (dtype(1.0) + damping) + dtype(1.0e-7) * trace + dtype(1.0e-12)
                    )
                step = solve_positive(system, right, n)
                size = dtype(0.0)
                for p in range(parameters):
                    size += wp.abs(step[p])
                shorten = dtype(1.0) / wp.max(size, dtype(1.0))
                for p in range(parameters):
                    step[p] = step[p] * shorten
                tilt_u = dtype(0.0)
                tilt_v = dtype(0.0)
                if parameters > 6:
                    tilt_u = step[6]
                    tilt_v = step[7]
                one = dtype(1.0)
                zero = dtype(0.0)
                inverse_sq = one / (scale * scale)
                warp_inverse = wp.inverse(
                    mat33(
                        one + step[1] / scale, step[2] / scale, step[0],
                        step[4] / scale, one + step[5] / scale, step[3],
                        -tilt_u * inverse_sq, -tilt_v * inverse_sq, one,
                    )
                )  # fmt: skip
                moved = (
                    mat33(
                        pose_inout[h, 0], pose_inout[h, 1], pose_inout[h, 2],
                        pose_inout[h, 3], pose_inout[h, 4], pose_inout[h, 5],
                        pose_inout[h, 6], pose_inout[h, 7], pose_inout[h, 8],
                    )
                    * mat33(one, zero, centre, zero, one, centre, zero, zero, one)
                    * warp_inverse
                    * mat33(one, zero, -centre, zero, one, -centre, zero, zero, one)
                )  # fmt: skip
                for r in range(3):
                    for c in range(3):
                        pose_inout[h, 3 * r + c] = moved[r, c] / moved[2, 2]
                iterations += 1
                if size < tolerance:
                    moving = 2

    return align_poses


def align_poses(
    image, image_idx, points, table, gram, terms, factors, settings, max_iterations, pose_inout, result_out
) -> None:
    """Launch; overwrites the results."""
    dtype, columns = image.dtype, table.shape[1]
    launch(
        make_align_poses(dtype, columns),
        pose_inout.shape[0],
        inputs=[
            neighbours(image, 2),
            image_idx,
            points,
            last_axis_as_vector(table),
            gram,
            terms,
            factors,
            settings,
            max_iterations,
        ],
        outputs=[pose_inout, result_out],
        device=image.device,
    )
