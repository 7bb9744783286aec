"""Displacement between two images, by correlation; the formula is in ``warp_backend/motion.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, launch, ti


@cache
def make_correlate_rows(dtype):
    """Build the first pass; one thread per row."""

    @ti.kernel
    def correlate_rows(
        first: array(dtype, 3),
        second: array(dtype, 3),
        radius: ti.i32,
        rows_out: array(dtype, 4),
    ):
        for b, y in ti.ndrange(first.shape[0], first.shape[1]):
            height = first.shape[1]
            width = first.shape[2]
            shifts = 2 * radius + 1
            top = y - radius
            for j, i in ti.ndrange(shifts, shifts):
                rows_out[b, y, j, i] = dtype(0.0)
            for x in range(width):
                value = first[b, y, x]
                if value != dtype(0.0):
                    left = x - radius
                    for j in range(ti.max(0, -top), ti.min(shifts, height - top)):
                        for i in range(ti.max(0, -left), ti.min(shifts, width - left)):
                            product = value * second[b, top + j, left + i]
                            rows_out[b, y, j, i] = rows_out[b, y, j, i] + product

    return correlate_rows


@cache
def make_add_rows(dtype):
    """Build the second pass; one thread per shift."""

    @ti.kernel
    def add_rows(rows: array(dtype, 4), correlation_out: array(dtype, 3)):
        for b, j in ti.ndrange(correlation_out.shape[0], correlation_out.shape[1]):
            for i in range(correlation_out.shape[2]):
                total = dtype(0.0)
                for y in range(rows.shape[1]):
                    total += rows[b, y, j, i]
                correlation_out[b, j, i] = total

    return add_rows


def motion_correlation(first, second, radius: int, rows_out, correlation_out) -> None:
    """Launch both passes; overwrites."""
    dtype = float_of(first)
    launch(make_correlate_rows(dtype), first, second, radius, rows_out)
    launch(make_add_rows(dtype), rows_out, correlation_out)
