"""Displacement between two images, by correlation over a small square of shifts.

    correlation(b, j, i) = sum_{y, x} first(b, y, x) second(b, y + j - R, x + i - R),        R = radius
    energy(b, i)         = sum of the squares of image i

with both images clipped to +- clip: a pixel that fires all the time is no structure.  Images of events are
mostly empty, so a row of ``first`` visits only its non-zero pixels.  Each row owns its sums; a last pass
adds the rows up, so the result does not depend on the order of the threads.

Of a pair whose squares, before clipping, sum up to what is told to be quiet nothing more is done: of counts
of noise they sum up to the number of events, of anything with a shape to more or less.

``surface_peak`` finds the highest point of such a surface c, blurred by a window of half width h,

    f(u, v) = 1 / h^2 sum_{j, i} k(i - u) k(j - v) c(j, i),      k(r) = cos^2(pi r / 2h) for |r| < h, else 0

first of whole (u, v) whose windows do not hang over the border, then between them by Newton's method.  A
displacement's correlation is symmetric about its peak, so f, whose window is symmetric about any point, is
highest there; a window that the border cuts off, or a parabola through three entries, would move it.

The entry in the middle says more of the pixels than of the motion: one that has just fired is less ready to.
For a peak that is a step away or more it is taken to be what lies as far on the other side of the peak; for
the search of the highest entry, the mean of its four neighbours where it is below them.
"""

import math
from functools import cache

import warp as wp

from evqr_kernels.operations.images import NEWTON_STEPS, taps_beside
from evqr_kernels.warp_backend.language import launch, launch_bounds, module_of, neighbours, variant, vector


@cache
def make_clip_rows(dtype: type, block: int) -> wp.Kernel:
    """Build the clipping; launch: one thread per row of each image."""
    vec_block = vector(block, dtype)

    @wp.kernel(module=module_of(f"motion_{block}", dtype))
    def clip_rows(
        blocks: wp.array4d(dtype=vec_block),
        clip: dtype,
        images_inout: wp.array4d(dtype=dtype),
        energy_rows_out: wp.array3d(dtype=dtype),
    ):
        b, i, y = wp.tid()
        width = images_inout.shape[3]
        whole = width - width % block
        energy = dtype(0.0)
        before = dtype(0.0)
        for x in range(0, whole, block):
            pixels = blocks[b, i, y, x]
            squares = wp.dot(pixels, pixels)
            before += squares
            if not (squares <= clip * clip):  # else none of them is beyond; also true for NaN
                squares = dtype(0.0)
                for p in range(block):
                    value = images_inout[b, i, y, x + p]
                    if wp.abs(value) > clip:
                        value = wp.where(value > clip, clip, -clip)
                        images_inout[b, i, y, x + p] = value
                    squares += value * value
            energy += squares
        for x in range(whole, width):
            value = images_inout[b, i, y, x]
            before += value * value
            if wp.abs(value) > clip:
                value = wp.where(value > clip, clip, -clip)
                images_inout[b, i, y, x] = value
            energy += value * value
        energy_rows_out[b, y, i] = energy
        energy_rows_out[b, y, 2 + i] = before

    return clip_rows


@cache
def make_judge_pairs(dtype: type) -> wp.Kernel:
    """Build the choice of what is worth while; launch: one thread per pair."""

    @wp.kernel(module=module_of("motion", dtype))
    def judge_pairs(
        energy_rows: wp.array3d(dtype=dtype),
        quiet: wp.array2d(dtype=dtype),
        busy_out: wp.array(dtype=wp.int32),
        energy_out: wp.array2d(dtype=dtype),
    ):
        b = wp.tid()
        first = dtype(0.0)
        second = dtype(0.0)
        before = dtype(0.0)
        for y in range(energy_rows.shape[1]):
            first += energy_rows[b, y, 0]
            second += energy_rows[b, y, 1]
            before += energy_rows[b, y, 2] + energy_rows[b, y, 3]
        energy_out[b, 0] = first
        energy_out[b, 1] = second
        busy_out[b] = wp.where(before < quiet[b, 0] or before > quiet[b, 1], 1, 0)

    return judge_pairs


