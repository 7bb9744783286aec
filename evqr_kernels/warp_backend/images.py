"""Images made ready: outliers clipped, resolution reduced, several mixed.

``clip_outliers``: values beyond ``factor`` times the mean magnitude of those that are not 0 are clipped: a
pixel that fires all the time is no edge.  How many are not 0 is told too.

``reduce_image``: sum over a coarser grid: the pixel of the coarse image covers ``ratio`` x ``ratio`` fine
pixels, with fractional coverage at its borders.

``mix_images``: image_n = sum_k weight(n, k) image_k.  Its adjoint in the images is itself, with the weights
transposed.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, variant, vector

SPAN = 16
"""Neighbouring pixels of a row that are worked on together."""


@cache
def make_measure_rows(dtype: type) -> wp.Kernel:
    """Build the first pass of clipping; launch: one thread per row."""
    vec_block = vector(SPAN, dtype)
    vec_counts = vector(SPAN, wp.int32)

    @wp.kernel(module=module_of("images", dtype))
    def measure_rows(
        image: wp.array3d(dtype=dtype),
        blocks: wp.array3d(dtype=vec_block),
        rows_out: wp.array3d(dtype=dtype),
    ):
        b, y = wp.tid()
        width = image.shape[2]
        whole = width - width % SPAN
        totals = vec_block()
        counts = vec_counts()
        for x in range(0, whole, SPAN):
            values = blocks[b, y, x]
            totals += wp.abs(values)
            for p in range(SPAN):
                counts[p] += wp.where(values[p] != dtype(0.0), 1, 0)
        # in the same order as if zeros followed: what an image is a part of makes no difference
        for p in range(SPAN):
            if whole + p < width:
                value = image[b, y, whole + p]
                totals[p] += wp.abs(value)
                counts[p] += wp.where(value != dtype(0.0), 1, 0)
        total = dtype(0.0)
        count = wp.int32(0)
        for p in range(SPAN):
            total += totals[p]
            count += counts[p]
        rows_out[b, y, 0] = total
        rows_out[b, y, 1] = dtype(count)

    return measure_rows


@cache
def make_limit(dtype: type) -> wp.Kernel:
    """Build the second pass; launch: one thread per image."""

    @wp.kernel(module=module_of("images", dtype))
    def limit(
        rows: wp.array3d(dtype=dtype),
        factor: dtype,
        limit_out: wp.array(dtype=dtype),
        busy_out: wp.array(dtype=dtype),
    ):
        b = wp.tid()
        total = dtype(0.0)
        count = dtype(0.0)
        for y in range(rows.shape[1]):
            total += rows[b, y, 0]
            count += rows[b, y, 1]
        busy_out[b] = count
        limit_out[b] = factor * total / wp.max(count, dtype(1.0))

    return limit


@cache
def make_clip_rows(dtype: type) -> wp.Kernel:
    """Build the third pass; launch: one thread per row."""
    vec_block = vector(SPAN, dtype)

    @wp.func
    def clipped(value: dtype, high: dtype):
        # of what is not a number neither comparison holds: it stays, and is no limit
        lower = wp.where(value > high, high, value)
        return wp.where(lower < -high, -high, lower)

    @wp.kernel(module=module_of("images", dtype))
    def clip_rows(
        image: wp.array3d(dtype=dtype),
        blocks: wp.array3d(dtype=vec_block),
        limit: wp.array(dtype=dtype),
        image_out: wp.array3d(dtype=dtype),
        blocks_out: wp.array3d(dtype=vec_block),
    ):
        b, y = wp.tid()
        high = limit[b]
        width = image.shape[2]
        whole = width - width % SPAN
        for x in range(0, whole, SPAN):
            values = blocks[b, y, x]
            for p in range(SPAN):
                values[p] = clipped(values[p], high)
            blocks_out[b, y, x] = values
        for x in range(whole, width):
            image_out[b, y, x] = clipped(image[b, y, x], high)

    return clip_rows


def clip_outliers(image, factor: float, rows_out, limit_out, image_out, busy_out) -> None:
    """Launch the three passes; overwrites."""
    dtype, device = image.dtype, image.device
    rows = image.shape[:2]
    blocks = neighbours(image, SPAN)
    launch(make_measure_rows(dtype), rows, inputs=[image, blocks], outputs=[rows_out], device=device)
    launch(
        make_limit(dtype), rows[0], inputs=[rows_out, factor], outputs=[limit_out, busy_out], device=device
    )
    launch(
        make_clip_rows(dtype),
        rows,
        inputs=[image, blocks, limit_out],
        outputs=[image_out, neighbours(image_out, SPAN)],
        device=device,
    )


@cache
def make_reduce_image(dtype: type, rows: int) -> wp.Kernel:
    """Build the reduction; launch: one thread per ``rows`` coarse rows, first summed over fine ones.

    What a coarse pixel covers of its fine columns is the same in all rows.
    """
    vec_block = vector(SPAN, dtype)

    @wp.kernel(module=module_of(f"reduce_{rows}", dtype))
    def reduce_image(
        image: wp.array3d(dtype=dtype),
        image_blocks: wp.array3d(dtype=vec_block),
        ratio: dtype,
        rows_out: wp.array3d(dtype=dtype),
        row_blocks_out: wp.array3d(dtype=vec_block),
        image_out: wp.array3d(dtype=dtype),
    ):
        b, part = wp.tid()
        one = dtype(1.0)
        fine_width = image.shape[2]
        begin = rows * part
        end = wp.min(begin + rows, image_out.shape[1])
        whole = fine_width - fine_width % SPAN
        for y in range(begin, end):
            top = dtype(y) * ratio
            bottom = top + ratio
            first = int(top)
            last = wp.min(int(wp.ceil(bottom)), image.shape[1])
            for x in range(0, whole, SPAN):
                block = vec_block()
                for j in range(first, last):
                    share = wp.min(bottom, dtype(j) + one) - wp.max(top, dtype(j))
                    block += share * image_blocks[b, j, x]
                row_blocks_out[b, y, x] = block
            for x in range(whole, fine_width):
                total = dtype(0.0)
                for j in range(first, last):
                    total += (wp.min(bottom, dtype(j) + one) - wp.max(top, dtype(j))) * image[b, j, x]
                rows_out[b, y, x] = total
        for x in range(image_out.shape[2]):
            left = dtype(x) * ratio
            right = left + ratio
            start = int(left)
            stop = wp.min(int(wp.ceil(right)), fine_width)
            at = wp.min(start, fine_width - 1)
            # without a loop up to a ratio of 2: how often it would run changes from pixel to pixel
            next_at = wp.min(start + 1, fine_width - 1)
            after_at = wp.min(start + 2, fine_width - 1)
            share = wp.where(start < stop, wp.min(ratio, dtype(start + 1) - left), dtype(0.0))
            next_share = wp.where(start + 1 < stop, wp.min(right - dtype(start + 1), one), dtype(0.0))
            after_share = wp.where(start + 2 < stop, wp.min(right - dtype(start + 2), one), dtype(0.0))
            for y in range(begin, end):
                total = share * rows_out[b, y, at]
                total += next_share * rows_out[b, y, next_at]
                total += after_share * rows_out[b, y, after_at]
                for i in range(start + 3, stop):
                    total += wp.min(right - dtype(i), one) * rows_out[b, y, i]
                image_out[b, y, x] = total

    return reduce_image


def reduce_image(image, ratio: float, rows_out, image_out) -> None:
    """Launch; overwrites."""
    rows = variant("reduce_image", image.device).rows
    launch(
        make_reduce_image(image.dtype, rows),
        (image_out.shape[0], -(-image_out.shape[1] // rows)),
        inputs=[image, neighbours(image, SPAN), ratio],
        outputs=[rows_out, neighbours(rows_out, SPAN), image_out],
        device=image.device,
    )


@cache
def make_mix_images(dtype: type, block: int) -> wp.Kernel:
    """Build the mixing; launch: ``parts`` threads per row of a result."""
    vec_block = vector(block, dtype)

    @wp.kernel(module=module_of(f"mix_{block}", dtype))
    def mix_images(
        blocks: wp.array4d(dtype=vec_block),
        image_idx: wp.array(dtype=wp.int32),
        weight: wp.array2d(dtype=dtype),
        parts: int,
        blocks_out: wp.array3d(dtype=vec_block),
    ):
        n, y, part = wp.tid()
        image = image_idx[n]
        places = blocks_out.shape[2]
        for begin in range(block * part, places + block - 1, block * parts):
            # the last block ends with the row; what it shares with the one before is written twice, alike
            x = wp.min(begin, places - 1)
            total = vec_block()
            for i in range(weight.shape[1]):
                total += weight[n, i] * blocks[image, i, y, x]
            blocks_out[n, y, x] = total

    return mix_images


def mix_images(images, image_idx, weight, images_out) -> None:
    """Launch; overwrites."""
    count, height, width = images_out.shape
    block = variant("mix_images", images.device, width).tile
    parts = 1 if images.device.is_cpu else -(-width // block)
    launch(
        make_mix_images(images.dtype, block),
        (count, height, parts),
        inputs=[neighbours(images, block), image_idx, weight, parts],
        outputs=[neighbours(images_out, block)],
        device=images.device,
    )
