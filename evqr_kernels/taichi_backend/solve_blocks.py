"""Conjugate gradients with a block of threads a window, in one launch; see ``warp_backend/solve_blocks.py``.

The direction lies in memory that the block shares, which codes of more modules do not fit into.
"""

from functools import cache

from evqr_kernels.taichi_backend.block import MOST_BYTES, make_block_sum, wait
from evqr_kernels.taichi_backend.language import array, float_of, is_on_cpu, ti, variant
from evqr_kernels.taichi_backend.launches import launch

RESIDUAL, PRODUCT = range(2)
"""Fields that a solution works on."""

CURVATURE, NORM = range(2)
"""Slots of its sums."""

ROOMS = (4_096, MOST_BYTES)
"""Bytes of shared memory."""


def room_for(rhs, stencil) -> int:
    """Choose for how many numbers a block has room in shared memory; 0 where a code does not fit."""
    numbers = (rhs.shape[1] + stencil.shape[1] - 1) * (rhs.shape[2] + stencil.shape[2] - 1)
    size = 8 if float_of(rhs) == ti.f64 else 4
    return next((room // size for room in ROOMS if numbers * size <= room), 0)


@ti.func
def unclear_of(unclear: ti.template(), b):
    """Add up the unclear modules of a window."""
    total = 0
    for i in range(unclear.shape[1]):
        total += unclear[b, i]
    return total


@cache
def make_solve_blocks(dtype, room: int, lanes: int):
    """Build the whole solution with ``room`` for the direction; ``lanes`` threads per window."""
    block_sum = make_block_sum(dtype, lanes)

    @ti.func
    def product_at(stencil: ti.template(), direction: ti.template(), b, at, around):
        total = dtype(0.0)
        for k in range(stencil.shape[1]):
            for n in range(stencil.shape[2]):
                total += stencil[b, k, n] * direction[at + k * around + n]
        return total

    @ti.kernel
    def solve_blocks(
        rhs: array(dtype, 3),
        stencil: array(dtype, 3),
        damping: array(dtype, 1),
        space_idx: array(ti.i32, 1),
        free: array(ti.i32, 3),
        bounds: array(ti.i32, 2),
        unclear: array(ti.i32, 2),
        enough: array(ti.i32, 1),
        max_iterations: ti.i32,
        tolerance: dtype,
        fields_out: array(dtype, 4),
        q_inout: array(dtype, 3),
        iterations_out: array(ti.i32, 1),
    ):
        ti.loop_config(block_dim=lanes)
        for index in range(rhs.shape[0] * lanes):
            direction = ti.simt.block.SharedArray((room,), dtype)
            parts = ti.simt.block.SharedArray((2, lanes), dtype)
            b = index // lanes
            lane = index % lanes
            m = space_idx[b]
            iterations = 0
            if unclear_of(unclear, b) > enough[m]:
                top = bounds[m, 0]
                left = bounds[m, 2]
                wide = bounds[m, 3] - left
                modules = (bounds[m, 1] - top) * wide
                reach = stencil.shape[1] // 2
                # what the free modules meet, q at first
                around = wide + 2 * reach
                meet = (bounds[m, 1] - top + 2 * reach) * around
                own = reach * around + reach
                for step in range((meet + lanes - 1) // lanes):
                    n = step * lanes + lane
                    if n < meet:
                        row = top + n // around - reach
                        column = left + n % around - reach
                        value = dtype(0.0)
                        if row >= 0 and column >= 0 and row < rhs.shape[1] and column < rhs.shape[2]:
                            value = q_inout[b, row, column]
                        direction[n] = value
                wait()
                turns = (modules + lanes - 1) // lanes
                norm = dtype(0.0)
                for turn in range(turns):
                    n = turn * lanes + lane
                    if n < modules:
                        i = n // wide
                        j = n % wide
                        r = dtype(0.0)
                        if free[m, top + i, left + j] != 0:
                            at = i * around + j
                            r = -rhs[b, top + i, left + j] - product_at(stencil, direction, b, at, around)
                            r -= damping[b] * direction[at + own]
                        fields_out[b, RESIDUAL, 0, n] = r
                        norm += r * r
                norm = block_sum(norm, parts, NORM, lane)
                for step in range((meet + lanes - 1) // lanes):
                    n = step * lanes + lane
                    if n < meet:
                        direction[n] = dtype(0.0)
                wait()
                least = tolerance * tolerance * norm
                before = norm
                while iterations < max_iterations and norm > least:
                    beta = norm / before
                    for turn in range(turns):
                        n = turn * lanes + lane
                        if n < modules:
                            at = (n // wide) * around + n % wide + own
                            direction[at] = fields_out[b, RESIDUAL, 0, n] + beta * direction[at]
                    wait()
                    curvature = dtype(0.0)
                    for turn in range(turns):
                        n = turn * lanes + lane
                        if n < modules:
                            at = (n // wide) * around + n % wide
                            p = dtype(0.0)
                            if free[m, top + n // wide, left + n % wide] != 0:
                                d = direction[at + own]
                                p = product_at(stencil, direction, b, at, around) + damping[b] * d
                                curvature += p * d
                            fields_out[b, PRODUCT, 0, n] = p
                    curvature = block_sum(curvature, parts, CURVATURE, lane)
                    step = norm / curvature
                    before = norm
                    norm = dtype(0.0)
                    for turn in range(turns):
                        n = turn * lanes + lane
                        if n < modules:
                            i = n // wide
                            j = n % wide
                            q = q_inout[b, top + i, left + j]
                            q_inout[b, top + i, left + j] = q + step * direction[i * around + j + own]
                            r = fields_out[b, RESIDUAL, 0, n] - step * fields_out[b, PRODUCT, 0, n]
                            fields_out[b, RESIDUAL, 0, n] = r
                            norm += r * r
                    norm = block_sum(norm, parts, NORM, lane)
                    iterations += 1
            if lane == 0:
                iterations_out[b] = iterations

    return solve_blocks


def solve_blocks(
    rhs, stencil, damping, space_idx, free, bounds, unclear, enough, scratch, q_inout, iterations_out,
    max_iterations, tolerance,
) -> None:  # fmt: skip
    """Launch the GPU's variant; q is updated in place, the rest overwritten."""
    fields, _ = scratch
    lanes = variant("solve_code", is_on_cpu(rhs)).lanes
    launch(
        make_solve_blocks(float_of(rhs), room_for(rhs, stencil), lanes),
        *(rhs, stencil, damping, space_idx, free, bounds, unclear, enough, max_iterations, tolerance),
        *(fields, q_inout, iterations_out),
    )
