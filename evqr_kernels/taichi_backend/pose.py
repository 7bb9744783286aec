"""Moments of an image seen through a pose; the formulas are in ``warp_backend/pose.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, row_of, run_at, ti
from evqr_kernels.taichi_backend.launches import launch


@cache
def make_project(dtype):
    """Build the function that maps code coordinates to image pixels."""

    @ti.func
    def project(pose: ti.template(), h, u, v):
        inverse_depth = dtype(1.0) / (pose[h, 6] * u + pose[h, 7] * v + pose[h, 8])
        x = (pose[h, 0] * u + pose[h, 1] * v + pose[h, 2]) * inverse_depth
        y = (pose[h, 3] * u + pose[h, 4] * v + pose[h, 5]) * inverse_depth
        return x, y

    return project


@cache
def make_inside(dtype):
    """Build the test whether the four pixels around a position are in the image; also false for NaN."""

    @ti.func
    def inside(x, y, height, width):
        return x >= dtype(0.0) and y >= dtype(0.0) and x < dtype(width - 1) and y < dtype(height - 1)

    return inside


@cache
def make_bilinear_in_part(dtype):
    """Build the bilinear look-up in some rows and columns, 0 beyond them."""
    inside = make_inside(dtype)

    @ti.func
    def bilinear_in_part(image: ti.template(), b, top, height, width, x, y):
        value = dtype(0.0)
        if inside(x, y, height, width):
            column = int(x)
            row = int(y)
            fy = y - dtype(row)
            at = run_at(row_of(image, b, top + row) + column)
            below = run_at(row_of(image, b, top + row + 1) + column)
            left = image[0, 0, at]
            left += fy * (image[0, 0, below] - left)
            right = image[0, 0, at + 1]
            right += fy * (image[0, 0, below + 1] - right)
            value = left + (x - dtype(column)) * (right - left)
        return value

    return bilinear_in_part


@cache
def make_bilinear(dtype):
    """Build the bilinear look-up in a whole image."""
    bilinear_in_part = make_bilinear_in_part(dtype)

    @ti.func
    def bilinear(image: ti.template(), b, x, y):
        return bilinear_in_part(image, b, 0, image.shape[1], image.shape[2], x, y)

    return bilinear


@cache
def make_moments_of_chunks(dtype, columns: int):
    """Build the first pass for a table of ``columns`` functions; one thread per (pose, chunk)."""
    bilinear = make_bilinear(dtype)
    project = make_project(dtype)

    @ti.kernel
    def moments_of_chunks(
        image: array(dtype, 3),
        image_idx: array(ti.i32, 1),
        pose: array(dtype, 2),
        active: array(ti.i32, 1),
        points: array(dtype, 2),
        table: array(dtype, 2),
        chunks_out: array(dtype, 3),
    ):
        for h, chunk in ti.ndrange(chunks_out.shape[0], chunks_out.shape[1]):
            if active[h] != 0:
                b = ti.max(ti.min(image_idx[h], image.shape[0] - 1), 0)
                count = points.shape[0]
                length = (count + chunks_out.shape[1] - 1) // chunks_out.shape[1]
                moments = ti.Vector.zero(dtype, columns)
                energy = dtype(0.0)
                for s in range(chunk * length, ti.min((chunk + 1) * length, count)):
                    x, y = project(pose, h, points[s, 0], points[s, 1])
                    e = bilinear(image, b, x, y)
                    if not e == dtype(0.0):  # NaN, too
                        at = run_at(s * columns)
                        for c in ti.static(range(columns)):
                            moments[c] += e * table[0, at + c]
                        energy += e * e
                for c in ti.static(range(columns)):
                    chunks_out[h, chunk, c] = moments[c]
                chunks_out[h, chunk, columns] = energy

    return moments_of_chunks


@cache
def make_add_chunks(dtype):
    """Build the second pass; one thread per (pose, moment)."""

    @ti.kernel
    def add_chunks(chunks: array(dtype, 3), active: array(ti.i32, 1), moments_out: array(dtype, 2)):
        for h, c in ti.ndrange(moments_out.shape[0], moments_out.shape[1]):
            if active[h] != 0:
                total = dtype(0.0)
                for k in range(chunks.shape[1]):
                    total += chunks[h, k, c]
                moments_out[h, c] = total

    return add_chunks


def sample_moments(image, image_idx, pose, active, points, table, chunks_out, moments_out) -> None:
    """Launch both passes; overwrites the moments of active poses, leaves those of the others."""
    dtype = float_of(image)
    first = make_moments_of_chunks(dtype, table.shape[1])
    launch(first, image, image_idx, pose, active, points, table, chunks_out)
    launch(make_add_chunks(dtype), chunks_out, active, moments_out)


@cache
def make_sample_moments_adjoint(dtype):
    """Build the adjoint in the image; one thread per (pose, point)."""
    bilinear = make_bilinear(dtype)
    inside = make_inside(dtype)
    project = make_project(dtype)

    @ti.kernel
    def sample_moments_adjoint(
        image: array(dtype, 3),
        image_idx: array(ti.i32, 1),
        pose: array(dtype, 2),
        active: array(ti.i32, 1),
        points: array(dtype, 2),
        table: array(dtype, 2),
        adj_moments: array(dtype, 2),
        adj_image_out: array(dtype, 3),
    ):
        for h, s in ti.ndrange(pose.shape[0], points.shape[0]):
            x, y = project(pose, h, points[s, 0], points[s, 1])
            if active[h] != 0 and inside(x, y, adj_image_out.shape[1], adj_image_out.shape[2]):
                b = ti.max(ti.min(image_idx[h], image.shape[0] - 1), 0)
                columns = table.shape[1]
                adj = dtype(2.0) * bilinear(image, b, x, y) * adj_moments[h, columns]
                for c in range(columns):
                    adj += adj_moments[h, c] * table[s, c]
                column = int(x)
                row = int(y)
                right = (x - dtype(column)) * adj
                left = adj - right
                fy = y - dtype(row)
                adj_image_out[b, row, column] += left - fy * left
                adj_image_out[b, row, column + 1] += right - fy * right
                adj_image_out[b, row + 1, column] += fy * left
                adj_image_out[b, row + 1, column + 1] += fy * right

    return sample_moments_adjoint


def sample_moments_adjoint(image, image_idx, pose, active, points, table, adj_moments, adj_image_out) -> None:
    """Launch; accumulates.  Float atomics: sums repeat to a tolerance, not bit for bit."""
    kernel = make_sample_moments_adjoint(float_of(image))
    launch(kernel, image, image_idx, pose, active, points, table, adj_moments, adj_image_out)