@cache
def make_correlate_rows(dtype: type, block: int, rows: int) -> wp.Kernel:
    """Build the correlation; launch: one thread per row.  ``.._blocks``: `neighbours` of the same array."""
    vec_block = vector(block, dtype)
    mat_sums = wp.types.matrix(shape=(rows, block), dtype=dtype)

    @wp.kernel(module=module_of(f"motion_{block}", dtype), launch_bounds=launch_bounds(dtype))
    def correlate_rows(
        images: wp.array4d(dtype=dtype),
        blocks: wp.array4d(dtype=vec_block),
        busy: wp.array(dtype=wp.int32),
        radius: int,
        found_out: wp.array3d(dtype=wp.int32),
        rows_out: wp.array4d(dtype=dtype),
        row_blocks_out: wp.array4d(dtype=vec_block),
    ):
        b, y = wp.tid()
        if busy[b] == 0:
            return
        height = images.shape[2]
        width = images.shape[3]
        shifts = 2 * radius + 1
        columns = rows_out.shape[3]
        # of the pixels from which no block of shifts hangs out of the image, find those that are not 0; then
        # do one row of shifts after the other, whose sums stay in registers
        first = wp.min(radius, width)
        last = wp.max(first, width - columns + radius + 1)
        count = wp.int32(0)
        for x in range(first, last, block):
            begin = wp.min(x, width - block)
            pixels = blocks[b, 0, y, begin]
            if wp.dot(pixels, pixels) > dtype(0.0):
                for p in range(x, wp.min(x + block, last)):
                    if images[b, 0, y, p] != dtype(0.0):
                        found_out[b, y, count] = p
                        count += 1
        # `rows` rows of shifts at a time: they share each pixel, and while one sum waits the others add
        for j in range(0, shifts, rows):
            top = y - radius + j
            for i in range(0, columns, block):
                sums = mat_sums()
                for k in range(count):
                    x = found_out[b, y, k]
                    value = images[b, 0, y, x]
                    for r in range(wp.static(rows)):
                        row = wp.clamp(top + r, 0, height - 1)
                        sums[r] += value * blocks[b, 1, row, x - radius + i]
                for r in range(wp.static(rows)):
                    if j + r < shifts:
                        inside = top + r >= 0 and top + r < height
                        row_blocks_out[b, y, j + r, i] = wp.where(inside, sums[r], vec_block())
        for k in range(width - (last - first)):  # the others
            x = k
            if k >= first:
                x = last + k - first
            value = images[b, 0, y, x]
            if value != dtype(0.0):
                for j in range(wp.max(0, radius - y), wp.min(shifts, height + radius - y)):
                    for i in range(wp.max(0, radius - x), wp.min(shifts, width + radius - x)):
                        # not +=: that is an atomic, which the owner of a row can do without
                        product = value * images[b, 1, y + j - radius, x + i - radius]
                        rows_out[b, y, j, i] = rows_out[b, y, j, i] + product

    return correlate_rows


@cache
def make_add_rows(dtype: type, block: int) -> wp.Kernel:
    """Build the sum over rows; launch: one thread per block of shifts."""
    vec_block = vector(block, dtype)

    @wp.kernel(module=module_of(f"motion_{block}", dtype))
    def add_rows(
        row_blocks: wp.array4d(dtype=vec_block),
        busy: wp.array(dtype=wp.int32),
        correlation_out: wp.array3d(dtype=dtype),
    ):
        b, j, k = wp.tid()
        total = vec_block()
        for y in range(row_blocks.shape[1] * busy[b]):
            total += row_blocks[b, y, j, block * k]
        shifts = correlation_out.shape[2]
        for i in range(wp.min(block, shifts - block * k)):
            correlation_out[b, j, block * k + i] = total[i]

    return add_rows


