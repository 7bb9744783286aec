"""Displacement between two images, by correlation over a small square of shifts.

    correlation(b, j, i) = sum_{y, x} first(b, y, x) second(b, y + j - R, x + i - R),        R = radius
    energy(b, i)         = sum of the squares of image i

with both images clipped to +- clip: a pixel that fires all the time is no structure.  Images of events are
mostly empty, so a row of ``first`` visits only its non-zero pixels.  Each row owns its sums; a second pass
adds the rows up, so the result does not depend on the order of the threads.

``surface_peak`` finds the highest point of such a surface, blurred by a symmetric matrix S:

    smooth = S correlation S^T

and refines its highest interior entry by the quadratic that fits its 3 x 3 neighbourhood best.
"""

from functools import cache

import warp as wp

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
        for x in range(0, whole, block):
            pixels = blocks[b, i, y, x]
            squares = wp.dot(pixels, pixels)
            if squares > clip * clip:  # else none of them is beyond
                for p in range(block):
                    value = images_inout[b, i, y, x + p]
                    if wp.abs(value) > clip:
                        images_inout[b, i, y, x + p] = wp.clamp(value, -clip, clip)
                        squares += clip * clip - value * value
            energy += squares
        for x in range(whole, width):
            value = wp.clamp(images_inout[b, i, y, x], -clip, clip)
            images_inout[b, i, y, x] = value
            energy += value * value
        energy_rows_out[b, y, i] = energy

    return clip_rows


@cache
def make_correlate_rows(dtype: type, block: int, rows: int) -> wp.Kernel:
    """Build the correlation; launch: one thread per row.  ``.._blocks``: `neighbours` of the same array."""
    vec_block = vector(block, dtype)
    mat_sums = wp.types.matrix(shape=(rows, block), dtype=dtype)

    @wp.kernel(module=module_of(f"motion_{block}", dtype), launch_bounds=launch_bounds(dtype))
    def correlate_rows(
        images: wp.array4d(dtype=dtype),
        blocks: wp.array4d(dtype=vec_block),
        radius: int,
        found_out: wp.array3d(dtype=wp.int32),
        rows_out: wp.array4d(dtype=dtype),
        row_blocks_out: wp.array4d(dtype=vec_block),
    ):
        b, y = wp.tid()
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
        energy_rows: wp.array3d(dtype=dtype),
        correlation_out: wp.array3d(dtype=dtype),
        energy_out: wp.array2d(dtype=dtype),
    ):
        b, j, k = wp.tid()
        total = vec_block()
        for y in range(row_blocks.shape[1]):
            total += row_blocks[b, y, j, block * k]
        shifts = correlation_out.shape[2]
        for i in range(wp.min(block, shifts - block * k)):
            correlation_out[b, j, block * k + i] = total[i]
        if j == 0 and k == 0:
            for image in range(2):
                energy = dtype(0.0)
                for y in range(energy_rows.shape[1]):
                    energy += energy_rows[b, y, image]
                energy_out[b, image] = energy

    return add_rows


def motion_correlation(
    images_inout, clip: float, radius: int, found_out, rows_out, energy_rows_out, correlation_out, energy_out
) -> None:
    """Launch the three passes; clips the images in place, overwrites the rest."""
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
        make_correlate_rows(dtype, block, chosen.rows),
        (batch, height),
        inputs=[images_inout, blocks, radius],
        outputs=[found_out, rows_out, row_blocks],
        device=device,
    )
    launch(
        make_add_rows(dtype, block),
        (batch, correlation_out.shape[1], rows_out.shape[3] // block),
        inputs=[row_blocks, energy_rows_out],
        outputs=[correlation_out, energy_out],
        device=device,
    )


@cache
def make_surface_peak(dtype: type) -> wp.Kernel:
    """Build the search for the peak; launch: one thread per surface, a few thousand multiply-adds."""

    @wp.kernel(module=module_of("motion", dtype))
    def surface_peak(
        surface: wp.array3d(dtype=dtype),
        smoother: wp.array2d(dtype=dtype),
        rows_out: wp.array3d(dtype=dtype),
        smooth_out: wp.array3d(dtype=dtype),
        peak_out: wp.array2d(dtype=dtype),
    ):
        b = wp.tid()
        size = surface.shape[1]
        for j in range(size):
            for i in range(size):
                rows_out[b, j, i] = dtype(0.0)
            for k in range(size):
                for i in range(size):
                    rows_out[b, j, i] = rows_out[b, j, i] + smoother[j, k] * surface[b, k, i]
        row = wp.int32(1)
        column = wp.int32(1)
        for j in range(size):
            for i in range(size):
                total = dtype(0.0)
                for k in range(size):
                    total += rows_out[b, j, k] * smoother[i, k]
                smooth_out[b, j, i] = total
        for j in range(1, size - 1):
            for i in range(1, size - 1):
                if smooth_out[b, j, i] > smooth_out[b, row, column]:
                    row = j
                    column = i

        # c0 + cx x + cy y + cxx x^2 + cxy x y + cyy y^2 by least squares; its sums over the 3 x 3 are these
        sx = dtype(0.0)
        sy = dtype(0.0)
        sxx = dtype(0.0)
        sxy = dtype(0.0)
        syy = dtype(0.0)
        total = dtype(0.0)
        for j in range(3):
            for i in range(3):
                v = smooth_out[b, row + j - 1, column + i - 1]
                x = dtype(i - 1)
                y = dtype(j - 1)
                total += v
                sx += x * v
                sy += y * v
                sxx += x * x * v
                sxy += x * y * v
                syy += y * y * v
        cx = sx / dtype(6.0)
        cy = sy / dtype(6.0)
        two_cxx = sxx - total * dtype(2.0) / dtype(3.0)
        two_cyy = syy - total * dtype(2.0) / dtype(3.0)
        cxy = sxy / dtype(4.0)
        determinant = two_cxx * two_cyy - cxy * cxy
        x_off = dtype(0.0)
        y_off = dtype(0.0)
        if two_cxx < dtype(0.0) and determinant > dtype(0.0):
            x_off = wp.clamp(-(two_cyy * cx - cxy * cy) / determinant, dtype(-1.0), dtype(1.0))
            y_off = wp.clamp(-(two_cxx * cy - cxy * cx) / determinant, dtype(-1.0), dtype(1.0))
        peak_out[b, 0] = dtype(column - size // 2) + x_off
        peak_out[b, 1] = dtype(row - size // 2) + y_off
        peak_out[b, 2] = smooth_out[b, row, column]

    return surface_peak


def surface_peak(surface, smoother, rows_out, smooth_out, peak_out) -> None:
    """Launch; overwrites."""
    launch(
        make_surface_peak(surface.dtype),
        surface.shape[0],
        inputs=[surface, smoother],
        outputs=[rows_out, smooth_out, peak_out],
        device=surface.device,
    )
