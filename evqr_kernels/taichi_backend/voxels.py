"""Events to grids of pixels and time; the formulas are in ``warp_backend/voxels.py``."""

from functools import cache

from evqr_kernels.taichi_backend.lag_adjoint import window_of
from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import clear, launch
from evqr_kernels.taichi_backend.splat import chunks_of, events_of, length_of_chunk, make_add, owners


@cache
def make_plane_before(dtype):
    """Build the function that gives the plane before a time, -1 outside, and the share of the one after."""

    @ti.func
    def plane_before(t, begin, end, rate, planes):
        place = (t - begin) * rate
        plane = -1
        share = dtype(0.0)
        # written so that it is false for NaN
        if t >= begin and t <= end and place >= dtype(0.0):
            plane = ti.min(int(place), ti.max(planes - 2, 0))
            share = ti.min(place - dtype(plane), dtype(1.0))
        return plane, share

    return plane_before


@cache
def make_voxel_grid(dtype, shared: bool, alone: bool):
    """Build the kernel; one thread per (window, chunk of events)."""
    add = make_add(shared)
    plane_before = make_plane_before(dtype)

    @ti.kernel
    def voxel_grid(
        x: array(dtype, 1),
        y: array(dtype, 1),
        t: array(dtype, 1),
        weight: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        span: array(dtype, 2),
        chunks: ti.i32,
        grid_out: array(dtype, 4),
    ):
        ti.loop_config(serialize=alone)
        for b, k in ti.ndrange(grid_out.shape[0], chunks):
            if ti.static(not shared):
                if k > 0:
                    continue
            planes = grid_out.shape[1]
            right = dtype(grid_out.shape[3])
            bottom = dtype(grid_out.shape[2])
            earliest = span[b, 0]
            latest = span[b, 1]
            rate = dtype(planes - 1) / (latest - earliest)
            begin, end = events_of(window_ptr, b, x.shape[0])
            length = length_of_chunk(end - begin, chunks, shared)
            first = begin + k * length
            for e in range(first, ti.min(first + length, end)):
                column = x[e] + dtype(0.5)
                row = y[e] + dtype(0.5)
                plane, share = plane_before(t[e], earliest, latest, rate, planes)
                # written so that it is false for NaN
                if (
                    plane >= 0
                    and column >= dtype(0.0)
                    and row >= dtype(0.0)
                    and column < right
                    and row < bottom
                ):
                    w = weight[e]
                    add(grid_out, ti.Vector([b, plane, int(row), int(column)]), w - share * w)
                    if plane + 1 < planes:
                        add(grid_out, ti.Vector([b, plane + 1, int(row), int(column)]), share * w)

    return voxel_grid


def voxel_grid(x, y, t, weight, window_ptr, span, grid_out) -> None:
    """Launch; accumulates.  Float atomics on GPUs: sums repeat to a tolerance there, not bit for bit."""
    threads = owners(x, window_ptr)
    kernel = make_voxel_grid(float_of(x), *threads)
    launch(kernel, x, y, t, weight, window_ptr, span, chunks_of(x, window_ptr, *threads), grid_out)


@cache
def make_voxel_grid_adjoint(dtype):
    """Build the kernel; one thread per event."""
    plane_before = make_plane_before(dtype)

    @ti.kernel
    def voxel_grid_adjoint(
        x: array(dtype, 1),
        y: array(dtype, 1),
        t: array(dtype, 1),
        weight: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        span: array(dtype, 2),
        adj_grid: array(dtype, 4),
        adj_weight_out: array(dtype, 1),
        adj_t_out: array(dtype, 1),
    ):
        for e in range(adj_weight_out.shape[0]):
            adj_w = dtype(0.0)
            adj_t = dtype(0.0)
            b = window_of(window_ptr, e)
            if b >= 0 and b < adj_grid.shape[0]:
                planes = adj_grid.shape[1]
                earliest = span[b, 0]
                latest = span[b, 1]
                rate = dtype(planes - 1) / (latest - earliest)
                column = x[e] + dtype(0.5)
                row = y[e] + dtype(0.5)
                plane, share = plane_before(t[e], earliest, latest, rate, planes)
                # written so that it is false for NaN
                if (
                    plane >= 0
                    and column >= dtype(0.0)
                    and row >= dtype(0.0)
                    and column < dtype(adj_grid.shape[3])
                    and row < dtype(adj_grid.shape[2])
                ):
                    after = ti.min(plane + 1, planes - 1)
                    adj = adj_grid[b, plane, int(row), int(column)]
                    grown = adj_grid[b, after, int(row), int(column)] - adj
                    adj_w = adj + share * grown
                    adj_t = weight[e] * rate * grown
            adj_weight_out[e] = adj_w
            adj_t_out[e] = adj_t

    return voxel_grid_adjoint


def voxel_grid_adjoint(x, y, t, weight, window_ptr, span, adj_grid, adj_weight_out, adj_t_out) -> None:
    """Launch; overwrites."""
    if 0 in adj_grid.shape:  # no pixel to read
        clear(adj_weight_out)
        clear(adj_t_out)
        return
    kernel = make_voxel_grid_adjoint(float_of(x))
    launch(kernel, x, y, t, weight, window_ptr, span, adj_grid, adj_weight_out, adj_t_out)
