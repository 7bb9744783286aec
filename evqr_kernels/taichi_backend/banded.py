"""The modules of a planar code by the Cholesky factor of a banded matrix; see ``warp_backend/banded.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, indices_of_window, is_alone, is_on_cpu, ti
from evqr_kernels.taichi_backend.launches import launch

MOST_ROUNDS = 1 << 15
"""Rounds of all its loops that a GPU's thread makes in one launch.

Systems end what takes longer than a second or so; Mesa's Vulkan on a CPU ends loops after 65535 rounds.
"""


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
def make_places(upright: bool):
    """Build the functions from a module's number to its row and column, and back."""

    @ti.func
    def place_of(free: ti.template(), i):
        side = ti.min(free.shape[0], free.shape[1])
        line = i // side
        place = i - line * side
        return (line, place) if ti.static(upright) else (place, line)

    @ti.func
    def number_of(free: ti.template(), row, column):
        side = ti.min(free.shape[0], free.shape[1])
        return row * side + column if ti.static(upright) else column * side + row

    return place_of, number_of


@cache
def make_factor_rows(dtype, alone: bool, upright: bool):
    """Build the factorisation of some rows, and their forward substitution; one thread per window."""
    indices = indices_of_window(alone)
    row_product = make_row_product(dtype)
    place_of, number_of = make_places(upright)

    @ti.kernel
    def factor_rows(
        rhs: array(dtype, 3),
        stencil: array(dtype, 3),
        damping: array(dtype, 1),
        free: array(ti.i32, 2),
        first_row: ti.i32,
        end_row: ti.i32,
        band_inout: array(dtype, 3),
        q_inout: array(dtype, 3),
    ):
        ti.loop_config(serialize=alone)
        for b, idle in ti.ndrange(rhs.shape[0], indices):
            if idle > 0:
                continue
            reach = stencil.shape[1] // 2
            width = band_inout.shape[2] - 1
            for i in range(first_row, end_row):
                row, column = place_of(free, i)
                begin = ti.max(0, i - width)
                for j in range(begin, i):
                    band_inout[b, i, width + j - i] = dtype(0.0)
                band_inout[b, i, width] = dtype(1.0)
                if free[row, column] != 0:
                    # the matrix's row up to the diagonal, and what fixed modules leave on the other side
                    value = -rhs[b, row, column]
                    for k in range(ti.max(-reach, -row), ti.min(reach + 1, free.shape[0] - row)):
                        for m in range(ti.max(-reach, -column), ti.min(reach + 1, free.shape[1] - column)):
                            r = row + k
                            c = column + m
                            j = number_of(free, r, c)
                            entry = stencil[b, k + reach, m + reach]
                            if free[r, c] == 0:
                                value -= entry * q_inout[b, r, c]
                            elif j < i:
                                band_inout[b, i, width + j - i] = entry
                    for j in range(begin, i):
                        r, c = place_of(free, j)
                        # rows of fixed modules stay as they are
                        if free[r, c] != 0:
                            first = ti.max(begin, j - width)
                            entry = band_inout[b, i, width + j - i]
                            entry -= row_product(
                                band_inout, b, i, width + first - i, j, width + first - j, j - first
                            )
                            entry /= band_inout[b, j, width]
                            band_inout[b, i, width + j - i] = entry
                            value -= entry * q_inout[b, r, c]
                    squares = row_product(
                        band_inout, b, i, width + begin - i, i, width + begin - i, i - begin
                    )
                    diagonal = ti.sqrt(stencil[b, reach, reach] + damping[b] - squares)
                    band_inout[b, i, width] = diagonal
                    q_inout[b, row, column] = value / diagonal

    return factor_rows


@cache
def make_substitute_rows(dtype, alone: bool, upright: bool):
    """Build the backward substitution of some rows; one thread per window."""
    indices = indices_of_window(alone)
    place_of, _ = make_places(upright)

    @ti.kernel
    def substitute_rows(
        band: array(dtype, 3),
        free: array(ti.i32, 2),
        first_row: ti.i32,
        end_row: ti.i32,
        q_inout: array(dtype, 3),
    ):
        ti.loop_config(serialize=alone)
        for b, idle in ti.ndrange(q_inout.shape[0], indices):
            if idle > 0:
                continue
            width = band.shape[2] - 1
            for back in range(end_row - first_row):
                i = end_row - 1 - back
                row, column = place_of(free, i)
                if free[row, column] != 0:
                    value = q_inout[b, row, column] / band[b, i, width]
                    q_inout[b, row, column] = value
                    for j in range(ti.max(0, i - width), i):
                        r, c = place_of(free, j)
                        if free[r, c] != 0:
                            q_inout[b, r, c] = q_inout[b, r, c] - band[b, i, width + j - i] * value

    return substitute_rows


def rows_a_launch(band) -> int:
    """Choose how many rows a launch does: on the CPU all, elsewhere what a thread may do in one go."""
    _, rows, width = band.shape
    return rows if is_on_cpu(band) else max(1, MOST_ROUNDS // (width * width))


def solve_code_banded(rhs, stencil, damping, free, band_out, q_inout) -> None:
    """Launch; q is updated in place, the band is scratch."""
    if 0 in free.shape:
        return
    variant = float_of(rhs), is_alone(rhs), free.shape[0] >= free.shape[1]
    factor, substitute = make_factor_rows(*variant), make_substitute_rows(*variant)
    rows, step = band_out.shape[1], rows_a_launch(band_out)
    blocks = [(first, min(first + step, rows)) for first in range(0, rows, step)]
    for block in blocks:
        launch(factor, rhs, stencil, damping, free, *block, band_out, q_inout)
    for block in reversed(blocks):
        launch(substitute, band_out, free, *block, q_inout)
