"""Gauss-Newton on poses with a block of a GPU's threads a pose; the formulas are in ``align``.

Threads share out the points, whose moments they add up; then the entries of the system of the parameters and
the gain, a right-hand side beside each row; then, for each row, what an elimination without pivots (the
system is positive) does with the others.  One of them moves the pose.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.align_steps import (
    MOST,
    SETTINGS,
    TERMS,
    make_gain,
    make_gain_factor,
    make_measure,
    make_move,
)
from evqr_kernels.warp_backend.block import make_block_moments, make_held, wait
from evqr_kernels.warp_backend.language import module_of, vector
from evqr_kernels.warp_backend.pose import make_bilinear_in_part, make_project

ROWS = MOST + 2
"""Of the system: parameters, and the gain."""

RAISER, MOVER = 16, 16
"""The first of the threads that raise the diagonal, and the one that moves the pose."""


@cache
def make_align_blocks(dtype: type, columns: int, lanes: int) -> wp.Kernel:
    """Build the kernel for a table of ``columns`` functions; launch: ``lanes`` threads per pose."""
    vec_columns = vector(columns, dtype)
    vec_pair = vector(2, dtype)
    vec_settings = vector(SETTINGS, dtype)
    vec = vector(MOST, dtype)
    bilinear_in_part, project = make_bilinear_in_part(dtype), make_project(dtype)
    gain_factor, gain_at, move = make_gain_factor(dtype), make_gain(dtype, columns), make_move(dtype)
    measure = make_measure(dtype, columns)
    along_u, along_v = columns - 2, columns - 1
    # what the block holds: moments and energy, the size of a step, diagonal, and rows of the system
    step_size, diagonal, system = columns + 1, columns + 2, columns + 2 + ROWS
    pitch = ROWS + 1
    numbers = system + ROWS * pitch
    held_at = make_held(dtype, numbers)
    block_moments = make_block_moments(dtype, columns)

    @wp.func
    def row_of(row: int, parameters: int, terms: wp.array(dtype=wp.int32)) -> int:
        """Find a row's terms: those of the gain are behind all parameters, free or not."""
        return wp.where(row < parameters, row, row - parameters + terms.shape[0] // TERMS - 2)

    @wp.kernel(module=module_of(f"align_blocks_{columns}", dtype, lanes))
    def align_blocks(
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
        free: wp.array(dtype=wp.int32),
        settings: wp.array(dtype=vec_settings),
        max_iterations: int,
        pose_inout: wp.array2d(dtype=dtype),
        result_out: wp.array2d(dtype=dtype),
    ):
        h, lane = wp.tid()
        threads = wp.block_dim()
        held = wp.array(ptr=held_at(), shape=(wp.static(numbers),), dtype=dtype)
        which = table_idx[h]
        first = table_ptr[which, 0]
        end = table_ptr[which, 1]
        parameters = wp.min(free[which], terms.shape[0] // TERMS - 2)
        rows = parameters + 2
        iterations = wp.int32(0)
        moving = wp.int32(1)
        gain_u = dtype(0.0)
        gain_v = dtype(0.0)
        while moving > 0:
            moments = vec_columns()
            energy = dtype(0.0)
            for s in range(first + lane, end, threads):
                x, y = project(pose_inout, h, points[s, 0], points[s, 1])
                e = bilinear_in_part(
                    pairs, image_idx[h], image_part[h, 0], image_part[h, 1], image_part[h, 2], x, y
                )
                if e != dtype(0.0):
                    moments += e * table[s]
                    energy += e * e
            block_moments(moments, energy, held.ptr)
            gain_u, gain_v = gain_at(gram, which, settings[which][4], held[along_u], held[along_v])
            if iterations >= max_iterations or moving == 2:
                moving = 0
            else:
                for n in range(lane, rows * (rows + 1), threads):
                    row = n // (rows + 1)
                    column = n - row * (rows + 1)
                    k = TERMS * row_of(row, parameters, terms)
                    total = dtype(0.0)
                    if column == rows:
                        for i in range(k, k + TERMS):
                            if factors[i] != 0:
                                c = terms[i]
                                residual = (
                                    held[c]
                                    + gram[which, columns * c + along_u] * gain_u
                                    + gram[which, columns * c + along_v] * gain_v
                                )
                                total -= gain_factor(factors[i], gain_u, gain_v) * residual
                    else:
                        m = TERMS * row_of(column, parameters, terms)
                        for i in range(k, k + TERMS):
                            for j in range(m, m + TERMS):
                                if factors[i] != 0 and factors[j] != 0:
                                    weight = gain_factor(factors[i], gain_u, gain_v)
                                    weight *= gain_factor(factors[j], gain_u, gain_v)
                                    total += weight * gram[which, columns * terms[i] + terms[j]]
                    if column == row:
                        held[diagonal + row] = total
                    held[system + pitch * row + column] = total
                wait()
                trace = dtype(0.0)
                for row in range(rows):
                    trace += held[diagonal + row]
                for row in range((RAISER + rows - 1 - lane + threads) % threads, rows, threads):
                    own = held[diagonal + row]
                    own += settings[which][5] * own + dtype(1.0e-7) * trace + dtype(1.0e-12)
                    held[system + pitch * row + row] = own
                wait()
                for pivot in range(rows):
                    # the pivot's column is not read again: nobody writes what others read
                    inverse = dtype(1.0) / held[system + pitch * pivot + pivot]
                    beside = rows - pivot
                    for n in range(lane, rows * beside, threads):
                        row = n // beside
                        column = pivot + 1 + n - row * beside
                        if row != pivot:
                            factor = held[system + pitch * row + pivot] * inverse
                            held[system + pitch * row + column] = (
                                held[system + pitch * row + column]
                                - factor * held[system + pitch * pivot + column]
                            )
                    wait()
                if lane == wp.min(MOVER, threads - 1):
                    step = vec()
                    size = dtype(0.0)
                    for p in range(MOST):
                        if p < parameters:
                            at = system + pitch * p
                            step[p] = held[at + rows] / held[at + p]
                            size += wp.abs(step[p])
                    move(settings, which, step / wp.max(size, dtype(1.0)), h, pose_inout)
                    held[step_size] = size
                wait()
                iterations += 1
                if held[step_size] < settings[which][6]:
                    moving = 2
        if lane == 0:
            measure(
                gram, which, gain_u, gain_v, held[along_u], held[along_v], held[columns], end - first, h,
                result_out,
            )  # fmt: skip
            result_out[h, 4] = dtype(iterations)

    return align_blocks
