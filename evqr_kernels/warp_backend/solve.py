"""The modules of a planar code, solved for: conjugate gradients over the free modules.

A module meets only its near neighbours and all alike, so A^T A is a stencil S of (2 reach + 1)^2 numbers (see
``code``), and

    (S + damping I) q = -rhs        on the free modules; the rest of the q that is given stays as it is

is solved from the q that is given until the residual is ``tolerance`` times what it was:

    beta = |r|^2 / |r before|^2,    d = r + beta d,        p = (S + damping I) d,
    step = |r|^2 / d.p,             q = q + step d,        r = r - step p

Each window shows one of several codes, which may be smaller than the arrays are: its free modules lie within
``bounds``.  A window in which no more than ``enough`` modules are ``unclear`` is left as it is.

A solution is one launch, and a window stops when it has converged: on the CPU one thread solves a window, on
a GPU a block of threads (``solve_blocks``).
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, variant, vector
from evqr_kernels.warp_backend.solve_blocks import solve_blocks

BLOCK = 8
"""Neighbouring modules done together on the CPU."""

RESIDUAL, DIRECTION, PRODUCT, MASK, MODULES = map(wp.constant, range(5))
"""Fields that a solution works on: r, d and p of the formulas; 1 where a module is free; and q."""


@cache
def make_stencil_at(dtype: type) -> wp.Function:
    """Build the function that applies the stencil at one module; outside the grid everything is 0."""

    @wp.func
    def stencil_at(
        fields: wp.array4d(dtype=dtype), plane: int, stencil: wp.array3d(dtype=dtype), b: int, i: int, j: int
    ) -> dtype:
        reach = stencil.shape[1] // 2
        total = dtype(0.0)
        for k in range(wp.max(-reach, -i), wp.min(reach + 1, fields.shape[2] - i)):
            for m in range(wp.max(-reach, -j), wp.min(reach + 1, fields.shape[3] - j)):
                total += stencil[b, k + reach, m + reach] * fields[b, plane, i + k, j + m]
        return total

    return stencil_at


@cache
def make_solve_windows(dtype: type, side: int) -> wp.Kernel:
    """Build the whole solution with a stencil of ``side`` modules; launch: one thread per window.

    ``.._blocks``: `neighbours`.  A block that goes beyond a window's code holds modules that are not free, as
    long as it lies in the array with all that they meet; nearer to the border modules are done one by one.
    """
    vec_block = vector(BLOCK, dtype)
    stencil_at = make_stencil_at(dtype)
    reach = side // 2

    @wp.func
    def is_inside(fields: wp.array4d(dtype=dtype), i: int, j: int) -> bool:
        rows = i >= wp.static(reach) and i + wp.static(reach) < fields.shape[2]
        return rows and j >= wp.static(reach) and j + wp.static(BLOCK + reach) <= fields.shape[3]

    @wp.func
    def block_at(
        blocks: wp.array4d(dtype=vec_block),
        plane: int,
        stencil: wp.array3d(dtype=dtype),
        b: int,
        i: int,
        j: int,
    ) -> vec_block:
        total = vec_block()
        for k in range(wp.static(side)):
            for n in range(wp.static(side)):
                near = blocks[b, plane, i + wp.static(k - reach), j + wp.static(n - reach)]
                total += stencil[b, wp.static(k), wp.static(n)] * near
        return total

    @wp.kernel(module=module_of(f"solve_{side}", dtype))
    def solve_windows(
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
        fields_out: wp.array4d(dtype=dtype),
        blocks_out: wp.array4d(dtype=vec_block),
        q_inout: wp.array3d(dtype=dtype),
        iterations_out: wp.array(dtype=wp.int32),
    ):
        b = wp.tid()
        m = space_idx[b]
        left_unclear = wp.int32(0)
        for i in range(unclear.shape[1]):
            left_unclear += unclear[b, i]
        iterations_out[b] = 0
        if left_unclear <= enough[m]:
            return
        top = bounds[m, 0]
        bottom = bounds[m, 1]
        left = bounds[m, 2]
        right = bounds[m, 3]
        # what free modules meet, and what blocks beyond the last of them meet
        first = wp.max(left - wp.static(reach), 0)
        last = wp.min(right + wp.static(BLOCK + reach), rhs.shape[2])
        for i in range(wp.max(top - wp.static(reach), 0), wp.min(bottom + wp.static(reach), rhs.shape[1])):
            for j in range(first, last):
                is_free = dtype(0.0)
                if i >= top and i < bottom and j >= left and j < right and free[m, i, j] != 0:
                    is_free = dtype(1.0)
                fields_out[b, RESIDUAL, i, j] = -rhs[b, i, j]
                fields_out[b, DIRECTION, i, j] = dtype(0.0)
                fields_out[b, MASK, i, j] = is_free
                fields_out[b, MODULES, i, j] = q_inout[b, i, j]
        norm = dtype(0.0)
        norms = vec_block()
        for i in range(top, bottom):
            j = left
            while j < right:
                if is_inside(fields_out, i, j):
                    seen = blocks_out[b, RESIDUAL, i, j] - block_at(blocks_out, MODULES, stencil, b, i, j)
                    r_block = wp.cw_mul(
                        blocks_out[b, MASK, i, j], seen - damping[b] * blocks_out[b, MODULES, i, j]
                    )
                    blocks_out[b, RESIDUAL, i, j] = r_block
                    norms += wp.cw_mul(r_block, r_block)
                    j += BLOCK
                else:
                    r = fields_out[b, RESIDUAL, i, j] - stencil_at(fields_out, MODULES, stencil, b, i, j)
                    r = fields_out[b, MASK, i, j] * (r - damping[b] * fields_out[b, MODULES, i, j])
                    fields_out[b, RESIDUAL, i, j] = r
                    norm += r * r
                    j += 1
        for c in range(wp.static(BLOCK)):
            norm += norms[c]
        least = tolerance * tolerance * norm
        before = norm
        iterations = wp.int32(0)
        while iterations < max_iterations and norm > least:
            beta = norm / before
            for i in range(top, bottom):
                j = left
                while j < right:
                    if is_inside(fields_out, i, j):
                        blocks_out[b, DIRECTION, i, j] = (
                            blocks_out[b, RESIDUAL, i, j] + beta * blocks_out[b, DIRECTION, i, j]
                        )
                        j += BLOCK
                    else:
                        fields_out[b, DIRECTION, i, j] = (
                            fields_out[b, RESIDUAL, i, j] + beta * fields_out[b, DIRECTION, i, j]
                        )
                        j += 1
            curvature = dtype(0.0)
            curvatures = vec_block()
            for i in range(top, bottom):
                j = left
                while j < right:
                    if is_inside(fields_out, i, j):
                        d_block = blocks_out[b, DIRECTION, i, j]
                        p_block = block_at(blocks_out, DIRECTION, stencil, b, i, j) + damping[b] * d_block
                        p_block = wp.cw_mul(blocks_out[b, MASK, i, j], p_block)
                        blocks_out[b, PRODUCT, i, j] = p_block
                        curvatures += wp.cw_mul(p_block, d_block)
                        j += BLOCK
                    else:
                        d = fields_out[b, DIRECTION, i, j]
                        p = stencil_at(fields_out, DIRECTION, stencil, b, i, j) + damping[b] * d
                        p *= fields_out[b, MASK, i, j]
                        fields_out[b, PRODUCT, i, j] = p
                        curvature += p * d
                        j += 1
            for c in range(wp.static(BLOCK)):
                curvature += curvatures[c]
            step = norm / curvature
            before = norm
            norm = dtype(0.0)
            norms = vec_block()
            for i in range(top, bottom):
                j = left
                while j < right:
                    if is_inside(fields_out, i, j):
                        blocks_out[b, MODULES, i, j] = (
                            blocks_out[b, MODULES, i, j] + step * blocks_out[b, DIRECTION, i, j]
                        )
                        r_block = blocks_out[b, RESIDUAL, i, j] - step * blocks_out[b, PRODUCT, i, j]
                        blocks_out[b, RESIDUAL, i, j] = r_block
                        norms += wp.cw_mul(r_block, r_block)
                        j += BLOCK
                    else:
                        fields_out[b, MODULES, i, j] = (
                            fields_out[b, MODULES, i, j] + step * fields_out[b, DIRECTION, i, j]
                        )
                        r = fields_out[b, RESIDUAL, i, j] - step * fields_out[b, PRODUCT, i, j]
                        fields_out[b, RESIDUAL, i, j] = r
                        norm += r * r
                        j += 1
            for c in range(wp.static(BLOCK)):
                norm += norms[c]
            iterations += 1
        for i in range(top, bottom):
            for j in range(left, right):
                q_inout[b, i, j] = fields_out[b, MODULES, i, j]
        iterations_out[b] = iterations

    return solve_windows


def solve_windows(
    rhs, stencil, damping, space_idx, free, bounds, unclear, enough, scratch, q_inout, iterations_out,
    max_iterations, tolerance,
) -> None:  # fmt: skip
    """Launch the CPU's variant; q is updated in place, the rest overwritten."""
    fields, _ = scratch
    about = space_idx, free, bounds, unclear, enough
    launch(
        make_solve_windows(rhs.dtype, stencil.shape[1]),
        rhs.shape[0],
        inputs=[rhs, stencil, damping, *about, max_iterations, tolerance],
        outputs=[fields, neighbours(fields, BLOCK), q_inout, iterations_out],
        device=rhs.device,
    )


def solve_code(
    rhs, stencil, damping, space_idx, free, bounds, unclear, enough, max_iterations: int, tolerance: float,
    fields_out, direction_out, q_inout, iterations_out,
) -> None:  # fmt: skip
    """Launch a thread a window, or a block, as the table has it for the device."""
    launch_variant = solve_blocks if variant("solve_code", rhs.device).lanes > 1 else solve_windows
    scratch = fields_out, direction_out
    launch_variant(
        rhs, stencil, damping, space_idx, free, bounds, unclear, enough, scratch, q_inout, iterations_out,
        max_iterations, tolerance,
    )  # fmt: skip
