"""Stage two's solution by the Cholesky factor of a banded matrix; see ``warp_backend/banded.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, is_alone, ti
from evqr_kernels.taichi_backend.launches import launch


@cache
def make_row_product(dtype):
    """Build the scalar product of ``count`` entries of two rows of the band."""

    @ti.func
    def row_product(band: ti.template(), b, i, first_i, j, first_j, count):
        total = dtype(0.0)
        for k in range(count):
            total += band[b, i, first_i + k] * band[b, j, first_j + k]
        return total

    return row_product


@cache
def make_solve_banded(dtype, alone: bool):
    """Build the solution; one thread per window."""
    row_product = make_row_product(dtype)

    @ti.kernel
    def solve_banded(
        rhs: array(dtype, 3),
        stencil: array(dtype, 3),
        damping: array(dtype, 1),
        free: array(ti.i32, 2),
        band_out: array(dtype, 3),
        q_inout: array(dtype, 3),
    ):
        ti.loop_config(serialize=alone)
        for b in range(rhs.shape[0]):
            side = free.shape[0]
            reach = stencil.shape[1] // 2
            width = band_out.shape[2] - 1
            for i in range(side * side):
                row = i // side
                column = i - row * side
                begin = ti.max(0, i - width)
                for j in range(begin, i):
                    band_out[b, i, width + j - i] = dtype(0.0)
                band_out[b, i, width] = dtype(1.0)
                if free[row, column] != 0:
                    # the matrix's row up to the diagonal, and what fixed modules leave on the other side
                    value = -rhs[b, row, column]
                    for k in range(ti.max(-reach, -row), ti.min(reach + 1, side - row)):
                        for m in range(ti.max(-reach, -column), ti.min(reach + 1, side - column)):
                            r = row + k
                            c = column + m
                            entry = stencil[b, k + reach, m + reach]
                            if free[r, c] == 0:
                                value -= entry * q_inout[b, r, c]
                            elif r * side + c < i:
                                band_out[b, i, width + r * side + c - i] = entry
                    for j in range(begin, i):
                        r = j // side
                        c = j - r * side
                        # rows of fixed modules stay as they are
                        if free[r, c] != 0:
                            first = ti.max(begin, j - width)
                            entry = band_out[b, i, width + j - i]
                            entry -= row_product(
                                band_out, b, i, width + first - i, j, width + first - j, j - first
                            )
                            entry /= band_out[b, j, width]
                            band_out[b, i, width + j - i] = entry
                            value -= entry * q_inout[b, r, c]
                    squares = row_product(band_out, b, i, width + begin - i, i, width + begin - i, i - begin)
                    diagonal = ti.sqrt(stencil[b, reach, reach] + damping[b] - squares)
                    band_out[b, i, width] = diagonal
                    q_inout[b, row, column] = value / diagonal
            for back in range(side * side):
                i = side * side - 1 - back
                row = i // side
                column = i - row * side
                if free[row, column] != 0:
                    value = q_inout[b, row, column] / band_out[b, i, width]
                    q_inout[b, row, column] = value
                    for j in range(ti.max(0, i - width), i):
                        r = j // side
                        c = j - r * side
                        if free[r, c] != 0:
                            q_inout[b, r, c] = q_inout[b, r, c] - band_out[b, i, width + j - i] * value

    return solve_banded


def solve_code_banded(rhs, stencil, damping, free, band_out, q_inout) -> None:
    """Launch; q is updated in place, the band is scratch."""
    kernel = make_solve_banded(float_of(rhs), is_alone(rhs))
    launch(kernel, rhs, stencil, damping, free, band_out, q_inout)
