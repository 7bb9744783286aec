"""The modules of a planar code, solved for in one go: the Cholesky factor of a banded matrix.

The same system as in ``solve``,

    (S + damping I) q = -rhs        on the free modules; the rest of the q that is given stays as it is

with modules numbered line by line, M in each, has all its entries within ``width = reach M + reach`` of the
diagonal, and so has its factor L, of which row i is kept as ``band(i, width + j - i) = L(i, j)``, rows of
fixed modules as those of the unit matrix:

    L(i, j) = (A(i, j) - sum_k L(i, k) L(j, k)) / L(j, j),      L(i, i) = sqrt(A(i, i) - sum_k L(i, k)^2)
    L y = -rhs - (S q of the fixed modules),                    L^T q = y

It costs width^2 / 2 multiply-adds a module whatever the condition of S is.  So lines lie along the shorter
side: they are the rows of a code that is upright, at least as high as wide, and else its columns.  A first
pass fills the band with A and q with the right side; then one thread owns one window: on a GPU that pays for
batches of hundreds.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, launch_bounds, module_of, neighbours, variant, vector


@cache
def make_number_of(upright: bool) -> wp.Function:
    """Build the number of the module in a row and a column."""

    @wp.func
    def by_rows(row: int, column: int, rows: int, columns: int) -> int:
        return row * columns + column

    @wp.func
    def by_columns(row: int, column: int, rows: int, columns: int) -> int:
        return column * rows + row

    return by_rows if upright else by_columns


@cache
def make_place_of(upright: bool) -> wp.Function:
    """Build where the module of a number lies in an array's memory."""

    @wp.func
    def by_rows(number: int, rows: int, columns: int) -> int:
        return number

    @wp.func
    def by_columns(number: int, rows: int, columns: int) -> int:
        column = number // rows
        return (number - column * rows) * columns + column

    return by_rows if upright else by_columns


def name_of(concept: str, upright: bool) -> str:
    """Name what kernels of a numbering are compiled into."""
    return concept if upright else f"{concept}_wide"


@cache
def make_fill_band(dtype: type, upright: bool) -> wp.Kernel:
    """Build the system: the matrix's rows up to the diagonal, and the right side.

    Launch: one thread per module.
    """
    number_of = make_number_of(upright)

    @wp.kernel(module=module_of(name_of("banded", upright), dtype))
    def fill_band(
        rhs: wp.array3d(dtype=dtype),
        stencil: wp.array3d(dtype=dtype),
        damping: wp.array(dtype=dtype),
        free: wp.array2d(dtype=wp.int32),
        band_out: wp.array3d(dtype=dtype),
        q_inout: wp.array3d(dtype=dtype),
    ):
        b, row, column = wp.tid()
        rows = free.shape[0]
        columns = free.shape[1]
        i = number_of(row, column, rows, columns)
        width = band_out.shape[2] - 1
        for k in range(width):
            band_out[b, i, k] = dtype(0.0)
        band_out[b, i, width] = dtype(1.0)
        if free[row, column] != 0:
            side = stencil.shape[1]
            reach = side // 2
            band_out[b, i, width] = stencil[b, reach, reach] + damping[b]
            value = -rhs[b, row, column]
            # counted on, not in two loops: a GPU's compiler would unroll each four times
            k = wp.int32(0)
            m = wp.int32(0)
            while k < side:
                r = row + k - reach
                c = column + m - reach
                if r >= 0 and c >= 0 and r < rows and c < columns:
                    j = number_of(r, c, rows, columns)
                    entry = stencil[b, k, m]
                    if free[r, c] == 0:
                        value -= entry * q_inout[b, r, c]
                    elif j < i:
                        band_out[b, i, width + j - i] = entry
                m += 1
                if m == side:
                    m = 0
                    k += 1
            q_inout[b, row, column] = value

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
def make_solve_banded(dtype: type, block: int, upright: bool) -> wp.Kernel:
    """Build the solution; launch: one thread per window.  ``blocks``: `neighbours` of the band."""
    vec_block = vector(block, dtype)
    row_product = make_row_product(dtype, block)
    place_of = make_place_of(upright)

    @wp.kernel(
        module=module_of(name_of(f"banded_{block}", upright), dtype), launch_bounds=launch_bounds(dtype)
    )
    def solve_banded(
        rows: int,
        columns: int,
        free: wp.array(dtype=wp.int32),
        blocks: wp.array3d(dtype=vec_block),
        band_inout: wp.array3d(dtype=dtype),
        q_inout: wp.array2d(dtype=dtype),
    ):
        b = wp.tid()
        modules = rows * columns
        width = band_inout.shape[2] - 1
        for i in range(modules):
            at = place_of(i, rows, columns)
            if free[at] != 0:
                begin = wp.max(0, i - width)
                value = q_inout[b, at]
                # each entry needs those left of it; the last is the diagonal
                for j in range(begin, i + 1):
                    beside = place_of(j, rows, columns)
                    if free[beside] != 0:  # rows of fixed modules stay as they are
                        first = wp.max(begin, j - width)
                        entry = band_inout[b, i, width + j - i] - row_product(
                            band_inout, blocks, b, i, width + first - i, j, width + first - j, j - first
                        )
                        if j < i:
                            entry /= band_inout[b, j, width]
                            value -= entry * q_inout[b, beside]
                        else:
                            entry = wp.sqrt(entry)
                            q_inout[b, at] = value / entry
                        band_inout[b, i, width + j - i] = entry
        for back in range(modules):
            i = modules - 1 - back
            at = place_of(i, rows, columns)
            if free[at] != 0:
                value = q_inout[b, at] / band_inout[b, i, width]
                q_inout[b, at] = value
                for j in range(wp.max(0, i - width), i):
                    beside = place_of(j, rows, columns)
                    if free[beside] != 0:
                        q_inout[b, beside] = q_inout[b, beside] - band_inout[b, i, width + j - i] * value

    return solve_banded


def solve_code_banded(rhs, stencil, damping, free, band_out, q_inout) -> None:
    """Launch both passes; q is updated in place, the band is scratch."""
    block = variant("solve_code_banded", rhs.device).tile
    batch, rows, columns = rhs.shape
    upright = rows >= columns
    launch(
        make_fill_band(rhs.dtype, upright),
        rhs.shape,
        inputs=[rhs, stencil, damping, free],
        outputs=[band_out, q_inout],
        device=rhs.device,
    )
    launch(
        make_solve_banded(rhs.dtype, block, upright),
        batch,
        inputs=[rows, columns, free.flatten(), neighbours(band_out, block)],
        outputs=[band_out, q_inout.reshape((batch, rows * columns))],
        device=rhs.device,
    )
