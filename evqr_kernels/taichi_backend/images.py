"""Images made ready for a search; the definitions are in ``warp_backend/images.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, is_alone, ti
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
                count += ti.select(value != dtype(0.0), 1, 0)
            rows_out[b, y, 0] = total
            rows_out[b, y, 1] = dtype(count)

    return measure_rows


@cache
def make_limit(dtype, alone: bool):
    """Build the second pass; one thread per image."""

    @ti.kernel
    def limit(rows: array(dtype, 3), factor: dtype, limit_out: array(dtype, 1)):
        ti.loop_config(serialize=alone)
        for b in range(limit_out.shape[0]):
            total = dtype(0.0)
            count = dtype(0.0)
            for y in range(rows.shape[1]):
                total += rows[b, y, 0]
                count += rows[b, y, 1]
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
                image_out[b, y, x] = ti.max(-high, ti.min(image[b, y, x], high))

    return clip_rows


def clip_outliers(image, factor: float, rows_out, limit_out, image_out) -> None:
    """Launch the three passes; overwrites."""
    dtype = float_of(image)
    launch(make_measure_rows(dtype), image, rows_out)
    launch(make_limit(dtype, is_alone(image)), rows_out, factor, limit_out)
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
                total = dtype(0.0)
                for i in range(int(left), ti.min(int(ti.ceil(right)), width)):
                    total += (ti.min(right, dtype(i) + one) - ti.max(left, dtype(i))) * rows_out[b, y, i]
                image_out[b, y, x] = total

    return reduce_image


def reduce_image(image, ratio: float, rows_out, image_out) -> None:
    """Launch; overwrites."""
    launch(make_reduce_image(float_of(image)), image, ratio, rows_out, image_out)