def motion_correlation(
    images_inout,
    quiet,
    clip: float,
    radius: int,
    found_out,
    rows_out,
    energy_rows_out,
    busy_out,
    correlation_out,
    energy_out,
) -> None:
    """Launch the four passes; clips the images in place, overwrites the rest."""
    dtype, device = images_inout.dtype, images_inout.device
    batch, _, height, _ = images_inout.shape
    chosen = variant("motion_correlation", device)
    block = chosen.tile
    blocks, row_blocks = neighbours(images_inout, block), neighbours(rows_out, block)
    launch(
        make_clip_rows(dtype, block),
        (batch, 2, height),
        inputs=[blocks, clip],
        outputs=[images_inout, energy_rows_out],
        device=device,
    )
    launch(
        make_judge_pairs(dtype),
        batch,
        inputs=[energy_rows_out, quiet],
        outputs=[busy_out, energy_out],
        device=device,
    )
    launch(
        make_correlate_rows(dtype, block, chosen.rows),
        (batch, height),
        inputs=[images_inout, blocks, busy_out, radius],
        outputs=[found_out, rows_out, row_blocks],
        device=device,
    )
    launch(
        make_add_rows(dtype, block),
        (batch, correlation_out.shape[1], rows_out.shape[3] // block),
        inputs=[row_blocks, busy_out],
        outputs=[correlation_out],
        device=device,
    )


TERMS = {wp.float32: 8, wp.float64: 15}
"""Terms of the series of cosine and sine that count at half a turn."""


@cache
def make_series(dtype: type, first: int) -> wp.Function:
    """Build the series of the cosine (1), or of the sine over its argument (2), of up to half a turn.

    What a GPU has for any argument takes a stack and twice the registers.
    """
    count = TERMS[dtype]
    factors = [1.0 / ((2 * k + first) * (2 * k + first + 1)) for k in reversed(range(count))]
    vec_terms = vector(count, dtype)
    table = vec_terms(*factors)

    @wp.func
    def series(x: dtype):
        square = x * x
        value = dtype(1.0)
        for k in range(wp.static(count)):
            value = dtype(1.0) - value * square * wp.static(table)[k]
        return value

    return series


@cache
def make_surface_peak(dtype: type) -> wp.Kernel:
    """Build the search for the peak; launch: one thread per surface, a few thousand multiply-adds."""
    cosine_of, sine_over = make_series(dtype, 1), make_series(dtype, 2)

    @wp.kernel(module=module_of("motion", dtype))
    def surface_peak(
        surface: wp.array3d(dtype=dtype),
        half: dtype,
        reach: int,
        filled_out: wp.array3d(dtype=dtype),
        rows_out: wp.array3d(dtype=dtype),
        peak_out: wp.array2d(dtype=dtype),
    ):
        b = wp.tid()
        size = surface.shape[1]
        middle = size // 2
        turn = dtype(wp.static(math.pi)) / half
        for j in range(size):
            for i in range(size):
                filled_out[b, j, i] = surface[b, j, i]
        beside = surface[b, middle, middle - 1] + surface[b, middle, middle + 1]
        beside += surface[b, middle - 1, middle] + surface[b, middle + 1, middle]
        filled_out[b, middle, middle] = wp.max(surface[b, middle, middle], dtype(0.25) * beside)

        # three rows behind those of the surface hold the window, and its first and second derivatives
        for k in range(2 * reach + 1):
            rows_out[b, size, k] = dtype(0.5) + dtype(0.5) * cosine_of(turn * dtype(k - reach))
        for j in range(size):
            for i in range(reach, size - reach):
                total = dtype(0.0)
                for k in range(2 * reach + 1):
                    total += rows_out[b, size, k] * filled_out[b, j, i + k - reach]
                rows_out[b, j, i] = total
        row = reach
        column = reach
        highest = dtype(0.0)
        for j in range(reach, size - reach):
            for i in range(reach, size - reach):
                total = dtype(0.0)
                for k in range(2 * reach + 1):
                    total += rows_out[b, size, k] * rows_out[b, j + k - reach, i]
                if total > highest or (i == reach and j == reach):
                    highest = total
                    row = j
                    column = i

        x = dtype(0.0)
        y = dtype(0.0)
        height = dtype(0.0)
        left = wp.max(column - reach - 1, 0)
        right = wp.min(column + reach + 2, size)
        top = wp.max(row - reach - 1, 0)
        bottom = wp.min(row + reach + 2, size)
        for step in range(NEWTON_STEPS + 1):
            across = dtype(column - middle) + x
            down = dtype(row - middle) + y
            if step >= 2 and across * across + down * down >= dtype(1.0):
                # as far on the other side of the peak, between four entries
                to_x = dtype(middle) + dtype(2.0) * across
                to_y = dtype(middle) + dtype(2.0) * down
                at_x = wp.clamp(int(wp.floor(to_x)), 0, size - 2)
                at_y = wp.clamp(int(wp.floor(to_y)), 0, size - 2)
                to_x = wp.clamp(to_x - dtype(at_x), dtype(0.0), dtype(1.0))
                to_y = wp.clamp(to_y - dtype(at_y), dtype(0.0), dtype(1.0))
                upper = wp.lerp(surface[b, at_y, at_x], surface[b, at_y, at_x + 1], to_x)
                lower = wp.lerp(surface[b, at_y + 1, at_x], surface[b, at_y + 1, at_x + 1], to_x)
                filled_out[b, middle, middle] = wp.lerp(upper, lower, to_y)
            for i in range(left, right):
                r = dtype(i - column) - x
                inside = wp.where(wp.abs(r) < half, dtype(0.5), dtype(0.0))
                cosine = inside * cosine_of(turn * r)
                rows_out[b, size, i] = inside + cosine
                rows_out[b, size + 1, i] = inside * turn * turn * r * sine_over(turn * r)
                rows_out[b, size + 2, i] = -turn * turn * cosine
            total = dtype(0.0)
            slope_x = dtype(0.0)
            slope_y = dtype(0.0)
            xx = dtype(0.0)
            xy = dtype(0.0)
            yy = dtype(0.0)
            for j in range(top, bottom):
                r = dtype(j - row) - y
                inside = wp.where(wp.abs(r) < half, dtype(0.5), dtype(0.0))
                cosine = inside * cosine_of(turn * r)
                weight = inside + cosine
                first = inside * turn * turn * r * sine_over(turn * r)
                second = -turn * turn * cosine
                blurred = dtype(0.0)
                along = dtype(0.0)
                bent = dtype(0.0)
                for i in range(left, right):
                    value = filled_out[b, j, i]
                    blurred += rows_out[b, size, i] * value
                    along += rows_out[b, size + 1, i] * value
                    bent += rows_out[b, size + 2, i] * value
                total += weight * blurred
                slope_x += weight * along
                slope_y += first * blurred
                xx += weight * bent
                xy += first * along
                yy += second * blurred
            height = total / (half * half)
            determinant = xx * yy - xy * xy
            if step == NEWTON_STEPS or not (xx < dtype(0.0) and determinant > dtype(0.0)):
                break
            x = wp.clamp(x - (yy * slope_x - xy * slope_y) / determinant, dtype(-1.0), dtype(1.0))
            y = wp.clamp(y - (xx * slope_y - xy * slope_x) / determinant, dtype(-1.0), dtype(1.0))
        peak_out[b, 0] = dtype(column - middle) + x
        peak_out[b, 1] = dtype(row - middle) + y
        peak_out[b, 2] = height

    return surface_peak


def surface_peak(surface, half: float, filled_out, rows_out, peak_out) -> None:
    """Launch; overwrites."""
    launch(
        make_surface_peak(surface.dtype),
        surface.shape[0],
        inputs=[surface, half, taps_beside(half)],
        outputs=[filled_out, rows_out, peak_out],
        device=surface.device,
    )
