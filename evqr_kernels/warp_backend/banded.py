"""Stage two's solution in one go: the Cholesky factor of a banded matrix.

The same system as in ``solve``,

    (S + damping I) q = -rhs        on the free modules; the rest of the q that is given stays as it is

with modules in row-major order has all its entries within ``width = reach M + reach`` of the diagonal, and
so has its factor L, of which row i is kept as ``band(i, width + j - i) = L(i, j)``, rows of fixed modules as
those of the unit matrix:

    L(i, j) = (A(i, j) - sum_k L(i, k) L(j, k)) / L(j, j),      L(i, i) = sqrt(A(i, i) - sum_k L(i, k)^2)
    L y = -rhs - (S q of the fixed modules),                    L^T q = y

It costs M^2 width^2 / 2 multiply-adds whatever the condition of S is.  One thread owns one window: on a GPU
that pays for batches of hundreds.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, vector

BLOCK = 8
"""Neighbouring entries of a row multiplied together."""


@cache
def make_row_product(dtype: type) -> wp.Function:
    """Build the scalar product of ``count`` entries of two rows of the band.

    ``blocks``: `neighbours` of the band.
    """
    vec_block = vector(BLOCK, dtype)

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
        whole = count - count % BLOCK
        by_block = vec_block()
        for k in range(0, whole, BLOCK):
            by_block += wp.cw_mul(blocks[b, i, first_i + k], blocks[b, j, first_j + k])
        total = dtype(0.0)
        for c in range(wp.static(BLOCK)):
            total += by_block[c]
        for k in range(whole, count):
            total += band[b, i, first_i + k] * band[b, j, first_j + k]
        return total

    return row_product


@cache
def make_solve_banded(dtype: type) -> wp.Kernel:
    """Build the solution; launch: one thread per window."""
    vec_block = vector(BLOCK, dtype)
    row_product = make_row_product(dtype)

    @wp.kernel(module=module_of("banded", dtype))
    def solve_banded(
        rhs: wp.array3d(dtype=dtype),
        stencil: wp.array3d(dtype=dtype),
        damping: wp.array(dtype=dtype),
        free: wp.array2d(dtype=wp.int32),
        band_out: wp.array3d(dtype=dtype),
        blocks_out: wp.array3d(dtype=vec_block),
        q_inout: wp.array3d(dtype=dtype),
    ):
        b = wp.tid()
        side = free.shape[0]
        reach = stencil.shape[1] // 2
        width = band_out.shape[2] - 1
        for i in range(side * side):
            row = i // side
            column = i - row * side
            begin = wp.max(0, i - width)
            for j in range(begin, i):
                band_out[b, i, width + j - i] = dtype(0.0)
            band_out[b, i, width] = dtype(1.0)
            if free[row, column] != 0:
                # the matrix's row up to the diagonal, and what fixed modules leave on the other side
                value = -rhs[b, row, column]
                for n in range(stencil.shape[1] * stencil.shape[2]):
                    k = n // stencil.shape[2] - reach
                    m = n - (k + reach) * stencil.shape[2] - reach
                    r = row + k
                    c = column + m
                    if r >= 0 and r < side and c >= 0 and c < side:
                        entry = stencil[b, k + reach, m + reach]
                        if free[r, c] == 0:
                            value -= entry * q_inout[b, r, c]
                        elif r * side + c < i:
                            band_out[b, i, width + r * side + c - i] = entry
                for j in range(begin, i):
                    # rows of fixed modules stay as they are
                    if free[j // side, j - (j // side) * side] != 0:
                        first = wp.max(begin, j - width)
                        product = row_product(
                            band_out, blocks_out, b, i, width + first - i, j, width + first - j, j - first
                        )
                        entry = band_out[b, i, width + j - i] - product
                        entry /= band_out[b, j, width]
                        band_out[b, i, width + j - i] = entry
                        value -= entry * q_inout[b, j // side, j - (j // side) * side]
                squares = row_product(
                    band_out, blocks_out, b, i, width + begin - i, i, width + begin - i, i - begin
                )
                diagonal = wp.sqrt(stencil[b, reach, reach] + damping[b] - squares)
                band_out[b, i, width] = diagonal
                q_inout[b, row, column] = value / diagonal
        for back in range(side * side):
            i = side * side - 1 - back
            row = i // side
            column = i - row * side
            if free[row, column] != 0:
                value = q_inout[b, row, column] / band_out[b, i, width]
                q_inout[b, row, column] = value
                for j in range(wp.max(0, i - width), i):
                    r = j // side
                    c = j - r * side
                    if free[r, c] != 0:
                        q_inout[b, r, c] = q_inout[b, r, c] - band_out[b, i, width + j - i] * value

    return solve_banded


def solve_code_banded(rhs, stencil, damping, free, band_out, q_inout) -> None:
    """Launch; q is updated in place, the band is scratch."""
    launch(
        make_solve_banded(rhs.dtype),
        rhs.shape[0],
        inputs=[rhs, stencil, damping, free],
        outputs=[band_out, neighbours(band_out, BLOCK), q_inout],
        device=rhs.device,
    )
