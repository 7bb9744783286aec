"""Matched filters at reduced resolution; the formulas are in ``warp_backend/templates.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, launch, ti

ANGLES = 8
"""Templates in a bank."""


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


@cache
def make_correlate_templates(dtype):
    """Build the matched filter; one thread per row of pixels."""

    @ti.kernel
    def correlate_templates(
        image: array(dtype, 3),
        bank: array(dtype, 3),
        disc: array(dtype, 2),
        floor: array(dtype, 1),
        response_out: array(dtype, 3),
        angle_out: array(ti.i32, 3),
    ):
        for b, y in ti.ndrange(response_out.shape[0], response_out.shape[1]):
            size = disc.shape[0]
            for x in range(response_out.shape[2]):
                energy = dtype(0.0)
                for j in range(size):
                    for i in range(size):
                        v = image[b, y + j, x + i]
                        energy += disc[j, i] * v * v
                best = dtype(0.0)
                angle = 0
                if energy >= floor[b]:
                    every = ti.Vector.zero(dtype, ANGLES)
                    for j in range(size):
                        for i in range(size):
                            v = image[b, y + j, x + i]
                            if v != dtype(0.0):
                                for a in ti.static(range(ANGLES)):
                                    every[a] += bank[j, i, a] * v
                    best = every[0]
                    for a in ti.static(range(1, ANGLES)):
                        if ti.abs(every[a]) > ti.abs(best):
                            best = every[a]
                            angle = a
                    best /= ti.sqrt(energy + floor[b])
                response_out[b, y, x] = best
                angle_out[b, y, x] = angle

    return correlate_templates


def correlate_templates(image, bank, disc, floor, response_out, angle_out) -> None:
    """Launch; overwrites."""
    launch(make_correlate_templates(float_of(image)), image, bank, disc, floor, response_out, angle_out)
