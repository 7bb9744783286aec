"""Images made ready; the definitions are in ``warp_backend/images.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import (
    array,
    float_of,
    is_alone,
    is_on_cpu,
    row_of,
    row_of_plane,
    run_at,
    ti,
    variant,
)
from evqr_kernels.taichi_backend.launches import launch


@cache
def make_measure_rows(dtype):
    """Build the first pass of clipping; one thread per row."""

    @ti.kernel
    def measure_rows(image: array(dtype, 3), rows_out: array(dtype, 3)):
        for b, y in ti.ndrange(rows_out.shape[0], rows_out.shape[1]):
            total = dtype(0.0)
            count = 0
            for x in range(image.shape[2]):
                value = image[b, y, x]
                total += ti.abs(value)
                count += ti.select(value == dtype(0.0), 0, 1)  # also of NaN
            rows_out[b, y, 0] = total
            rows_out[b, y, 1] = dtype(count)

    return measure_rows


@cache
def make_limit(dtype, alone: bool):
    """Build the second pass; one thread per image."""

    @ti.kernel
    def limit(rows: array(dtype, 3), factor: dtype, limit_out: array(dtype, 1), busy_out: array(dtype, 1)):
        ti.loop_config(serialize=alone)
        for b in range(limit_out.shape[0]):
            total = dtype(0.0)
            count = dtype(0.0)
            for y in range(rows.shape[1]):
                total += rows[b, y, 0]
                count += rows[b, y, 1]
            busy_out[b] = count
            limit_out[b] = factor * total / ti.max(count, dtype(1.0))

    return limit


@cache
def make_clip_rows(dtype):
    """Build the third pass; one thread per row."""

    @ti.kernel
    def clip_rows(image: array(dtype, 3), limit: array(dtype, 1), image_out: array(dtype, 3)):
        for b, y in ti.ndrange(image_out.shape[0], image_out.shape[1]):
            high = limit[b]
            for x in range(image_out.shape[2]):
                value = image[b, y, x]
                # of what is not a number neither comparison holds: it stays, and is no limit
                value = ti.select(value > high, high, value)
                image_out[b, y, x] = ti.select(value < -high, -high, value)

    return clip_rows


def clip_outliers(image, factor: float, rows_out, limit_out, image_out, busy_out) -> None:
    """Launch the three passes; overwrites."""
    dtype = float_of(image)
    launch(make_measure_rows(dtype), image, rows_out)
    launch(make_limit(dtype, is_alone(image)), rows_out, factor, limit_out, busy_out)
    launch(make_clip_rows(dtype), image, limit_out, image_out)


@cache
def make_reduce_image(dtype):
    """Build the reduction; one thread per coarse row, which it first adds up over fine rows."""

    @ti.kernel
    def reduce_image(
        image: array(dtype, 3), ratio: dtype, rows_out: array(dtype, 3), image_out: array(dtype, 3)
    ):
        for b, y in ti.ndrange(image_out.shape[0], image_out.shape[1]):
            one = dtype(1.0)
            width = image.shape[2]
            top = dtype(y) * ratio
            bottom = top + ratio
            for x in range(width):
                rows_out[b, y, x] = dtype(0.0)
            for j in range(int(top), ti.min(int(ti.ceil(bottom)), image.shape[1])):
                share = ti.min(bottom, dtype(j) + one) - ti.max(top, dtype(j))
                for x in range(width):
                    rows_out[b, y, x] = rows_out[b, y, x] + share * image[b, j, x]
            for x in range(image_out.shape[2]):
                left = dtype(x) * ratio
                right = left + ratio
                start = int(left)
                end = ti.min(int(ti.ceil(right)), width)
                total = dtype(0.0)
                if start < end:
                    # all of each pixel, less what of the first and of the last lies outside
                    total = (dtype(start) - left) * rows_out[b, y, start]
                    total -= ti.max(dtype(end) - right, dtype(0.0)) * rows_out[b, y, end - 1]
                    for i in range(start, end):
                        total += rows_out[b, y, i]
                image_out[b, y, x] = total

    return reduce_image


def reduce_image(image, ratio: float, rows_out, image_out) -> None:
    """Launch; overwrites."""
    launch(make_reduce_image(float_of(image)), image, ratio, rows_out, image_out)


@cache
def make_mix_images(dtype, block: int):
    """Build the mixing; one thread per (result, row)."""

    @ti.kernel
    def mix_images(
        images: array(dtype, 4),
        image_idx: array(ti.i32, 1),
        weight: array(dtype, 2),
        images_out: array(dtype, 3),
    ):
        for n, y in ti.ndrange(images_out.shape[0], images_out.shape[1]):
            width = images_out.shape[2]
            for k in range((width + block - 1) // block):
                # the last block overlaps the one before: what they share is written twice, alike
                x = ti.min(block * k, width - block)
                total = ti.Vector.zero(dtype, block)
                for m in range(weight.shape[1]):
                    share = weight[n, m]
                    at = run_at(row_of_plane(images, image_idx[n], m, y) + x)
                    for p in ti.static(range(block)):
                        total[p] += share * images[0, 0, 0, at + p]
                to = run_at(row_of(images_out, n, y) + x)
                for p in ti.static(range(block)):
                    images_out[0, 0, to + p] = total[p]

    return mix_images


def mix_images(images, image_idx, weight, images_out) -> None:
    """Launch; overwrites."""
    block = variant("mix_images", is_on_cpu(images), images_out.shape[2]).tile
    launch(make_mix_images(float_of(images), block), images, image_idx, weight, images_out)
