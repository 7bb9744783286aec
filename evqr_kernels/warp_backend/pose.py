"""Moments of an image seen through a pose: all that stage one needs of the data.

A pose is a homography P (row-major, 9 numbers) from code coordinates (u, v) to image pixels.  For points s with code
coordinates ``points[s]`` and a table of C model functions known beforehand:

    e_s        = image(P(points[s]))                       bilinear, 0 outside the image
    moments[c] = sum_s e_s table[s, c],  c < C;            moments[C] = sum_s e_s^2

The Gauss-Newton matrix of an inverse-compositional step does not depend on the image, so these C + 1 numbers are the whole
data term.  Points are cut into chunks with one owner each, and added up in a second pass: no atomics, deterministic.
"""

from functools import cache

import warp as wp

CHUNK = 512


@cache
def make_bilinear(dtype: type):
    """Build the bilinear look-up used by every kernel that samples an image."""

    @wp.func
    def bilinear(image: wp.array3d(dtype=dtype), b: int, x: dtype, y: dtype) -> dtype:
        value = dtype(0.0)
        width = image.shape[2]
        height = image.shape[1]
        if x >= dtype(0.0) and y >= dtype(0.0) and x < dtype(width - 1) and y < dtype(height - 1):
            column = int(x)
            row = int(y)
            fx = x - dtype(column)
            fy = y - dtype(row)
            top = image[b, row, column] + fx * (image[b, row, column + 1] - image[b, row, column])
            bottom = image[b, row + 1, column] + fx * (image[b, row + 1, column + 1] - image[b, row + 1, column])
            value = top + fy * (bottom - top)
        return value

    return bilinear


@cache
def make_sample_moments(dtype: type, columns: int):
    """Build the two passes for a table of ``columns`` functions; launch: a thread per (pose, chunk), then per (pose, column)."""
    vec_columns = wp.types.vector(length=columns, dtype=dtype)
    bilinear = make_bilinear(dtype)

    @wp.kernel(module="unique", enable_backward=False)
    def moments_of_chunks(
        image: wp.array3d(dtype=dtype),
        image_idx: wp.array(dtype=wp.int32),
        pose: wp.array2d(dtype=dtype),
        active: wp.array(dtype=wp.int32),
        points: wp.array2d(dtype=dtype),
        table: wp.array(dtype=vec_columns),
        chunks_out: wp.array3d(dtype=dtype),
    ):
        h, chunk = wp.tid()
        if active[h] == 0:
            return
        b = image_idx[h]
        p0 = pose[h, 0]
        p1 = pose[h, 1]
        p2 = pose[h, 2]
        p3 = pose[h, 3]
        p4 = pose[h, 4]
        p5 = pose[h, 5]
        p6 = pose[h, 6]
        p7 = pose[h, 7]
        p8 = pose[h, 8]
        moments = vec_columns()
        energy = dtype(0.0)
        first = chunk * CHUNK
        for s in range(first, wp.min(first + CHUNK, points.shape[0])):
            u = points[s, 0]
            v = points[s, 1]
            inverse_depth = dtype(1.0) / (p6 * u + p7 * v + p8)
            e = bilinear(image, b, (p0 * u + p1 * v + p2) * inverse_depth, (p3 * u + p4 * v + p5) * inverse_depth)
            if e != dtype(0.0):
                moments += e * table[s]
                energy += e * e
        for c in range(wp.static(columns)):
            chunks_out[h, chunk, c] = moments[c]
        chunks_out[h, chunk, columns] = energy

    @wp.kernel(module="unique", enable_backward=False)
    def add_chunks(
        chunks: wp.array3d(dtype=dtype),
        active: wp.array(dtype=wp.int32),
        count: int,
        moments_out: wp.array2d(dtype=dtype),
    ):
        h, c = wp.tid()
        if active[h] == 0:
            return
        total = dtype(0.0)
        for k in range(count):
            total += chunks[h, k, c]
        moments_out[h, c] = total

    return moments_of_chunks, add_chunks
