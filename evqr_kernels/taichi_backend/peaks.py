"""Peaks over the levels of a pyramid, and triples of them; see ``warp_backend/peaks.py``."""

import math
from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, indices_of_window, is_alone, ti
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.transcendental import make_atan2, make_log

PEAK = 5
"""Entries of a peak."""

QUARTER = 0.5 * math.pi


@cache
def make_local_maxima(dtype):
    """Build the search on one level; one thread per row."""

    @ti.func
    def vertex(before, here, after):
        curvature = ti.max(dtype(2.0) * here - before - after, dtype(1.0e-9))
        return ti.max(dtype(-0.5), ti.min(dtype(0.5) * (after - before) / curvature, dtype(0.5)))

    @ti.kernel
    def local_maxima(
        response: array(dtype, 3),
        angle: array(ti.i32, 3),
        rows: array(ti.i32, 2),
        extent: array(ti.i32, 3),
        levels: array(dtype, 2),
        origin: array(dtype, 2),
        least: dtype,
        turn: dtype,
        maxima_out: array(dtype, 4),
    ):
        for b, y in ti.ndrange(maxima_out.shape[0], maxima_out.shape[1]):
            most = maxima_out.shape[2]
            for k in range(most):
                for c in ti.static(range(PEAK)):
                    maxima_out[b, y, k, c] = dtype(0.0)
            level = rows[y, 0]
            row = rows[y, 1]
            end = 1
            cell = dtype(0.0)
            size = dtype(0.0)
            if level >= 0:
                cell = levels[level, 0]
                size = levels[level, 1]
                if row > 0 and row < extent[b, level, 0] - 1:
                    end = extent[b, level, 1] - 1
            count = 0
            for x in range(1, end):
                here = ti.abs(response[b, y, x])
                if here > least:
                    sign = ti.select(response[b, y, x] > dtype(0.0), dtype(1.0), dtype(-1.0))
                    top = 1
                    for j in range(3):
                        for i in range(3):
                            if sign * response[b, y + j - 1, x + i - 1] > here:
                                top = 0
                    if top == 1:
                        if count == most:  # the weakest makes room, if it is weaker
                            weakest = 0
                            for k in range(1, most):
                                if ti.abs(maxima_out[b, y, k, 0]) <= ti.abs(maxima_out[b, y, weakest, 0]):
                                    weakest = k
                            if ti.abs(maxima_out[b, y, weakest, 0]) < here:
                                for k in range(weakest, most - 1):
                                    for c in ti.static(range(PEAK)):
                                        maxima_out[b, y, k, c] = maxima_out[b, y, k + 1, c]
                                count -= 1
                        if count < most:
                            left = sign * response[b, y, x - 1]
                            right = sign * response[b, y, x + 1]
                            above = sign * response[b, y - 1, x]
                            below = sign * response[b, y + 1, x]
                            maxima_out[b, y, count, 0] = response[b, y, x]
                            across = dtype(x) + vertex(left, here, right) + dtype(0.5)
                            down = dtype(row) + vertex(above, here, below) + dtype(0.5)
                            maxima_out[b, y, count, 1] = origin[b, 0] + across * cell
                            maxima_out[b, y, count, 2] = origin[b, 1] + down * cell
                            maxima_out[b, y, count, 3] = size
                            maxima_out[b, y, count, 4] = dtype(angle[b, y, x]) * turn
                            count += 1

    return local_maxima


def local_maxima(
    response, angle, rows, extent, levels, origin, least: float, turn: float, maxima_out
) -> None:
    """Launch; overwrites."""
    kernel = make_local_maxima(float_of(response))
    launch(kernel, response, angle, rows, extent, levels, origin, least, turn, maxima_out)


@cache
def make_merge_maxima(dtype, alone: bool):
    """Build the merging; one thread per window, which has a few hundred maxima to look through."""
    indices = indices_of_window(alone)
    log = make_log(dtype)

    @ti.kernel
    def merge_maxima(
        maxima: array(dtype, 3),
        apart: dtype,
        log_ratio: dtype,
        strength_out: array(dtype, 2),
        index_out: array(ti.i32, 2),
        peaks_out: array(dtype, 3),
    ):
        ti.loop_config(serialize=alone)
        for b, idle in ti.ndrange(maxima.shape[0], indices):
            if idle > 0:
                continue
            count = 0
            for k in range(maxima.shape[1]):
                if maxima[b, k, 0] != dtype(0.0):
                    strength_out[b, count] = ti.abs(maxima[b, k, 0])
                    index_out[b, count] = k
                    count += 1
            for place in range(peaks_out.shape[1]):
                best = -1
                strongest = dtype(0.0)
                for k in range(count):
                    if strength_out[b, k] > strongest:
                        strongest = strength_out[b, k]
                        best = k
                for c in ti.static(range(PEAK)):
                    peaks_out[b, place, c] = dtype(0.0)
                if best >= 0:
                    kept = index_out[b, best]
                    for c in ti.static(range(PEAK)):
                        peaks_out[b, place, c] = maxima[b, kept, c]
                    reach = apart * maxima[b, kept, 3]
                    for k in range(count):
                        other = index_out[b, k]
                        dx = maxima[b, other, 1] - maxima[b, kept, 1]
                        dy = maxima[b, other, 2] - maxima[b, kept, 2]
                        if dx * dx + dy * dy < reach * reach:
                            ratio = ti.abs(log(maxima[b, other, 3] / maxima[b, kept, 3]))
                            if ratio < log_ratio and maxima[b, other, 0] * maxima[b, kept, 0] > dtype(0.0):
                                strength_out[b, k] = dtype(0.0)
                    strength_out[b, best] = dtype(0.0)

    return merge_maxima


