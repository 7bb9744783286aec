"""Places of highest response, over the levels of a pyramid, and the codes that three of them could belong to.

A peak is a row (response, x, y, size, angle): response with its sign, 0 in rows that hold none; x and y in
px; the size that its level stands for; and the angle of the template [rad].

``local_maxima`` of the levels of a pyramid, one below the other as for `correlate_templates`, within each
window's part of them: interior entries of magnitude above ``least`` that none of their eight
neighbours exceeds in the direction of its own sign, so that a strong trough hides no peak beside it; position
by the parabolas through the neighbours, of each row the strongest.

``merge_maxima``: the strongest over all levels, best first; a peak is left out that a stronger one of the
same sign has within ``apart`` times its size, and within ``|log|`` of the ratio of their sizes.

``match_corners``: for each peak i as the corner of a right angle, with a peak j along u and k along v, the
triples of largest total response: (response, j, k, log modules).  What must agree, to tolerances: angles of
legs and peaks, the two legs with each other, and the sizes; the legs' length over the mean size is the number
of modules between them, whose logarithm lies in a given range.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, variant, vector

PEAK = 5
"""Entries of a peak."""


@cache
def make_local_maxima(dtype: type, block: int) -> wp.Kernel:
    """Build the search on one level; launch: one thread per row."""
    vec_block = vector(block, dtype)

    @wp.func
    def vertex(before: dtype, here: dtype, after: dtype):
        curvature = wp.max(dtype(2.0) * here - before - after, dtype(1.0e-9))
        return wp.clamp(dtype(0.5) * (after - before) / curvature, dtype(-0.5), dtype(0.5))

    @wp.kernel(module=module_of(f"peaks_{block}", dtype))
    def local_maxima(
        response: wp.array3d(dtype=dtype),
        blocks: wp.array3d(dtype=vec_block),
        angle: wp.array3d(dtype=wp.int32),
        rows: wp.array2d(dtype=wp.int32),
        extent: wp.array3d(dtype=wp.int32),
        levels: wp.array2d(dtype=dtype),
        origin: wp.array2d(dtype=dtype),
        least: dtype,
        turn: dtype,
        maxima_out: wp.array4d(dtype=dtype),
    ):
        b, y = wp.tid()
        most = maxima_out.shape[2]
        for k in range(most):
            for c in range(wp.static(PEAK)):
                maxima_out[b, y, k, c] = dtype(0.0)
        level = rows[y, 0]
        row = rows[y, 1]
        if level < 0 or row <= 0 or row >= extent[b, level, 0] - 1:
            return
        cell = levels[level, 0]
        size = levels[level, 1]
        count = wp.int32(0)
        width = extent[b, level, 1]
        x = wp.int32(1)
        while x < width - 1:
            here = wp.abs(response[b, y, x])
            if wp.static(block > 1):
                if here == dtype(0.0) and x + block <= width:
                    entries = blocks[b, y, x]
                    if wp.dot(entries, entries) == dtype(0.0):
                        x += block
                        continue
            if here > least:
                sign = wp.sign(response[b, y, x])
                top = wp.int32(1)
                for j in range(3):
                    for i in range(3):
                        if sign * response[b, y + j - 1, x + i - 1] > here:
                            top = 0
                if top == 1:
                    if count == most:  # the weakest makes room, if it is weaker
                        weakest = wp.int32(0)
                        for k in range(1, most):
                            if wp.abs(maxima_out[b, y, k, 0]) <= wp.abs(maxima_out[b, y, weakest, 0]):
                                weakest = k
                        if wp.abs(maxima_out[b, y, weakest, 0]) < here:
                            for k in range(weakest, most - 1):
                                for c in range(wp.static(PEAK)):
                                    maxima_out[b, y, k, c] = maxima_out[b, y, k + 1, c]
                            count -= 1
                    if count < most:
                        left = sign * response[b, y, x - 1]
                        right = sign * response[b, y, x + 1]
                        above = sign * response[b, y - 1, x]
                        below = sign * response[b, y + 1, x]
                        half = dtype(0.5)
                        maxima_out[b, y, count, 0] = response[b, y, x]
                        across = dtype(x) + vertex(left, here, right) + half
                        down = dtype(row) + vertex(above, here, below) + half
                        maxima_out[b, y, count, 1] = origin[b, 0] + across * cell
                        maxima_out[b, y, count, 2] = origin[b, 1] + down * cell
                        maxima_out[b, y, count, 3] = size
                        maxima_out[b, y, count, 4] = dtype(angle[b, y, x]) * turn
                        count += 1
            x += 1

    return local_maxima


def local_maxima(
    response, angle, rows, extent, levels, origin, least: float, turn: float, maxima_out
) -> None:
    """Launch; overwrites."""
    if not response.size:
        return
    block = variant("local_maxima", response.device).tile
    launch(
        make_local_maxima(response.dtype, block),
        response.shape[:2],
        inputs=[
            response, neighbours(response, block), angle, rows, extent, levels, origin, least, turn,
        ],
        outputs=[maxima_out],
        device=response.device,
    )  # fmt: skip


@cache
def make_merge_maxima(dtype: type) -> wp.Kernel:
    """Build the merging; launch: one thread per window, which has a few hundred maxima to look through."""

    @wp.kernel(module=module_of("peaks", dtype))
    def merge_maxima(
        maxima: wp.array3d(dtype=dtype),
        apart: dtype,
        log_ratio: dtype,
        strength_out: wp.array2d(dtype=dtype),
        index_out: wp.array2d(dtype=wp.int32),
        peaks_out: wp.array3d(dtype=dtype),
    ):
        b = wp.tid()
        count = wp.int32(0)
        for k in range(maxima.shape[1]):
            if maxima[b, k, 0] != dtype(0.0):
                strength_out[b, count] = wp.abs(maxima[b, k, 0])
                index_out[b, count] = k
                count += 1
        for place in range(peaks_out.shape[1]):
            best = wp.int32(-1)
            strongest = dtype(0.0)
            for k in range(count):
                if strength_out[b, k] > strongest:
                    strongest = strength_out[b, k]
                    best = k
            for c in range(wp.static(PEAK)):
                peaks_out[b, place, c] = dtype(0.0)
            if best >= 0:
                kept = index_out[b, best]
                for c in range(wp.static(PEAK)):
                    peaks_out[b, place, c] = maxima[b, kept, c]
                reach = apart * maxima[b, kept, 3]
                for k in range(count):
                    other = index_out[b, k]
                    dx = maxima[b, other, 1] - maxima[b, kept, 1]
                    dy = maxima[b, other, 2] - maxima[b, kept, 2]
                    if dx * dx + dy * dy < reach * reach:
                        ratio = wp.abs(wp.log(maxima[b, other, 3] / maxima[b, kept, 3]))
                        if ratio < log_ratio and maxima[b, other, 0] * maxima[b, kept, 0] > dtype(0.0):
                            strength_out[b, k] = dtype(0.0)
                strength_out[b, best] = dtype(0.0)

    return merge_maxima


def merge_maxima(maxima, apart: float, log_ratio: float, strength_out, index_out, peaks_out) -> None:
    """Launch; overwrites."""
    launch(
        make_merge_maxima(maxima.dtype),
        maxima.shape[0],
        inputs=[maxima, apart, log_ratio],
        outputs=[strength_out, index_out, peaks_out],
        device=maxima.device,
    )


@cache
def make_match_corners(dtype: type) -> wp.Kernel:
    """Build the matching; launch: one thread per peak, as the corner."""

    @wp.func
    def off(angle: dtype, period: dtype) -> dtype:
        """Distance of an angle from the nearest multiple of a period."""
        return wp.abs(angle - period * wp.round(angle / period))

    @wp.kernel(module=module_of("peaks", dtype))
    def match_corners(
        peaks: wp.array3d(dtype=dtype),
        tolerances: wp.array(dtype=dtype),
        ends_out: wp.array3d(dtype=wp.int32),
        legs_out: wp.array4d(dtype=dtype),
        triples_out: wp.array4d(dtype=dtype),
    ):
        b, i = wp.tid()
        for place in range(triples_out.shape[2]):
            for c in range(4):
                triples_out[b, i, place, c] = dtype(0.0)
        if peaks[b, i, 0] == dtype(0.0):
            return
        quarter = dtype(0.5 * wp.pi)
        leg_tolerance = tolerances[0]
        size_tolerance = tolerances[1]
        angle_tolerance = tolerances[2]
        fewest = tolerances[3]
        most = tolerances[4]
        log_size = wp.log(peaks[b, i, 3])
        count = wp.int32(0)
        size = peaks[b, i, 3]
        size_ratio = wp.exp(dtype(2.0) * size_tolerance)
        least_leg = wp.exp(fewest - dtype(2.0) * size_tolerance)
        for j in range(peaks.shape[1]):
            if j != i and peaks[b, i, 0] * peaks[b, j, 0] > dtype(0.0):
                other = peaks[b, j, 3]
                smaller = wp.min(size, other)
                dx = peaks[b, j, 1] - peaks[b, i, 1]
                dy = peaks[b, j, 2] - peaks[b, i, 2]
                square = dx * dx + dy * dy
                leg = least_leg * smaller
                if wp.max(size, other) < size_ratio * smaller and square > leg * leg:
                    direction = wp.atan2(dy, dx)
                    if (
                        off(direction - peaks[b, i, 4], quarter) < angle_tolerance
                        and off(direction - peaks[b, j, 4], quarter) < angle_tolerance
                    ):
                        ends_out[b, i, count] = j
                        legs_out[b, i, count, 0] = direction
                        legs_out[b, i, count, 1] = dtype(0.5) * wp.log(square)
                        legs_out[b, i, count, 2] = wp.log(other)
                        count += 1
        for j in range(count):
            for k in range(count):
                across = legs_out[b, i, k, 0] - legs_out[b, i, j, 0] - quarter
                if (
                    off(across, dtype(4.0) * quarter) < angle_tolerance
                    and wp.abs(legs_out[b, i, j, 1] - legs_out[b, i, k, 1]) < leg_tolerance
                ):
                    modules = dtype(0.5) * (legs_out[b, i, j, 1] + legs_out[b, i, k, 1]) - (
                        log_size + legs_out[b, i, j, 2] + legs_out[b, i, k, 2]
                    ) / dtype(3.0)
                    if modules > fewest - size_tolerance and modules < most + size_tolerance:
                        response = (
                            wp.abs(peaks[b, i, 0])
                            + wp.abs(peaks[b, ends_out[b, i, j], 0])
                            + wp.abs(peaks[b, ends_out[b, i, k], 0])
                        )
                        # among those found so far, best first
                        place = triples_out.shape[2]
                        while place > 0 and triples_out[b, i, wp.max(place - 1, 0), 0] < response:
                            place -= 1
                            if place + 1 < triples_out.shape[2]:
                                for c in range(4):
                                    triples_out[b, i, place + 1, c] = triples_out[b, i, place, c]
                        if place < triples_out.shape[2]:
                            triples_out[b, i, place, 0] = response
                            triples_out[b, i, place, 1] = dtype(ends_out[b, i, j])
                            triples_out[b, i, place, 2] = dtype(ends_out[b, i, k])
                            triples_out[b, i, place, 3] = modules

    return match_corners


def match_corners(peaks, tolerances, ends_out, legs_out, triples_out) -> None:
    """Launch; overwrites."""
    launch(
        make_match_corners(peaks.dtype),
        peaks.shape[:2],
        inputs=[peaks, tolerances],
        outputs=[ends_out, legs_out, triples_out],
        device=peaks.device,
    )
