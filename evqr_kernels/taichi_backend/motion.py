"""Displacement between two images, by correlation; the formulas are in ``warp_backend/motion.py``."""

import math
from functools import cache

from evqr_kernels.operations import OPERATIONS
from evqr_kernels.operations.images import NEWTON_STEPS, taps_beside
from evqr_kernels.taichi_backend.language import (
    array,
    float_of,
    indices_of_window,
    is_alone,
    row_of_plane,
    run_at,
    ti,
)
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.transcendental import make_cos, make_sin

BLOCK = OPERATIONS["motion_correlation"].variant("taichi", "cpu").tile
"""Neighbouring shifts done together, on any device."""


@ti.func
def clamp(value, low, high):
    """Bring a value into a range."""
    return ti.min(ti.max(value, low), high)


@cache
def make_clip_rows(dtype):
    """Build the clipping; one thread per row of each image."""

    @ti.kernel
    def clip_rows(clip: dtype, images_inout: array(dtype, 4), energy_rows_out: array(dtype, 3)):
        for b, i, y in ti.ndrange(images_inout.shape[0], 2, images_inout.shape[2]):
            energy = dtype(0.0)
            before = dtype(0.0)
            for x in range(images_inout.shape[3]):
                value = images_inout[b, i, y, x]
                before += value * value
                if ti.abs(value) > clip:
                    value = clamp(value, -clip, clip)
                    images_inout[b, i, y, x] = value
                energy += value * value
            energy_rows_out[b, y, i] = energy
            energy_rows_out[b, y, 2 + i] = before

    return clip_rows


@cache
def make_judge_pairs(dtype):
    """Build the choice of what is worth while; one thread per pair."""

    @ti.kernel
    def judge_pairs(
        energy_rows: array(dtype, 3),
        quiet: array(dtype, 2),
        busy_out: array(ti.i32, 1),
        energy_out: array(dtype, 2),
    ):
        for b in range(energy_rows.shape[0]):
            first = dtype(0.0)
            second = dtype(0.0)
            before = dtype(0.0)
            for y in range(energy_rows.shape[1]):
                first += energy_rows[b, y, 0]
                second += energy_rows[b, y, 1]
                before += energy_rows[b, y, 2] + energy_rows[b, y, 3]
            energy_out[b, 0] = first
            energy_out[b, 1] = second
            busy_out[b] = ti.select(before < quiet[b, 0] or before > quiet[b, 1], 1, 0)

    return judge_pairs


