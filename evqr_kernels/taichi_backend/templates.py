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
    """Build the floor from the columns' sums; one thread per level of an image."""

    @ti.kernel
    def quiet_floor(
        squares: array(dtype, 3),
        busy: array(dtype, 1),
        spans: array(ti.i32, 2),
        rows: array(ti.i32, 2),
        extent: array(ti.i32, 3),
        quiet: array(dtype, 1),
        floor_out: array(dtype, 2),
    ):
        ti.loop_config(serialize=alone)
        for b, k in ti.ndrange(floor_out.shape[0], floor_out.shape[1]):
            top = 0
            for y in range(rows.shape[0]):
                if rows[y, 0] == k and rows[y, 1] == 0:
                    top = y
            size = spans.shape[0]
            total = dtype(0.0)
            if extent[b, k, 0] > 0:
                bottom = ti.min(top + extent[b, k, 0] + size, squares.shape[1]) - 1
                for x in range(ti.min(extent[b, k, 1] + size - 1, squares.shape[2])):
                    total += squares[b, bottom, x] - squares[b, top, x]
            places = 0
            for i in range(size):
                places += spans[i, 1] - spans[i, 0]
            floor_out[b, k] = quiet[k] * dtype(places) * total / ti.max(busy[b], dtype(1.0))

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
        basis: array(dtype, 4),
        spans: array(ti.i32, 2),
        rows: array(ti.i32, 2),
        extent: array(ti.i32, 3),
        squares: array(dtype, 3),
        floor: array(dtype, 2),
        first: dtype,
        sums_out: array(dtype, 4),
    ):
        for b, y in ti.ndrange(sums_out.shape[0], sums_out.shape[2]):
            width = sums_out.shape[3]
            size = spans.shape[0]
            level = rows[y, 0]
            blocks = 0
            if level >= 0:
                if rows[y, 1] < extent[b, level, 0]:
                    blocks = (extent[b, level, 1] + block - 1) // block
            for k in range(blocks):
                x = ti.min(block * k, width - block)
                energy = ti.Vector.zero(dtype, block)
                for i in range(size):
                    above = run_at(row_of(squares, b, y + spans[i, 0]) + x + i)
                    below = run_at(row_of(squares, b, y + spans[i, 1]) + x + i)
                    for p in ti.static(range(block)):
                        energy[p] += squares[0, 0, below + p] - squares[0, 0, above + p]
                quiet = floor[b, level]
                if energy.max() > quiet:
                    one = ti.Vector.zero(dtype, block)
                    for i in range(size):
                        for j in range(spans[i, 0], spans[i, 1]):
                            at = run_at(row_of(image, b, y + j) + x + i)
                            term = basis[b, j, i, 0]
                            for p in ti.static(range(block)):
                                one[p] += term * image[0, 0, at + p]
                    to = run_at(row_of_plane(sums_out, b, 0, y) + x)
                    strong = ti.Vector.zero(dtype, block)
                    for p in ti.static(range(block)):
                        sums_out[0, 0, 0, to + p] = one[p]
                        strong[p] = one[p] * one[p] - first * first * energy[p]
                    if strong.max() >= first * first * quiet:
                        sums = ti.Matrix.zero(dtype, TERMS - 1, block)
                        for i in range(size):
                            for j in range(spans[i, 0], spans[i, 1]):
                                at = run_at(row_of(image, b, y + j) + x + i)
                                for c in ti.static(range(TERMS - 1)):
                                    term = basis[b, j, i, c + 1]
                                    for p in ti.static(range(block)):
                                        sums[c, p] += term * image[0, 0, at + p]
                        for c in ti.static(range(TERMS - 1)):
                            to = run_at(row_of_plane(sums_out, b, c + 1, y) + x)
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
        mix: array(dtype, 3),
        rows: array(ti.i32, 2),
        extent: array(ti.i32, 3),
        floor: array(dtype, 2),
        first: dtype,
        least: dtype,
        response_out: array(dtype, 3),
        angle_out: array(ti.i32, 3),
    ):
        for b, y in ti.ndrange(response_out.shape[0], response_out.shape[1]):
            level = rows[y, 0]
            width = 0
            quiet = dtype(0.0)
            if level >= 0:
                quiet = floor[b, level]
                if rows[y, 1] < extent[b, level, 0]:
                    width = extent[b, level, 1]
            for x in range(width):
                best = dtype(0.0)
                angle = 0
                energy = sums[b, TERMS, y, x]
                s0 = sums[b, 0, y, x]
                if energy > quiet and s0 * s0 >= first * first * (energy + quiet):
                    here = ti.Vector([sums[b, c, y, x] for c in range(TERMS)])
                    weakest = least * least * (energy + quiet)
                    if here.dot(here) >= weakest:  # no template answers more than this
                        for a in range(mix.shape[1]):
                            value = dtype(0.0)
                            for c in ti.static(range(TERMS)):
                                value += mix[b, a, c] * here[c]
                            if ti.abs(value) > ti.abs(best):
                                best = value
                                angle = a
                        if best * best >= weakest:
                            best /= ti.sqrt(energy + quiet)
                        else:
                            best = dtype(0.0)
                            angle = 0
                response_out[b, y, x] = best
                angle_out[b, y, x] = angle

    return best_template


def correlate_templates(
    image, busy, basis, mix, spans, rows, extent, quiet, first: float, least: float, squares_out, floor_out,
    sums_out, response_out, angle_out,
) -> None:  # fmt: skip
    """Launch the running sums, the floor, the correlation and the choice; overwrites within the extent."""
    if 0 in response_out.shape or 0 in floor_out.shape:
        return
    dtype, alone = float_of(image), is_alone(image)
    block = variant("correlate_templates", is_on_cpu(image), response_out.shape[2]).tile
    launch(make_running_squares(dtype, block), image, squares_out)
    launch(make_quiet_floor(dtype, alone), squares_out, busy, spans, rows, extent, quiet, floor_out)
    correlate = make_correlate_basis(dtype, block)
    launch(correlate, image, basis, spans, rows, extent, squares_out, floor_out, first, sums_out)
    choose = make_best_template(dtype)
    launch(choose, sums_out, mix, rows, extent, floor_out, first, least, response_out, angle_out)
