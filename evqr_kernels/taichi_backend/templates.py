"""Matched filters; the formulas are in ``warp_backend/templates.py``."""

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

TERMS = 5
"""Size of the basis: a round pattern at eight angles is in it to 0.4 %."""


@cache
def make_running_squares(dtype, block: int):
    """Build the running sums of squares down columns, the first 0; one thread per block of columns."""

    @ti.kernel
    def running_squares(image: array(dtype, 3), squares_out: array(dtype, 3)):
        for b, k in ti.ndrange(image.shape[0], (image.shape[2] + block - 1) // block):
            # the last block overlaps the one before: what they share is written twice, alike
            x = ti.min(block * k, image.shape[2] - block)
            total = ti.Vector.zero(dtype, block)
            to = run_at(row_of(squares_out, b, 0) + x)
            for p in ti.static(range(block)):
                squares_out[0, 0, to + p] = total[p]
            for y in range(image.shape[1]):
                at = run_at(row_of(image, b, y) + x)
                to = run_at(row_of(squares_out, b, y + 1) + x)
                for p in ti.static(range(block)):
                    value = image[0, 0, at + p]
                    total[p] += value * value
                for p in ti.static(range(block)):
                    squares_out[0, 0, to + p] = total[p]

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
def make_correlate_basis(dtype, block: int):
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
            for k in range((width + block - 1) // block):
                x = ti.min(block * k, width - block)
                energy = ti.Vector.zero(dtype, block)
                for i in range(size):
                    first = run_at(row_of(squares, b, y + spans[i, 0]) + x + i)
                    last = run_at(row_of(squares, b, y + spans[i, 1]) + x + i)
                    for p in ti.static(range(block)):
                        energy[p] += squares[0, 0, last + p] - squares[0, 0, first + p]
                if energy.max() > floor[b]:
                    sums = ti.Matrix.zero(dtype, TERMS, block)
                    for i in range(size):
                        for j in range(spans[i, 0], spans[i, 1]):
                            at = run_at(row_of(image, b, y + j) + x + i)
                            for c in ti.static(range(TERMS)):
                                term = basis[j, i, c]
                                for p in ti.static(range(block)):
                                    sums[c, p] += term * image[0, 0, at + p]
                    for c in ti.static(range(TERMS)):
                        to = run_at(row_of_plane(sums_out, b, c, y) + x)
                        for p in ti.static(range(block)):
                            sums_out[0, 0, 0, to + p] = sums[c, p]
                to = run_at(row_of_plane(sums_out, b, TERMS, y) + x)
                for p in ti.static(range(block)):
                    sums_out[0, 0, 0, to + p] = energy[p]

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
    if 0 in response_out.shape:
        return
    dtype = float_of(image)
    block = variant("correlate_templates", is_on_cpu(image), response_out.shape[2]).tile
    launch(make_running_squares(dtype, block), image, squares_out)
    launch(make_quiet_floor(dtype, is_alone(image)), squares_out, busy, spans, quiet, floor_out)
    launch(make_correlate_basis(dtype, block), image, basis, spans, squares_out, floor_out, sums_out)
    launch(make_best_template(dtype), sums_out, mix, floor_out, least, response_out, angle_out)
