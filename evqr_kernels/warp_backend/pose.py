"""Moments of an image seen through a pose: all that an alignment needs of the data.

A pose is a homography P (row-major, 9 numbers) from code coordinates (u, v) to image pixels.  For points s
with code coordinates ``points[s]`` and a table of C model functions known beforehand:

    e_s        = image(P(points[s]))                       bilinear, 0 outside the image
    moments[c] = sum_s e_s table[s, c],  c < C;            moments[C] = sum_s e_s^2

The Gauss-Newton matrix of an inverse-compositional step does not depend on the image, so these C + 1 numbers
are the whole data term.  Points are cut into as many chunks as the scratch buffer has, each with one owner,
and added up in a second pass: no atomics, deterministic.

Adjoint in the image, with beta_s(x) the bilinear weight of pixel x at P(points[s]):

    adj_image(x) += sum_s beta_s(x) (sum_c adj[c] table[s, c] + 2 e_s adj[C])
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import (
    last_axis_as_vector,
    launch,
    launch_bounds,
    module_of,
    neighbours,
    variant,
    vector,
)


@cache
def make_project(dtype: type) -> wp.Function:
    """Build the function that maps code coordinates to image pixels."""

    @wp.func
    def project(pose: wp.array2d(dtype=dtype), h: int, u: dtype, v: dtype):
        inverse_depth = dtype(1.0) / (pose[h, 6] * u + pose[h, 7] * v + pose[h, 8])
        x = (pose[h, 0] * u + pose[h, 1] * v + pose[h, 2]) * inverse_depth
        y = (pose[h, 3] * u + pose[h, 4] * v + pose[h, 5]) * inverse_depth
        return x, y

    return project


@cache
def make_inside(dtype: type) -> wp.Function:
    """Build the test whether the four pixels around a position are in the image; also false for NaN."""

    @wp.func
    def inside(x: dtype, y: dtype, height: int, width: int) -> bool:
        return x >= dtype(0.0) and y >= dtype(0.0) and x < dtype(width - 1) and y < dtype(height - 1)

    return inside


@cache
def make_bilinear_in_part(dtype: type) -> wp.Function:
    """Build the bilinear look-up in some rows and columns, 0 beyond them.

    ``pairs[b, y, x]`` holds the pixels x and x + 1 of a row.
    """
    vec_pair = vector(2, dtype)
    inside = make_inside(dtype)

    @wp.func
    def bilinear_in_part(
        pairs: wp.array3d(dtype=vec_pair), b: int, top: int, height: int, width: int, x: dtype, y: dtype
    ) -> dtype:
        value = dtype(0.0)
        if inside(x, y, height, width):
            column = int(x)
            row = int(y)
            above = pairs[b, top + row, column]
            below = pairs[b, top + row + 1, column]
            both = above + (y - dtype(row)) * (below - above)
            value = both[0] + (x - dtype(column)) * (both[1] - both[0])
        return value

    return bilinear_in_part


@cache
def make_bilinear(dtype: type) -> wp.Function:
    """Build the bilinear look-up in a whole image."""
    vec_pair = vector(2, dtype)
    bilinear_in_part = make_bilinear_in_part(dtype)

    @wp.func
    def bilinear(pairs: wp.array3d(dtype=vec_pair), b: int, x: dtype, y: dtype) -> dtype:
        return bilinear_in_part(pairs, b, 0, pairs.shape[1], pairs.shape[2] + 1, x, y)

    return bilinear


@cache
def make_moments_of_chunks(dtype: type, columns: int) -> wp.Kernel:
    """Build the first pass for a table of ``columns`` functions; launch: one thread per (pose, chunk)."""
    vec_columns = vector(columns, dtype)
    vec_pair = vector(2, dtype)
    bilinear = make_bilinear(dtype)
    project = make_project(dtype)

    @wp.kernel(module=module_of(f"pose_{columns}", dtype))
    def moments_of_chunks(
        pairs: wp.array3d(dtype=vec_pair),
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
        b = wp.clamp(image_idx[h], 0, pairs.shape[0] - 1)
        count = points.shape[0]
        length = (count + chunks_out.shape[1] - 1) // chunks_out.shape[1]
        moments = vec_columns()
        energy = dtype(0.0)
        for s in range(chunk * length, wp.min((chunk + 1) * length, count)):
            x, y = project(pose, h, points[s, 0], points[s, 1])
            e = bilinear(pairs, b, x, y)
            if e != dtype(0.0):
                moments += e * table[s]
                energy += e * e
        for c in range(columns):
            chunks_out[h, chunk, c] = moments[c]
        chunks_out[h, chunk, columns] = energy

    return moments_of_chunks


@cache
def make_add_chunks(dtype: type, columns: int) -> wp.Kernel:
    """Build the second pass, beside the first; launch: one thread per (pose, moment)."""

    @wp.kernel(module=module_of(f"pose_{columns}", dtype))
    def add_chunks(
        chunks: wp.array3d(dtype=dtype),
        active: wp.array(dtype=wp.int32),
        moments_out: wp.array2d(dtype=dtype),
    ):
        h, c = wp.tid()
        if active[h] == 0:
            return
        total = dtype(0.0)
        for k in range(chunks.shape[1]):
            total += chunks[h, k, c]
        moments_out[h, c] = total

    return add_chunks


def sample_moments(image, image_idx, pose, active, points, table, chunks_out, moments_out) -> None:
    """Launch both passes; overwrites the moments of active poses, leaves those of the others."""
    dtype, device = image.dtype, image.device
    columns = table.shape[1]
    launch(
        make_moments_of_chunks(dtype, columns),
        chunks_out.shape[:2],
        inputs=[neighbours(image, 2), image_idx, pose, active, points, last_axis_as_vector(table)],
        outputs=[chunks_out],
        device=device,
    )
    launch(
        make_add_chunks(dtype, columns),
        moments_out.shape,
        inputs=[chunks_out, active],
        outputs=[moments_out],
        device=device,
    )


@cache
def make_sample_moments_adjoint(dtype: type, columns: int) -> wp.Kernel:
    """Build the adjoint in the image; launch: one thread per (pose, run of points)."""
    vec_columns = vector(columns, dtype)
    vec_pair = vector(2, dtype)
    bilinear = make_bilinear(dtype)
    inside = make_inside(dtype)
    project = make_project(dtype)

    @wp.kernel(module=module_of(f"pose_adjoint_{columns}", dtype), launch_bounds=launch_bounds(dtype))
    def sample_moments_adjoint(
        pairs: wp.array3d(dtype=vec_pair),
        image_idx: wp.array(dtype=wp.int32),
        pose: wp.array2d(dtype=dtype),
        active: wp.array(dtype=wp.int32),
        points: wp.array2d(dtype=dtype),
        table: wp.array(dtype=vec_columns),
        adj_moments: wp.array2d(dtype=dtype),
        adj_moment_blocks: wp.array2d(dtype=vec_columns),
        run: int,
        adj_pairs_out: wp.array3d(dtype=vec_pair),
    ):
        h, k = wp.tid()
        if active[h] == 0:
            return
        b = wp.clamp(image_idx[h], 0, pairs.shape[0] - 1)
        height = adj_pairs_out.shape[1]
        width = adj_pairs_out.shape[2] + 1
        adj_table = adj_moment_blocks[h, 0]
        twice_adj_energy = dtype(2.0) * adj_moments[h, columns]
        for s in range(k * run, wp.min((k + 1) * run, points.shape[0])):
            x, y = project(pose, h, points[s, 0], points[s, 1])
            if inside(x, y, height, width):
                adj = twice_adj_energy * bilinear(pairs, b, x, y) + wp.dot(adj_table, table[s])
                column = int(x)
                row = int(y)
                right = (x - dtype(column)) * adj
                both = vec_pair(adj - right, right)
                below = (y - dtype(row)) * both
                wp.atomic_add(adj_pairs_out, b, row, column, both - below)
                wp.atomic_add(adj_pairs_out, b, row + 1, column, below)

    return sample_moments_adjoint


def sample_moments_adjoint(image, image_idx, pose, active, points, table, adj_moments, adj_image_out) -> None:
    """Launch; accumulates.  Float atomics: on a GPU sums repeat to a tolerance, not bit for bit."""
    dtype = image.dtype
    columns = table.shape[1]
    run = variant("sample_moments_adjoint", image.device).tile
    launch(
        make_sample_moments_adjoint(dtype, columns),
        (pose.shape[0], -(-points.shape[0] // run)),
        inputs=[
            neighbours(image, 2),
            image_idx,
            pose,
            active,
            points,
            last_axis_as_vector(table),
            adj_moments,
            neighbours(adj_moments, columns),
            run,
        ],
        outputs=[neighbours(adj_image_out, 2)],
        device=image.device,
    )