def merge_maxima(maxima, apart: float, log_ratio: float, strength_out, index_out, peaks_out) -> None:
    """Launch; overwrites."""
    kernel = make_merge_maxima(float_of(maxima), is_alone(maxima))
    launch(kernel, maxima, apart, log_ratio, strength_out, index_out, peaks_out)


@cache
def make_match_corners(dtype):
    """Build the matching; one thread per peak, as the corner."""
    log = make_log(dtype)
    atan2 = make_atan2(dtype)

    @ti.func
    def off(angle, period: ti.template()):
        """Distance of an angle from the nearest multiple of a period."""
        return ti.abs(angle - dtype(period) * ti.floor(angle * dtype(1.0 / period) + dtype(0.5)))

    @ti.kernel
    def match_corners(
        peaks: array(dtype, 3),
        tolerances: array(dtype, 1),
        ends_out: array(ti.i32, 3),
        legs_out: array(dtype, 4),
        triples_out: array(dtype, 4),
    ):
        for b, i in ti.ndrange(triples_out.shape[0], triples_out.shape[1]):
            most_kept = triples_out.shape[2]
            for place in range(most_kept):
                for c in ti.static(range(4)):
                    triples_out[b, i, place, c] = dtype(0.0)
            leg_tolerance = tolerances[0]
            size_tolerance = tolerances[1]
            angle_tolerance = tolerances[2]
            fewest = tolerances[3]
            most = tolerances[4]
            strength = peaks[b, i, 0]
            log_size = log(ti.max(peaks[b, i, 3], dtype(1.0e-9)))
            count = 0
            for j in range(peaks.shape[1]):
                if j != i and strength * peaks[b, j, 0] > dtype(0.0):
                    dx = peaks[b, j, 1] - peaks[b, i, 1]
                    dy = peaks[b, j, 2] - peaks[b, i, 2]
                    direction = atan2(dy, dx)
                    log_leg = dtype(0.5) * log(ti.max(dx * dx + dy * dy, dtype(1.0e-18)))
                    other = log(peaks[b, j, 3])
                    if (
                        off(direction - peaks[b, i, 4], QUARTER) < angle_tolerance
                        and off(direction - peaks[b, j, 4], QUARTER) < angle_tolerance
                        and ti.abs(log_size - other) < dtype(2.0) * size_tolerance
                        and log_leg > ti.min(log_size, other) + fewest - dtype(2.0) * size_tolerance
                    ):
                        ends_out[b, i, count] = j
                        legs_out[b, i, count, 0] = direction
                        legs_out[b, i, count, 1] = log_leg
                        legs_out[b, i, count, 2] = other
                        count += 1
            for j in range(count):
                for k in range(count):
                    across = legs_out[b, i, k, 0] - legs_out[b, i, j, 0] - dtype(QUARTER)
                    if (
                        off(across, 4.0 * QUARTER) < angle_tolerance
                        and ti.abs(legs_out[b, i, j, 1] - legs_out[b, i, k, 1]) < leg_tolerance
                    ):
                        leg = dtype(0.5) * (legs_out[b, i, j, 1] + legs_out[b, i, k, 1])
                        sizes = log_size + legs_out[b, i, j, 2] + legs_out[b, i, k, 2]
                        modules = leg - sizes / dtype(3.0)
                        if modules > fewest - size_tolerance and modules < most + size_tolerance:
                            response = ti.abs(strength)
                            response += ti.abs(peaks[b, ends_out[b, i, j], 0])
                            response += ti.abs(peaks[b, ends_out[b, i, k], 0])
                            # among those found so far, best first
                            place = most_kept
                            while place > 0 and triples_out[b, i, ti.max(place - 1, 0), 0] < response:
                                place -= 1
                                if place + 1 < most_kept:
                                    for c in ti.static(range(4)):
                                        triples_out[b, i, place + 1, c] = triples_out[b, i, place, c]
                            if place < most_kept:
                                triples_out[b, i, place, 0] = response
                                triples_out[b, i, place, 1] = dtype(ends_out[b, i, j])
                                triples_out[b, i, place, 2] = dtype(ends_out[b, i, k])
                                triples_out[b, i, place, 3] = modules

    return match_corners


def match_corners(peaks, tolerances, ends_out, legs_out, triples_out) -> None:
    """Launch; overwrites."""
    launch(make_match_corners(float_of(peaks)), peaks, tolerances, ends_out, legs_out, triples_out)
