"""Displacement between two images, by correlation over a small square of shifts.

    correlation(b, j, i) = sum_{y, x} first(b, y, x) second(b, y + j - R, x + i - R),        R = radius

Images of events are mostly empty, so a row of ``first`` visits only its non-zero pixels.  Each row owns its
sums; a second pass adds the rows up, so the result does not depend on the order of the threads.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import module_of, neighbours, vector

BLOCK = 16
"""Neighbouring shifts done together."""


@cache
def make_correlate_rows(dtype: type) -> wp.Kernel:
    """Build the first pass; launch: one thread per row.  ``.._blocks``: `neighbours` of the same array."""
    vec_block = vector(BLOCK, dtype)

    @wp.kernel(module=module_of("motion", dtype))
    def correlate_rows(
        first: wp.array3d(dtype=dtype),
        second: wp.array3d(dtype=dtype),
        second_blocks: wp.array3d(dtype=vec_block),
        radius: int,
        rows_out: wp.array4d(dtype=dtype),
        row_blocks_out: wp.array4d(dtype=vec_block),
    ):
        b, y = wp.tid()
        height = first.shape[1]
        width = first.shape[2]
        shifts = 2 * radius + 1
        columns = rows_out.shape[3]
        whole = columns - columns % BLOCK
        for j in range(shifts):
            for i in range(columns):
                rows_out[b, y, j, i] = dtype(0.0)
        for x in range(width):
            value = first[b, y, x]
            if value != dtype(0.0):
                left = x - radius
                top = y - radius
                begin = wp.int32(0)
                # where all shifts lie inside the image: blocks of them, and then the few that are left
                if left >= 0 and left + wp.max(columns, shifts) <= width:
                    begin = whole
                    for j in range(wp.max(0, -top), wp.min(shifts, height - top)):
                        for i in range(0, whole, BLOCK):
                            row_blocks_out[b, y, j, i] += value * second_blocks[b, top + j, left + i]
                if begin < shifts:
                    for j in range(wp.max(0, -top), wp.min(shifts, height - top)):
                        for i in range(wp.max(begin, -left), wp.min(shifts, width - left)):
                            rows_out[b, y, j, i] += value * second[b, top + j, left + i]

    return correlate_rows


@cache
def make_add_rows(dtype: type) -> wp.Kernel:
    """Build the second pass; launch: one thread per row of shifts."""

    @wp.kernel(module=module_of("motion", dtype))
    def add_rows(
        rows: wp.array4d(dtype=dtype),
        correlation_out: wp.array3d(dtype=dtype),
    ):
        b, j, i = wp.tid()
        total = dtype(0.0)
        for y in range(rows.shape[1]):
            total += rows[b, y, j, i]
        correlation_out[b, j, i] = total

    return add_rows


def motion_correlation(first, second, radius: int, rows_out, correlation_out) -> None:
    """Launch both passes; overwrites."""
    dtype, device = first.dtype, first.device
    wp.launch(
        make_correlate_rows(dtype),
        first.shape[:2],
        inputs=[first, second, neighbours(second, BLOCK), radius],
        outputs=[rows_out, neighbours(rows_out, BLOCK)],
        device=device,
    )
    wp.launch(
        make_add_rows(dtype),
        correlation_out.shape,
        inputs=[rows_out],
        outputs=[correlation_out],
        device=device,
    )
