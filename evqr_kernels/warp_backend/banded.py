"""Stage two's solution in one go: the Cholesky factor of a banded matrix.

The same system as in ``solve``,

    (S + damping I) q = -rhs        on the free modules; the rest of the q that is given stays as it is

with modules in row-major order has all its entries within ``width = reach M + reach`` of the diagonal, and
so has its factor L, of which row i is kept as ``band(i, width + j - i) = L(i, j)``, rows of fixed modules as
those of the unit matrix:

    L(i, j) = (A(i, j) - sum_k L(i, k) L(j, k)) / L(j, j),      L(i, i) = sqrt(A(i, i) - sum_k L(i, k)^2)
    L y = -rhs - (S q of the fixed modules),                    L^T q = y

It costs M^2 width^2 / 2 multiply-adds whatever the condition of S is.  A first pass fills the band with A and
q with the right side; then one thread owns one window: on a GPU that pays for batches of hundreds.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, launch_bounds, module_of, neighbours, vector

CPU_BLOCK, GPU_BLOCK = 16, 4
"""Neighbouring entries of a row multiplied together: vector units want many, registers few."""


def block_of(device: wp.Device) -> int:
    """Choose the block for a device."""
    return CPU_BLOCK if device.is_cpu else GPU_BLOCK


@cache
def make_fill_band(dtype: type) -> wp.Kernel:
    """Build the system: the matrix's rows up to the diagonal, and the right side; launch: one thread per row.

    Modules are numbered as one row here, and below.
    """

    @wp.kernel(module=module_of("banded", dtype))
    def fill_band(
        rhs: wp.array2d(dtype=dtype),
        stencil: wp.array3d(dtype=dtype),
        damping: wp.array(dtype=dtype),
        side: int,
        free: wp.array(dtype=wp.int32),
        band_out: wp.array3d(dtype=dtype),
        q_inout: wp.array2d(dtype=dtype),
    ):
        b, i = wp.tid()
        reach = stencil.shape[1] // 2
        width = band_out.shape[2] - 1
        for k in range(width):
            band_out[b, i, k] = dtype(0.0)
        band_out[b, i, width] = dtype(1.0)
        if free[i] != 0:
            band_out[b, i, width] = stencil[b, reach, reach] + damping[b]
            value = -rhs[b, i]
            row = i // side
            column = i - row * side
            for r in range(wp.max(0, row - reach), wp.min(side, row + reach + 1)):
                for c in range(wp.max(0, column - reach), wp.min(side, column + reach + 1)):
                    j = r * side + c
                    entry = stencil[b, r - row + reach, c - column + reach]
                    if free[j] == 0:
                        value -= entry * q_inout[b, j]
                    elif j < i:
                        band_out[b, i, width + j - i] = entry
            q_inout[b, i] = value

    return fill_band


@cache
def make_row_product(dtype: type, block: int) -> wp.Function:
    """Build the scalar product of ``count`` entries of two rows of the band.

    ``blocks``: `neighbours` of the band.
    """
    vec_block = vector(block, dtype)

    @wp.func
    def row_product(
        band: wp.array3d(dtype=dtype),
        blocks: wp.array3d(dtype=vec_block),
        b: int,
        i: int,
        first_i: int,
        j: int,
        first_j: int,
        count: int,
    ) -> dtype:
        whole = count - count % block
        by_block = vec_block()
        for k in range(0, whole, block):
            by_block += wp.cw_mul(blocks[b, i, first_i + k], blocks[b, j, first_j + k])
        total = dtype(0.0)
        for c in range(wp.static(block)):
            total += by_block[c]
        for k in range(whole, count):
            total += band[b, i, first_i + k] * band[b, j, first_j + k]
        return total

    return row_product


@cache
def make_solve_banded(dtype: type, block: int) -> wp.Kernel:
    """Build the solution; launch: one thread per window.  ``blocks``: `neighbours` of the band."""
    vec_block = vector(block, dtype)
    row_product = make_row_product(dtype, block)

    @wp.kernel(module=module_of(f"banded_{block}", dtype), launch_bounds=launch_bounds(dtype))
    def solve_banded(
        free: wp.array(dtype=wp.int32),
        blocks: wp.array3d(dtype=vec_block),
        band_inout: wp.array3d(dtype=dtype),
        q_inout: wp.array2d(dtype=dtype),
    ):
        b = wp.tid()
        modules = free.shape[0]
        width = band_inout.shape[2] - 1
        for i in range(modules):
            if free[i] != 0:
                begin = wp.max(0, i - width)
                value = q_inout[b, i]
                # each entry needs those left of it; the last is the diagonal
                for j in range(begin, i + 1):
                    if free[j] != 0:  # rows of fixed modules stay as they are
                        first = wp.max(begin, j - width)
                        entry = band_inout[b, i, width + j - i] - row_product(
                            band_inout, blocks, b, i, width + first - i, j, width + first - j, j - first
                        )
                        if j < i:
                            entry /= band_inout[b, j, width]
                            value -= entry * q_inout[b, j]
                        else:
                            entry = wp.sqrt(entry)
                            q_inout[b, i] = value / entry
                        band_inout[b, i, width + j - i] = entry
        for back in range(modules):
            i = modules - 1 - back
            if free[i] != 0:
                value = q_inout[b, i] / band_inout[b, i, width]
                q_inout[b, i] = value
                for j in range(wp.max(0, i - width), i):
                    if free[j] != 0:
                        q_inout[b, j] = q_inout[b, j] - band_inout[b, i, width + j - i] * value

    return solve_banded


def solve_code_banded(rhs, stencil, damping, free, band_out, q_inout) -> None:
    """Launch both passes; q is updated in place, the band is scratch."""
    block = block_of(rhs.device)
    side, flat = free.shape[0], (rhs.shape[0], free.size)
    free, q = free.flatten(), q_inout.reshape(flat)
    launch(
        make_fill_band(rhs.dtype),
        flat,
        inputs=[rhs.reshape(flat), stencil, damping, side, free],
        outputs=[band_out, q],
        device=rhs.device,
    )
    launch(
        make_solve_banded(rhs.dtype, block),
        rhs.shape[0],
        inputs=[free, neighbours(band_out, block)],
        outputs=[band_out, q],
        device=rhs.device,
    )
