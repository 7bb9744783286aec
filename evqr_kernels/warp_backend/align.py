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

One thread owns one pose: a step is a few thousand multiply-adds, less than a launch costs on a CPU.  The
gain is eliminated from its system beforehand.  With D = gram_LL, damped like the rest, that is the same as
less of the Gram matrix and another gain in the right-hand side:

    gram   <- gram - gram_L D^-1 gram_L^T,        a <- a - D^-1 (moments_L + gram_LL a)

What is left is factorised row by row as L D L^T.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import last_axis_as_vector, launch, module_of, neighbours, vector
from evqr_kernels.warp_backend.pose import make_bilinear_in_part, make_project

MOST = 8
"""Parameters of a pose, at most."""

TERMS = 4
"""Columns of the table that the derivative in one parameter is made of, at most."""

SETTINGS = 7
"""Numbers that a launch is told: centre and scale along u and v, ridge, damping, tolerance."""


@cache
def make_gain_factor(dtype: type) -> wp.Function:
    """Build what a term is multiplied with."""

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

    return gain_factor


@cache
def make_entry(dtype: type, columns: int, unrolled: bool) -> wp.Function:
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
    def unrolled_entry(
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
        # one loop, not two, of a shape that a GPU's compiler does not unroll: it would take more registers
        total = dtype(0.0)
        n = TERMS * p
        m = TERMS * q
        while n < TERMS * (p + 1):
            if factors[n] != 0 and factors[m] != 0:
                weight = gain_factor(factors[n], gain_u, gain_v) * gain_factor(factors[m], gain_u, gain_v)
                total += weight * projected(gram, which, projection, terms[n], terms[m])
            m += 1
            if m == TERMS * (q + 1):
                m = TERMS * q
                n += 1
        return total

    return unrolled_entry if unrolled else entry


@cache
def make_newton_step(dtype: type, columns: int, unrolled: bool) -> wp.Function:
    """Build the step of the pose from the moments; parameters that it does not have stay.

    What has an index known only at run time cannot stay in a GPU's registers, so loops over vectors and over
    the triangle are unrolled, and a component is looked up or set by going through all of them.
    """
    vec_columns = vector(columns, dtype)
    vec3 = vector(3, dtype)
    vec = vector(MOST, dtype)
    matrix = wp.types.matrix(shape=(MOST, MOST), dtype=dtype)
    along_u, along_v = columns - 2, columns - 1
    gain_factor = make_gain_factor(dtype)
    entry = make_entry(dtype, columns, unrolled)

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
def make_align_poses(dtype: type, columns: int, unrolled: bool) -> wp.Kernel:
    """Build the kernel for a table of ``columns`` functions; launch: one thread per pose.

    ``unrolled``: faster on a CPU; on a GPU the registers would not do.
    """
    vec_columns = vector(columns, dtype)
    vec_pair = vector(2, dtype)
    vec_settings = vector(SETTINGS, dtype)
    mat33 = wp.types.matrix(shape=(3, 3), dtype=dtype)
    bilinear_in_part = make_bilinear_in_part(dtype)
    project = make_project(dtype)
    along_u, along_v = columns - 2, columns - 1
    newton_step = make_newton_step(dtype, columns, unrolled)

    @wp.kernel(
        module=module_of(f"align_{columns}{'_unrolled' * unrolled}", dtype),
        cuda_max_registers=112 if dtype is wp.float32 else 192,
    )
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
            guu = gram[which, columns * along_u + along_u]
            guv = gram[which, columns * along_u + along_v]
            gvv = gram[which, columns * along_v + along_v]
            extra = settings[which][4] * (guu + gvv)
            determinant = (guu + extra) * (gvv + extra) - guv * guv
            gain_u = -((gvv + extra) * moments[along_u] - guv * moments[along_v]) / determinant
            gain_v = -((guu + extra) * moments[along_v] - guv * moments[along_u]) / determinant
            model = gain_u * gain_u * guu + dtype(2.0) * gain_u * gain_v * guv + gain_v * gain_v * gvv
            cross = -(gain_u * moments[along_u] + gain_v * moments[along_v])
            result_out[h, 0] = gain_u
            result_out[h, 1] = gain_v
            result_out[h, 2] = cross / wp.sqrt(wp.max(model * energy, dtype(1.0e-20)))
            result_out[h, 3] = wp.max(energy - dtype(2.0) * cross + model, dtype(0.0)) / dtype(
                wp.max(end - first, 1)
            )
            result_out[h, 4] = dtype(iterations)
            if iterations >= max_iterations or moving == 2:
                moving = 0
            else:
                # settings are read where they are needed: kept, they would take registers all along, and so
                # would their addresses, were they no vector
                most = wp.min(parameters[which], terms.shape[0] // TERMS - 2)
                step = newton_step(
                    gram, which, terms, factors, most, settings[which][5], gain_u, gain_v, moments
                )
                size = dtype(0.0)
                for p in range(MOST):
                    size += wp.abs(step[p])
                step = step / wp.max(size, dtype(1.0))
                centre_u = settings[which][0]
                centre_v = settings[which][1]
                scale_u = settings[which][2]
                scale_v = settings[which][3]
                longer = wp.max(scale_u, scale_v)
                one = dtype(1.0)
                zero = dtype(0.0)
                inverse_sq = one / (longer * longer)
                tilt_u = step[6] / (scale_u / longer)
                tilt_v = step[7] / (scale_v / longer)
                warp_inverse = wp.inverse(
                    mat33(
                        one + step[1] / scale_u, step[2] / scale_v, step[0],
                        step[4] / scale_u, one + step[5] / scale_v, step[3],
                        -tilt_u * inverse_sq, -tilt_v * inverse_sq, one,
                    )
                )  # fmt: skip
                moved = (
                    mat33(
                        pose_inout[h, 0], pose_inout[h, 1], pose_inout[h, 2],
                        pose_inout[h, 3], pose_inout[h, 4], pose_inout[h, 5],
                        pose_inout[h, 6], pose_inout[h, 7], pose_inout[h, 8],
                    )
                    * mat33(one, zero, centre_u, zero, one, centre_v, zero, zero, one)
                    * warp_inverse
                    * mat33(one, zero, -centre_u, zero, one, -centre_v, zero, zero, one)
                )  # fmt: skip
                for r in range(3):
                    for c in range(3):
                        pose_inout[h, 3 * r + c] = moved[r, c] / moved[2, 2]
                iterations += 1
                if size < settings[which][6]:
                    moving = 2

    return align_poses


def align_poses(
    image, image_idx, image_part, table_idx, points, table, table_ptr, gram, terms, factors, parameters,
    settings, max_iterations, pose_inout, result_out,
) -> None:  # fmt: skip
    """Launch; overwrites the results."""
    dtype, columns = image.dtype, table.shape[1]
    launch(
        make_align_poses(dtype, columns, unrolled=image.device.is_cpu),
        pose_inout.shape[0],
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