@cache
def make_correlate_rows(dtype):
    """Build the correlation; one thread per row."""

    @ti.kernel
    def correlate_rows(
        images: array(dtype, 4),
        busy: array(ti.i32, 1),
        radius: ti.i32,
        found_out: array(ti.i32, 3),
        rows_out: array(dtype, 4),
    ):
        for b, y in ti.ndrange(images.shape[0], images.shape[2]):
            if busy[b] == 0:
                continue
            height = images.shape[2]
            width = images.shape[3]
            shifts = 2 * radius + 1
            columns = rows_out.shape[3]
            # of the pixels from which no block of shifts hangs out of the image, find those that are not 0;
            # then do one row of shifts after the other, whose sums stay in registers
            first = ti.min(radius, width)
            last = ti.max(first, width - columns + radius + 1)
            count = 0
            for x in range(first, last):
                if images[b, 0, y, x] != dtype(0.0):
                    found_out[b, y, count] = x
                    count += 1
            for j in range(shifts):
                other = clamp(y - radius + j, 0, height - 1)
                inside = ti.select(other == y - radius + j, count, 0)
                for k in range(columns // BLOCK):
                    total = ti.Vector.zero(dtype, BLOCK)
                    row = row_of_plane(images, b, 1, other) - radius + BLOCK * k
                    for n in range(inside):
                        x = found_out[b, y, n]
                        value = images[b, 0, y, x]
                        at = run_at(row + x)
                        for p in ti.static(range(BLOCK)):
                            total[p] += value * images[0, 0, 0, at + p]
                    to = run_at(row_of_plane(rows_out, b, y, j) + BLOCK * k)
                    for p in ti.static(range(BLOCK)):
                        rows_out[0, 0, 0, to + p] = total[p]
            for k in range(width - (last - first)):  # the others
                x = ti.select(k < first, k, last + k - first)
                value = images[b, 0, y, x]
                if value != dtype(0.0):
                    for j in range(ti.max(0, radius - y), ti.min(shifts, height + radius - y)):
                        # in blocks too: Mesa's Vulkan on a CPU ends a thread's loops after 65535 rounds
                        for i in range(columns // BLOCK):
                            for p in ti.static(range(BLOCK)):
                                shift = BLOCK * i + p
                                at = x - radius + shift
                                if shift < shifts and at >= 0 and at < width:
                                    product = value * images[b, 1, y + j - radius, at]
                                    rows_out[b, y, j, shift] = rows_out[b, y, j, shift] + product

    return correlate_rows


@cache
def make_add_rows(dtype):
    """Build the sum over rows; one thread per row of shifts."""

    @ti.kernel
    def add_rows(
        rows: array(dtype, 4),
        busy: array(ti.i32, 1),
        correlation_out: array(dtype, 3),
    ):
        for b, j in ti.ndrange(correlation_out.shape[0], correlation_out.shape[1]):
            shifts = correlation_out.shape[2]
            for k in range(rows.shape[3] // BLOCK):
                total = ti.Vector.zero(dtype, BLOCK)
                for y in range(rows.shape[1] * busy[b]):
                    at = run_at(row_of_plane(rows, b, y, j) + BLOCK * k)
                    for p in ti.static(range(BLOCK)):
                        total[p] += rows[0, 0, 0, at + p]
                for p in ti.static(range(BLOCK)):
                    if BLOCK * k + p < shifts:
                        correlation_out[b, j, BLOCK * k + p] = total[p]

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
    dtype = float_of(images_inout)
    launch(make_clip_rows(dtype), clip, images_inout, energy_rows_out)
    launch(make_judge_pairs(dtype), energy_rows_out, quiet, busy_out, energy_out)
    launch(make_correlate_rows(dtype), images_inout, busy_out, radius, found_out, rows_out)
    launch(make_add_rows(dtype), rows_out, busy_out, correlation_out)


@cache
def make_surface_peak(dtype, alone: bool):
    """Build the search for the peak; one thread per surface, a few thousand multiply-adds."""
    indices = indices_of_window(alone)
    cos, sin = make_cos(dtype), make_sin(dtype)

    @ti.kernel
    def surface_peak(
        surface: array(dtype, 3),
        half: dtype,
        reach: ti.i32,
        filled_out: array(dtype, 3),
        rows_out: array(dtype, 3),
        peak_out: array(dtype, 2),
    ):
        ti.loop_config(serialize=alone)
        for b, idle in ti.ndrange(surface.shape[0], indices):
            if idle > 0:
                continue
            size = surface.shape[1]
            middle = size // 2
            turn = dtype(math.pi) / half
            for j in range(size):
                for i in range(size):
                    filled_out[b, j, i] = surface[b, j, i]
            beside = surface[b, middle, middle - 1] + surface[b, middle, middle + 1]
            beside += surface[b, middle - 1, middle] + surface[b, middle + 1, middle]
            filled_out[b, middle, middle] = ti.max(surface[b, middle, middle], dtype(0.25) * beside)

            # three rows behind those of the surface hold the window, and its first and second derivatives
            for k in range(2 * reach + 1):
                rows_out[b, size, k] = dtype(0.5) + dtype(0.5) * cos(turn * ti.cast(k - reach, dtype))
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
            left = ti.max(column - reach - 1, 0)
            right = ti.min(column + reach + 2, size)
            top = ti.max(row - reach - 1, 0)
            bottom = ti.min(row + reach + 2, size)
            for step in range(NEWTON_STEPS + 1):
                across = ti.cast(column - middle, dtype) + x
                down = ti.cast(row - middle, dtype) + y
                if step >= 2 and across * across + down * down >= dtype(1.0):
                    # as far on the other side of the peak, between four entries
                    to_x = ti.cast(middle, dtype) + dtype(2.0) * across
                    to_y = ti.cast(middle, dtype) + dtype(2.0) * down
                    at_x = clamp(ti.cast(ti.floor(to_x), ti.i32), 0, size - 2)
                    at_y = clamp(ti.cast(ti.floor(to_y), ti.i32), 0, size - 2)
                    to_x = clamp(to_x - ti.cast(at_x, dtype), dtype(0.0), dtype(1.0))
                    to_y = clamp(to_y - ti.cast(at_y, dtype), dtype(0.0), dtype(1.0))
                    upper = surface[b, at_y, at_x] * (dtype(1.0) - to_x) + surface[b, at_y, at_x + 1] * to_x
                    lower = surface[b, at_y + 1, at_x] * (dtype(1.0) - to_x)
                    lower += surface[b, at_y + 1, at_x + 1] * to_x
                    filled_out[b, middle, middle] = upper * (dtype(1.0) - to_y) + lower * to_y
                for i in range(left, right):
                    r = ti.cast(i - column, dtype) - x
                    inside = ti.select(ti.abs(r) < half, dtype(0.5), dtype(0.0))
                    cosine = inside * cos(turn * r)
                    rows_out[b, size, i] = inside + cosine
                    rows_out[b, size + 1, i] = inside * turn * sin(turn * r)
                    rows_out[b, size + 2, i] = -turn * turn * cosine
                total = dtype(0.0)
                slope_x = dtype(0.0)
                slope_y = dtype(0.0)
                xx = dtype(0.0)
                xy = dtype(0.0)
                yy = dtype(0.0)
                for j in range(top, bottom):
                    r = ti.cast(j - row, dtype) - y
                    inside = ti.select(ti.abs(r) < half, dtype(0.5), dtype(0.0))
                    cosine = inside * cos(turn * r)
                    weight = inside + cosine
                    first = inside * turn * sin(turn * r)
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
                x = clamp(x - (yy * slope_x - xy * slope_y) / determinant, dtype(-1.0), dtype(1.0))
                y = clamp(y - (xx * slope_y - xy * slope_x) / determinant, dtype(-1.0), dtype(1.0))
            peak_out[b, 0] = ti.cast(column - middle, dtype) + x
            peak_out[b, 1] = ti.cast(row - middle, dtype) + y
            peak_out[b, 2] = height

    return surface_peak


def surface_peak(surface, half: float, filled_out, rows_out, peak_out) -> None:
    """Launch; overwrites."""
    kernel = make_surface_peak(float_of(surface), is_alone(surface))
    launch(kernel, surface, half, taps_beside(half), filled_out, rows_out, peak_out)
