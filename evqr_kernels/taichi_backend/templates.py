"""Matched filters; the formulas are in ``warp_backend/templates.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, is_alone, ti
from evqr_kernels.taichi_backend.launches import launch

TERMS = 5
"""Size of the basis: a finder pattern at eight angles is in it to 0.4 %."""

BLOCK = 4
"""Neighbouring pixels of which one thread makes the responses, sharing each template load."""


@cache
def make_running_squares(dtype):
    """Build the running sums of squares down columns, the first 0; one thread per column."""

    @ti.kernel
    def running_squares(image: array(dtype, 3), squares_out: array(dtype, 3)):
        for b, x in ti.ndrange(image.shape[0], image.shape[2]):
            total = dtype(0.0)
            squares_out[b, 0, x] = total
            for y in range(image.shape[1]):
                value = image[b, y, x]
                total += value * value
                squares_out[b, y + 1, x] = total

    return running_squares


@cache
def make_quiet_floor(dtype, alone: bool):
    """Build the floor from the columns' sums; one thread per image."""

    @ti.kernel
    def quiet_floor(
        squares: array(dtype, 3),
        busy: array(dtype, 1),
        spans: array(ti.i32, 2),
        quiet: dtype,
        floor_out: array(dtype, 1),
    ):
        ti.loop_config(serialize=alone)
        for b in range(floor_out.shape[0]):
            total = dtype(0.0)
            for x in range(squares.shape[2]):
                total += squares[b, squares.shape[1] - 1, x]
            places = 0
            for i in range(spans.shape[0]):
                places += spans[i, 1] - spans[i, 0]
            floor_out[b] = quiet * dtype(places) * total / ti.max(busy[b], dtype(1.0))

    return quiet_floor


@cache
def make_correlate_basis(dtype):
    """Build the correlation with the basis; one thread per row of blocks.

    The last block of a row ends with the row and may overlap the one before: those pixels are computed twice,
    with the same result.
    """

    @ti.kernel
    def correlate_basis(
        image: array(dtype, 3),
        basis: array(dtype, 3),
        spans: array(ti.i32, 2),
        squares: array(dtype, 3),
        floor: array(dtype, 1),
        sums_out: array(dtype, 4),
    ):
        for b, y in ti.ndrange(sums_out.shape[0], sums_out.shape[2]):
            width = sums_out.shape[3]
            size = spans.shape[0]
            for k in range((width + BLOCK - 1) // BLOCK):
                x = ti.min(BLOCK * k, width - BLOCK)
                energy = ti.Vector.zero(dtype, BLOCK)
                for i in range(size):
                    first = y + spans[i, 0]
                    last = y + spans[i, 1]
                    for p in ti.static(range(BLOCK)):
                        energy[p] += squares[b, last, x + i + p] - squares[b, first, x + i + p]
                if energy.max() > floor[b]:
                    sums = ti.Matrix.zero(dtype, TERMS, BLOCK)
                    for j in range(size):
                        for i in range(size):
                            for p in ti.static(range(BLOCK)):
                                v = image[b, y + j, x + i + p]
                                for c in ti.static(range(TERMS)):
                                    sums[c, p] += basis[j, i, c] * v
                    for c, p in ti.static(ti.ndrange(TERMS, BLOCK)):
                        sums_out[b, c, y, x + p] = sums[c, p]
                for p in ti.static(range(BLOCK)):
                    sums_out[b, TERMS, y, x + p] = energy[p]

    return correlate_basis


@cache
def make_best_template(dtype):
    """Build the choice of the best template; one thread per row."""

    @ti.kernel
    def best_template(
        sums: array(dtype, 4),
        mix: array(dtype, 2),
        floor: array(dtype, 1),
        least: dtype,
        response_out: array(dtype, 3),
        angle_out: array(ti.i32, 3),
    ):
        for b, y in ti.ndrange(response_out.shape[0], response_out.shape[1]):
            for x in range(response_out.shape[2]):
                best = dtype(0.0)
                angle = 0
                energy = sums[b, TERMS, y, x]
                if energy > floor[b]:
                    here = ti.Vector([sums[b, c, y, x] for c in range(TERMS)])
                    weakest = least * least * (energy + floor[b])
                    if here.dot(here) >= weakest:  # no template answers more than this
                        for a in range(mix.shape[0]):
                            value = dtype(0.0)
                            for c in ti.static(range(TERMS)):
                                value += mix[a, c] * here[c]
                            if ti.abs(value) > ti.abs(best):
                                best = value
                                angle = a
                        if best * best >= weakest:
                            best /= ti.sqrt(energy + floor[b])
                        else:
                            best = dtype(0.0)
                            angle = 0
                response_out[b, y, x] = best
                angle_out[b, y, x] = angle

    return best_template


def correlate_templates(
    image, busy, basis, mix, spans, quiet: float, least: float, squares_out, floor_out, sums_out,
    response_out, angle_out,
) -> None:  # fmt: skip
    """Launch the running sums, the floor, the correlation and the choice; overwrites."""
    dtype = float_of(image)
    launch(make_running_squares(dtype), image, squares_out)
    launch(make_quiet_floor(dtype, is_alone(image)), squares_out, busy, spans, quiet, floor_out)
    launch(make_correlate_basis(dtype), image, basis, spans, squares_out, floor_out, sums_out)
    launch(make_best_template(dtype), sums_out, mix, floor_out, least, response_out, angle_out)
