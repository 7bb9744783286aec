"""Gauss-Newton on poses; the formulas are in ``warp_backend/align.py``."""

from functools import cache

from evqr_kernels.taichi_backend.align_blocks import make_align_blocks
from evqr_kernels.taichi_backend.align_steps import make_gain, make_gain_factor, make_measure, make_move
from evqr_kernels.taichi_backend.language import (
    array,
    float_of,
    indices_of_window,
    is_alone,
    is_on_cpu,
    run_at,
    ti,
    variant,
)
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.pose import make_bilinear_in_part, make_project

MOST = 10
"""Parameters, the two of the gain included."""


@ti.func
def solve_positive(a, b, n):
    """Solve a small symmetric positive system by elimination without pivots."""
    for k in range(n):
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            for j in range(k + 1, n):
                a[i, j] -= factor * a[k, j]
            b[i] -= factor * b[k]
    for r in range(n):
        k = n - 1 - r
        for j in range(k + 1, n):
            b[k] -= a[k, j] * b[j]
        b[k] /= a[k, k]
    return b


@cache
def make_align_poses(dtype, columns: int, alone: bool):
    """Build the kernel for a table of ``columns`` functions; one thread per pose."""
    indices = indices_of_window(alone)
    bilinear_in_part = make_bilinear_in_part(dtype)
    project = make_project(dtype)
    first = columns - 2
    second = columns - 1
    gain_factor, gain_at = make_gain_factor(dtype), make_gain(dtype, columns)
    measure, move = make_measure(dtype, columns), make_move(dtype)

    @ti.kernel
    def align_poses(
        image: array(dtype, 3),
        image_idx: array(ti.i32, 1),
        image_part: array(ti.i32, 2),
        table_idx: array(ti.i32, 1),
        points: array(dtype, 2),
        table: array(dtype, 2),
        table_ptr: array(ti.i32, 2),
        gram: array(dtype, 3),
        terms: array(ti.i32, 2),
        factors: array(ti.i32, 2),
        free: array(ti.i32, 1),
        settings: array(dtype, 2),
        max_iterations: ti.i32,
        pose_inout: array(dtype, 2),
        result_out: array(dtype, 2),
    ):
        ti.loop_config(serialize=alone)
        for h, idle in ti.ndrange(pose_inout.shape[0], indices):
            if idle > 0:
                continue
            b = image_idx[h]
            top = image_part[h, 0]
            height = image_part[h, 1]
            width = image_part[h, 2]
            which = table_idx[h]
            damping = settings[which, 5]
            tolerance = settings[which, 6]
            begin = table_ptr[which, 0]
            end = table_ptr[which, 1]
            parameters = ti.min(free[which], terms.shape[0] - 2)
            # rows of the terms: those of the free parameters, and behind all of them those of the gain
            n = parameters + 2
            skipped = terms.shape[0] - n
            iterations = 0
            moving = 1
            while moving > 0:
                moments = ti.Vector.zero(dtype, columns)
                energy = dtype(0.0)
                for s in range(begin, end):
                    x, y = project(pose_inout, h, points[s, 0], points[s, 1])
                    e = bilinear_in_part(image, b, top, height, width, x, y)
                    if not e == dtype(0.0):  # NaN, too
                        at = run_at(s * columns)
                        for c in ti.static(range(columns)):
                            moments[c] += e * table[0, at + c]
                        energy += e * e
                gain_u, gain_v = gain_at(gram, which, settings[which, 4], moments[first], moments[second])
                measure(
                    gram, which, gain_u, gain_v, moments[first], moments[second], energy, end - begin, h,
                    result_out,
                )  # fmt: skip
                result_out[h, 4] = dtype(iterations)
                if iterations >= max_iterations or moving == 2:
                    moving = 0
                else:
                    # normal matrix and right-hand side from the Gram matrix and the moments
                    system = ti.Matrix.zero(dtype, MOST, MOST)
                    right = ti.Vector.zero(dtype, MOST)
                    for p in range(n):
                        r = ti.select(p < parameters, p, p + skipped)
                        for k in range(4):
                            if factors[r, k] != 0:
                                c = terms[r, k]
                                residual = (
                                    moments[c]
                                    + gram[which, c, first] * gain_u
                                    + gram[which, c, second] * gain_v
                                )
                                right[p] -= gain_factor(factors[r, k], gain_u, gain_v) * residual
                        for q in range(p + 1):
                            o = ti.select(q < parameters, q, q + skipped)
                            total = dtype(0.0)
                            for k in range(4):
                                if factors[r, k] != 0:
                                    weight = gain_factor(factors[r, k], gain_u, gain_v)
                                    for m in range(4):
                                        if factors[o, m] != 0:
                                            product = weight * gain_factor(factors[o, m], gain_u, gain_v)
                                            total += product * gram[which, terms[r, k], terms[o, m]]
                            system[p, q] = total
                            system[q, p] = total
                    trace = dtype(0.0)
                    for p in range(n):
                        trace += system[p, p]
                    for p in range(n):
                        system[p, p] *= dtype(1.0) + damping
                        system[p, p] += dtype(1.0e-7) * trace + dtype(1.0e-12)
                    step = solve_positive(system, right, n)
                    size = dtype(0.0)
                    for p in range(parameters):
                        size += ti.abs(step[p])
                    step /= ti.max(size, dtype(1.0))
                    tilt_u = dtype(0.0)
                    tilt_v = dtype(0.0)
                    if parameters > 6:
                        tilt_u = step[6]
                        tilt_v = step[7]
                    move(settings, which, step, tilt_u, tilt_v, h, pose_inout)
                    iterations += 1
                    if size < tolerance:
                        moving = 2

    return align_poses


def align_poses(
    image, image_idx, image_part, table_idx, points, table, table_ptr, gram, terms, factors, parameters,
    settings, max_iterations, pose_inout, result_out,
) -> None:  # fmt: skip
    """Launch a thread a pose, or a block, as the table has it for the device; overwrites the results."""
    dtype, columns, lanes = float_of(image), table.shape[1], variant("align_poses", is_on_cpu(image)).lanes
    launch(
        make_align_blocks(dtype, columns, lanes)
        if lanes > 1
        else make_align_poses(dtype, columns, is_alone(pose_inout)),
        *(image, image_idx, image_part, table_idx, points, table, table_ptr, gram, terms, factors),
        *(parameters, settings, max_iterations, pose_inout, result_out),
    )
