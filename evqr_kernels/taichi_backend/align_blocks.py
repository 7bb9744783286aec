"""Gauss-Newton on poses with a block of threads a pose; see ``warp_backend/align_blocks.py``."""

from functools import cache

from evqr_kernels.taichi_backend.align_steps import make_gain, make_gain_factor, make_measure, make_move
from evqr_kernels.taichi_backend.block import wait
from evqr_kernels.taichi_backend.language import array, ti
from evqr_kernels.taichi_backend.pose import make_bilinear_in_part, make_project

MOST = 8
"""Parameters of a pose, at most."""

ROWS = MOST + 2
"""Of the system: parameters, and the gain."""

RAISER, MOVER = 16, 16
"""The first of the lanes that raise the diagonal, and the one that moves the pose: amid those that work, so
that a driver which takes lanes by turns shows that a barrier is missing."""


@cache
def make_align_blocks(dtype, columns: int, lanes: int):
    """Build the kernel for a table of ``columns`` functions; ``lanes`` threads per pose."""
    bilinear_in_part, project = make_bilinear_in_part(dtype), make_project(dtype)
    gain_factor, gain_at = make_gain_factor(dtype), make_gain(dtype, columns)
    measure, move = make_measure(dtype, columns), make_move(dtype)
    first = columns - 2
    second = columns - 1
    sums = columns + 1
    step_size = 0  # of what the block holds beside moments and system, and behind it the diagonal
    turns = (ROWS * (ROWS + 1) + lanes - 1) // lanes

    @ti.func
    def row_of(row, parameters, terms: ti.template()):
        """Find a row's terms: those of the gain are behind all parameters, free or not."""
        return ti.select(row < parameters, row, row - parameters + terms.shape[0] - 2)

    @ti.kernel
    def align_blocks(
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
        ti.loop_config(block_dim=lanes)
        for index in range(pose_inout.shape[0] * lanes):
            parts = ti.simt.block.SharedArray((sums, lanes), dtype)
            moments = ti.simt.block.SharedArray((sums,), dtype)
            beside = ti.simt.block.SharedArray((1 + ROWS,), dtype)
            system = ti.simt.block.SharedArray((ROWS, ROWS + 1), dtype)
            h = index // lanes
            lane = index % lanes
            which = table_idx[h]
            begin = table_ptr[which, 0]
            end = table_ptr[which, 1]
            parameters = ti.min(free[which], terms.shape[0] - 2)
            rows = parameters + 2
            iterations = 0
            moving = 1
            gain_u = dtype(0.0)
            gain_v = dtype(0.0)
            while moving > 0:
                own = ti.Vector.zero(dtype, sums)
                for turn in range((end - begin + lanes - 1) // lanes):
                    s = begin + turn * lanes + lane
                    if s < end:
                        x, y = project(pose_inout, h, points[s, 0], points[s, 1])
                        e = bilinear_in_part(
                            image, image_idx[h], image_part[h, 0], image_part[h, 1], image_part[h, 2], x, y
                        )
                        if not e == dtype(0.0):  # NaN, too
                            for c in ti.static(range(columns)):
                                own[c] += e * table[s, c]
                            own[columns] += e * e
                for c in ti.static(range(sums)):
                    parts[c, lane] = own[c]
                wait()
                for turn in range((sums + lanes - 1) // lanes):
                    c = turn * lanes + lane
                    if c < sums:
                        total = dtype(0.0)
                        for k in range(lanes):
                            total += parts[c, k]
                        moments[c] = total
                wait()
                gain_u, gain_v = gain_at(gram, which, settings[which, 4], moments[first], moments[second])
                if iterations >= max_iterations or moving == 2:
                    moving = 0
                else:
                    for turn in range(turns):
                        n = turn * lanes + lane
                        if n < rows * (rows + 1):
                            row = n // (rows + 1)
                            column = n % (rows + 1)
                            r = row_of(row, parameters, terms)
                            total = dtype(0.0)
                            if column == rows:
                                for i in range(4):
                                    if factors[r, i] != 0:
                                        c = terms[r, i]
                                        residual = (
                                            moments[c]
                                            + gram[which, c, first] * gain_u
                                            + gram[which, c, second] * gain_v
                                        )
                                        total -= gain_factor(factors[r, i], gain_u, gain_v) * residual
                            else:
                                o = row_of(column, parameters, terms)
                                for i in range(4):
                                    for j in range(4):
                                        if factors[r, i] != 0 and factors[o, j] != 0:
                                            weight = gain_factor(factors[r, i], gain_u, gain_v)
                                            weight *= gain_factor(factors[o, j], gain_u, gain_v)
                                            total += weight * gram[which, terms[r, i], terms[o, j]]
                            if column == row:
                                beside[1 + row] = total
                            system[row, column] = total
                    wait()
                    trace = dtype(0.0)
                    for row in range(rows):
                        trace += beside[1 + row]
                    row = RAISER + rows - 1 - lane
                    if row >= 0 and row < rows:
                        raised = beside[1 + row] * (dtype(1.0) + settings[which, 5])
                        system[row, row] = raised + dtype(1.0e-7) * trace + dtype(1.0e-12)
                    wait()
                    for pivot in range(rows):
                        # the pivot's column is not read again: nobody writes what others read
                        inverse = dtype(1.0) / system[pivot, pivot]
                        for turn in range(turns):
                            n = turn * lanes + lane
                            row = n // (rows - pivot)
                            column = pivot + 1 + n % (rows - pivot)
                            if row < rows and row != pivot:
                                factor = system[row, pivot] * inverse
                                system[row, column] = system[row, column] - factor * system[pivot, column]
                        wait()
                    if lane == MOVER:
                        step = ti.Vector.zero(dtype, MOST)
                        size = dtype(0.0)
                        for p in ti.static(range(MOST)):
                            if p < parameters:
                                step[p] = system[p, rows] / system[p, p]
                                size += ti.abs(step[p])
                        step /= ti.max(size, dtype(1.0))
                        move(settings, which, step, step[6], step[7], h, pose_inout)
                        beside[step_size] = size
                    wait()
                    iterations += 1
                    if beside[step_size] < settings[which, 6]:
                        moving = 2
            if lane == 0:
                measure(
                    gram, which, gain_u, gain_v, moments[first], moments[second], moments[columns],
                    end - begin, h, result_out,
                )  # fmt: skip
                result_out[h, 4] = dtype(iterations)

    return align_blocks
