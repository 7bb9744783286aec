"""Conjugate gradients with a block of a GPU's threads a window, in one launch; the method is in ``solve``.

A thread owns every so many-th module within the bounds, and keeps to itself what nobody else reads, r and p.
Neighbours read the direction d: it lies in shared memory as long as it fits, otherwise in the scratch, with a
border of zeros as wide as the stencil reaches.  An iteration waits three times: for d, and for two sums.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.block import MOST_BYTES, lanes_on, make_block_sum, make_held, wait
from evqr_kernels.warp_backend.language import launch, launch_bounds, module_of, variant

RESIDUAL, PRODUCT = map(wp.constant, range(2))
"""Fields that a solution works on: r and p of the formulas."""

CURVATURE, NORM = map(wp.constant, range(2))
"""Slots of its sums."""

ROOMS = (4_096, 16_384, MOST_BYTES)
"""Bytes of shared memory: less of it lets a multiprocessor take more windows at once."""


def room_for(numbers: int, dtype: type) -> int:
    """Choose how many bytes of shared memory so many numbers take; 0 where they do not fit."""
    size = wp.types.type_size_in_bytes(dtype)
    return next((room for room in ROOMS if numbers * size <= room), 0)


@cache
def make_solve_blocks(dtype: type, room: int, lanes: int) -> wp.Kernel:
    """Build the whole solution with so many bytes for the direction; launch: ``lanes`` threads per window."""
    block_sum = make_block_sum(dtype, 2)
    held = make_held(dtype, room // wp.types.type_size_in_bytes(dtype))

    @wp.func
    def product_at(stencil: wp.array3d(dtype=dtype), field: wp.array2d(dtype=dtype), b: int, i: int, j: int):
        # one loop, not two: a GPU's compiler unrolls each four times, which takes twice the registers
        side = stencil.shape[1]
        total = dtype(0.0)
        for n in range(side * side):
            k = n // side
            total += stencil[b, k, n - k * side] * field[i + k, j + n - k * side]
        return total

    @wp.kernel(module=module_of(f"solve_blocks_{room}", dtype, lanes), launch_bounds=launch_bounds(dtype))
    def solve_blocks(
        rhs: wp.array3d(dtype=dtype),
        stencil: wp.array3d(dtype=dtype),
        damping: wp.array(dtype=dtype),
        space_idx: wp.array(dtype=wp.int32),
        free: wp.array3d(dtype=wp.int32),
        bounds: wp.array2d(dtype=wp.int32),
        unclear: wp.array2d(dtype=wp.int32),
        enough: wp.array(dtype=wp.int32),
        max_iterations: int,
        tolerance: dtype,
        direction_out: wp.array3d(dtype=dtype),
        fields_out: wp.array3d(dtype=dtype),
        q_inout: wp.array3d(dtype=dtype),
        iterations_out: wp.array(dtype=wp.int32),
    ):
        b, lane = wp.tid()
        threads = wp.block_dim()
        m = space_idx[b]
        left_unclear = wp.int32(0)
        for k in range(unclear.shape[1]):
            left_unclear += unclear[b, k]
        if lane == 0:
            iterations_out[b] = 0
        if left_unclear <= enough[m]:
            return
        top = bounds[m, 0]
        left = bounds[m, 2]
        wide = bounds[m, 3] - left
        modules = (bounds[m, 1] - top) * wide
        reach = stencil.shape[1] // 2
        # what the free modules meet, q at first
        around = wide + 2 * reach
        meet = (bounds[m, 1] - top + 2 * reach) * around
        direction = direction_out[b]
        if wp.static(room > 0):
            direction = wp.array(ptr=held(), shape=(bounds[m, 1] - top + 2 * reach, around), dtype=dtype)
        for n in range(lane, meet, threads):
            i = n // around
            j = n - i * around
            row = top + i - reach
            column = left + j - reach
            value = dtype(0.0)
            if row >= 0 and column >= 0 and row < rhs.shape[1] and column < rhs.shape[2]:
                value = q_inout[b, row, column]
            direction[i, j] = value
        wait()
        norm = dtype(0.0)
        for n in range(lane, modules, threads):
            i = n // wide
            j = n - i * wide
            r = dtype(0.0)
            if free[m, top + i, left + j] != 0:
                r = -rhs[b, top + i, left + j] - product_at(stencil, direction, b, i, j)
                r -= damping[b] * direction[i + reach, j + reach]
            fields_out[b, RESIDUAL, n] = r
            norm += r * r
        norm = block_sum(norm, NORM)
        for n in range(lane, meet, threads):
            direction[n // around, n % around] = dtype(0.0)
        wait()
        least = tolerance * tolerance * norm
        before = norm
        iterations = wp.int32(0)
        while iterations < max_iterations and norm > least:
            beta = norm / before
            for n in range(lane, modules, threads):
                i = n // wide + reach
                j = n % wide + reach
                direction[i, j] = fields_out[b, RESIDUAL, n] + beta * direction[i, j]
            wait()
            curvature = dtype(0.0)
            for n in range(lane, modules, threads):
                i = n // wide
                j = n - i * wide
                p = dtype(0.0)
                if free[m, top + i, left + j] != 0:
                    d = direction[i + reach, j + reach]
                    p = product_at(stencil, direction, b, i, j) + damping[b] * d
                    curvature += p * d
                fields_out[b, PRODUCT, n] = p
            curvature = block_sum(curvature, CURVATURE)
            step = norm / curvature
            before = norm
            norm = dtype(0.0)
            for n in range(lane, modules, threads):
                i = n // wide
                j = n - i * wide
                q_inout[b, top + i, left + j] = (
                    q_inout[b, top + i, left + j] + step * direction[i + reach, j + reach]
                )
                r = fields_out[b, RESIDUAL, n] - step * fields_out[b, PRODUCT, n]
                fields_out[b, RESIDUAL, n] = r
                norm += r * r
            norm = block_sum(norm, NORM)
            iterations += 1
        if lane == 0:
            iterations_out[b] = iterations

    return solve_blocks


def solve_blocks(
    rhs, stencil, damping, space_idx, free, bounds, unclear, enough, scratch, q_inout, iterations_out,
    max_iterations, tolerance,
) -> None:  # fmt: skip
    """Launch the GPU's variant; q is updated in place, the rest overwritten."""
    fields, direction = scratch
    batch, rows, columns = rhs.shape
    room = room_for((rows + stencil.shape[1] - 1) * (columns + stencil.shape[1] - 1), rhs.dtype)
    lanes = variant("solve_code", rhs.device).lanes
    launch(
        make_solve_blocks(rhs.dtype, room, lanes),
        (batch, lanes_on(rhs.device, lanes)),
        inputs=[rhs, stencil, damping, space_idx, free, bounds, unclear, enough, max_iterations, tolerance],
        outputs=[
            direction,
            fields.reshape((batch, fields.shape[1], rows * columns)),
            q_inout,
            iterations_out,
        ],
        device=rhs.device,
    )
