"""Displacement between two images, by correlation over a small square of shifts.

    correlation(b, j, i) = sum_{y, x} first(b, y, x) second(b, y + j - R, x + i - R),        R = radius

Images of events are mostly empty, so a row of ``first`` visits only its non-zero pixels.  Each row owns its sums; a second
pass adds the rows up, so the result does not depend on the order of the threads.
"""

from functools import cache

import warp as wp


@cache
def make_motion_correlation(dtype: type):
    """Build the two passes; launch: one thread per row, then one per shift."""

    @wp.kernel(module="unique", enable_backward=False)
    def correlate_rows(
        first: wp.array3d(dtype=dtype),
        second: wp.array3d(dtype=dtype),
        radius: int,
        rows_out: wp.array4d(dtype=dtype),
    ):
        b, y = wp.tid()
        height = first.shape[1]
        width = first.shape[2]
        shifts = 2 * radius + 1
        for j in range(shifts):
            for i in range(shifts):
                rows_out[b, y, j, i] = dtype(0.0)
        for x in range(width):
            value = first[b, y, x]
            if value != dtype(0.0):
                for j in range(wp.max(0, radius - y), wp.min(shifts, height - y + radius)):
                    for i in range(wp.max(0, radius - x), wp.min(shifts, width - x + radius)):
                        rows_out[b, y, j, i] += value * second[b, y + j - radius, x + i - radius]

    @wp.kernel(module="unique", enable_backward=False)
    def add_rows(
        rows: wp.array4d(dtype=dtype),
        correlation_out: wp.array3d(dtype=dtype),
    ):
        b, j, i = wp.tid()
        total = dtype(0.0)
        for y in range(rows.shape[1]):
            total += rows[b, y, j, i]
        correlation_out[b, j, i] = total

    return correlate_rows, add_rows
