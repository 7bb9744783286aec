"""Gauss-Newton on poses: the whole of an alignment on one level.

With the moments of an image seen through a pose (``pose``), the model's table has C columns with Gram matrix
``gram``, of which the last two, L_u and L_v, carry the gain a = (a_u, a_v):

    a      = -(gram_LL + ridge tr(gram_LL) I)^-1 moments_L             least squares
    J      = (sum_k factor(p, k) e_terms(p, k))_p                      a row a parameter, last two: the gain
    step   = -(J gram J^T + damping diag)^-1 J (moments + gram_L a)    longer than 1: shortened to 1
    pose   = pose o (id + step)^-1

until the step is below the tolerance.  ``terms`` (P + 2, 4) holds for each parameter up to four columns of
the table and ``factors`` what each is multiplied with: 0 nothing, 1 a_u, 2 a_v, 3 one.  The first six
parameters are the affine ones (u: 1, u, v; v: 1, u, v), two more are perspective; coordinates are centred at
``centre`` and divided by ``scale``, both an axis.  Perspective moves a point by u, or v, times its distance
from the centre over the longer scale.

Poses are of several codes: the tables of all lie one behind the other, ``table_ptr`` says which rows are
whose.  Of each only the first ``parameters`` are free.

Results: gain, score (the normalised correlation of model and image), noise (the variance of what is left) and
iterations, all at the pose that is returned.

On a GPU a block of threads has a pose (``align_blocks``).  On a CPU one thread owns one: a step is a few
thousand multiply-adds, less than a launch costs.  The gain is eliminated from its system beforehand.  With
D = gram_LL, damped like the rest, that is the same as less of the Gram matrix and another gain in the
right-hand side:

    gram   <- gram - gram_L D^-1 gram_L^T,        a <- a - D^-1 (moments_L + gram_LL a)

What is left is factorised row by row as L D L^T.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.align_blocks import make_align_blocks
from evqr_kernels.warp_backend.align_steps import (
    MOST,
    SETTINGS,
    TERMS,
    make_gain,
    make_gain_factor,
    make_measure,
    make_move,
)
from evqr_kernels.warp_backend.block import lanes_on
from evqr_kernels.warp_backend.language import (
    last_axis_as_vector,
    launch,
    module_of,
    neighbours,
    variant,
    vector,
)
from evqr_kernels.warp_backend.pose import make_bilinear_in_part, make_project


@cache
def make_entry(dtype: type, columns: int) -> wp.Function:
    """Build an entry (p, q) of the normal matrix: of the Gram matrix less ``gram_L projection gram_L^T``.

    Arrays are flat.  ``projection``: the symmetric matrix's entries uu, uv, vv.
    """
    vec3 = vector(3, dtype)
    along_u, along_v = columns - 2, columns - 1
    gain_factor = make_gain_factor(dtype)

    @wp.func
    def projected(gram: wp.array2d(dtype=dtype), which: int, projection: vec3, c: int, d: int) -> dtype:
        c_u = gram[which, columns * c + along_u]
        c_v = gram[which, columns * c + along_v]
        with_u = projection[0] * c_u + projection[1] * c_v
        with_v = projection[1] * c_u + projection[2] * c_v
        return (
            gram[which, columns * c + d]
            - with_u * gram[which, columns * d + along_u]
            - with_v * gram[which, columns * d + along_v]
        )

    @wp.func
    def entry(
        gram: wp.array2d(dtype=dtype),
        which: int,
        terms: wp.array(dtype=wp.int32),
        factors: wp.array(dtype=wp.int32),
        gain_u: dtype,
        gain_v: dtype,
        projection: vec3,
        p: int,
        q: int,
    ) -> dtype:
        total = dtype(0.0)
        for k in range(TERMS):
            n = TERMS * p + k
            if factors[n] != 0:
                part = dtype(0.0)
                for j in range(TERMS):
                    m = TERMS * q + j
                    if factors[m] != 0:
                        part += gain_factor(factors[m], gain_u, gain_v) * projected(
                            gram, which, projection, terms[n], terms[m]
                        )
                total += gain_factor(factors[n], gain_u, gain_v) * part
        return total

    return entry


@cache
def make_newton_step(dtype: type, columns: int) -> wp.Function:
    """Build the step of the pose from the moments; parameters that it does not have stay.

    Loops over vectors and over the triangle are unrolled, so that a compiler keeps them in registers.
    """
    vec_columns = vector(columns, dtype)
    vec3 = vector(3, dtype)
    vec = vector(MOST, dtype)
    matrix = wp.types.matrix(shape=(MOST, MOST), dtype=dtype)
    along_u, along_v = columns - 2, columns - 1
    gain_factor = make_gain_factor(dtype)
    entry = make_entry(dtype, columns)

    @wp.func
    def pick(values: vec_columns, c: int) -> dtype:
        value = dtype(0.0)
        for i in range(wp.static(columns)):
            value += wp.where(c == wp.static(i), values[i], dtype(0.0))
        return value

    @wp.func
    def newton_step(
        gram: wp.array2d(dtype=dtype),
        which: int,
        terms: wp.array(dtype=wp.int32),
        factors: wp.array(dtype=wp.int32),
        parameters: int,
        damping: dtype,
        gain_u: dtype,
        gain_v: dtype,
        moments: vec_columns,
    ) -> vec:
        lower = matrix()  # L, and D^-1 on its diagonal
        guu = gram[which, columns * along_u + along_u]
        guv = gram[which, columns * along_u + along_v]
        gvv = gram[which, columns * along_v + along_v]
        trace = guu + gvv
        for p in range(parameters):
            diagonal = entry(gram, which, terms, factors, gain_u, gain_v, vec3(), p, p)
            trace += diagonal
            for i in range(MOST):
                lower[i, i] = wp.where(p == i, diagonal, lower[i, i])
        ridge = dtype(1.0e-7) * trace + dtype(1.0e-12)
        for i in range(MOST):
            lower[i, i] = damping * lower[i, i] + ridge

        right_u = moments[along_u] + guu * gain_u + guv * gain_v
        right_v = moments[along_v] + guv * gain_u + gvv * gain_v
        guu += damping * guu + ridge
        gvv += damping * gvv + ridge
        projection = vec3(gvv, -guv, guu) / (guu * gvv - guv * guv)
        rest_u = gain_u - projection[0] * right_u - projection[1] * right_v
        rest_v = gain_v - projection[1] * right_u - projection[2] * right_v
        step = vec()
        for p in range(parameters):
            right = dtype(0.0)
            for n in range(TERMS * p, TERMS * (p + 1)):
                if factors[n] != 0:
                    c = terms[n]
                    residual = pick(moments, c)
                    residual += (
                        gram[which, columns * c + along_u] * rest_u
                        + gram[which, columns * c + along_v] * rest_v
                    )
                    right -= gain_factor(factors[n], gain_u, gain_v) * residual
            for i in range(MOST):
                step[i] = wp.where(p == i, right, step[i])

        for i in range(MOST):
            if i < parameters:
                row = vec()
                for q in range(wp.static(i + 1)):
                    row[q] = entry(gram, which, terms, factors, gain_u, gain_v, projection, i, q)
                lower[i, i] = lower[i, i] + row[i]
                for j in range(wp.static(i)):
                    for k in range(wp.static(j)):
                        row[j] = row[j] - lower[j, k] * row[k]
                for j in range(wp.static(i)):
                    lower[i, j] = row[j] * lower[j, j]
                    lower[i, i] = lower[i, i] - lower[i, j] * row[j]
                    step[i] = step[i] - lower[i, j] * step[j]
                lower[i, i] = dtype(1.0) / lower[i, i]
        for i in range(MOST):
            step[i] = step[i] * lower[i, i]
        for j in range(wp.static(MOST - 1)):
            for i in range(wp.static(MOST - 1 - j)):
                step[i] = step[i] - lower[wp.static(MOST - 1 - j), i] * step[wp.static(MOST - 1 - j)]
        return step

    return newton_step


@cache
def make_align_poses(dtype: type, columns: int) -> wp.Kernel:
    """Build the kernel for a table of ``columns`` functions; launch: one thread per pose."""
    vec_columns = vector(columns, dtype)
    vec_pair = vector(2, dtype)
    vec_settings = vector(SETTINGS, dtype)
    move, gain_at, measure = make_move(dtype), make_gain(dtype, columns), make_measure(dtype, columns)
    bilinear_in_part = make_bilinear_in_part(dtype)
    project = make_project(dtype)
    along_u, along_v = columns - 2, columns - 1
    newton_step = make_newton_step(dtype, columns)

    @wp.kernel(module=module_of(f"align_{columns}", dtype))
    def align_poses(
        pairs: wp.array3d(dtype=vec_pair),
        image_idx: wp.array(dtype=wp.int32),
        image_part: wp.array2d(dtype=wp.int32),
        table_idx: wp.array(dtype=wp.int32),
        points: wp.array2d(dtype=dtype),
        table: wp.array(dtype=vec_columns),
        table_ptr: wp.array2d(dtype=wp.int32),
        gram: wp.array2d(dtype=dtype),
        terms: wp.array(dtype=wp.int32),
        factors: wp.array(dtype=wp.int32),
        parameters: wp.array(dtype=wp.int32),
        settings: wp.array(dtype=vec_settings),
        max_iterations: int,
        pose_inout: wp.array2d(dtype=dtype),
        result_out: wp.array2d(dtype=dtype),
    ):
        h = wp.tid()
        b = image_idx[h]
        top = image_part[h, 0]
        height = image_part[h, 1]
        width = image_part[h, 2]
        which = table_idx[h]
        first = table_ptr[which, 0]
        end = table_ptr[which, 1]
        iterations = wp.int32(0)
        moving = wp.int32(1)
        while moving > 0:
            moments = vec_columns()
            energy = dtype(0.0)
            for s in range(first, end):
                x, y = project(pose_inout, h, points[s, 0], points[s, 1])
                e = bilinear_in_part(pairs, b, top, height, width, x, y)
                if e != dtype(0.0):
                    moments += e * table[s]
                    energy += e * e
            gain_u, gain_v = gain_at(gram, which, settings[which][4], moments[along_u], moments[along_v])
            measure(
                gram, which, gain_u, gain_v, moments[along_u], moments[along_v], energy, end - first, h,
                result_out,
            )  # fmt: skip
            result_out[h, 4] = dtype(iterations)
            if iterations >= max_iterations or moving == 2:
                moving = 0
            else:
                most = wp.min(parameters[which], terms.shape[0] // TERMS - 2)
                step = newton_step(
                    gram, which, terms, factors, most, settings[which][5], gain_u, gain_v, moments
                )
                size = dtype(0.0)
                for p in range(MOST):
                    size += wp.abs(step[p])
                step = step / wp.max(size, dtype(1.0))
                move(settings, which, step, h, pose_inout)
                iterations += 1
                if size < settings[which][6]:
                    moving = 2

    return align_poses


def align_poses(
    image, image_idx, image_part, table_idx, points, table, table_ptr, gram, terms, factors, parameters,
    settings, max_iterations, pose_inout, result_out,
) -> None:  # fmt: skip
    """Launch a thread a pose, or a block, as the table has it for the device; overwrites the results."""
    dtype, columns = image.dtype, table.shape[1]
    lanes = variant("align_poses", image.device).lanes
    launch(
        make_align_blocks(dtype, columns, lanes) if lanes > 1 else make_align_poses(dtype, columns),
        (pose_inout.shape[0], lanes_on(image.device, lanes)) if lanes > 1 else pose_inout.shape[0],
        inputs=[
            neighbours(image, 2),
            image_idx,
            image_part,
            table_idx,
            points,
            last_axis_as_vector(table),
            table_ptr,
            gram.reshape((gram.shape[0], columns * columns)),
            terms.flatten(),
            factors.flatten(),
            parameters,
            last_axis_as_vector(settings),
            max_iterations,
        ],
        outputs=[pose_inout, result_out],
        device=image.device,
    )
