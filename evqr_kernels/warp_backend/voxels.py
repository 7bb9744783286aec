"""Events to grids of pixels and time, linear in time.

K planes lie evenly over a window's span, the first at its begin and the last at its end.  An event at time t
counts for the pixel that it falls in, in the plane before it and in the one after:

    place = (t - begin) (K - 1) / (end - begin),     k = floor(place),     f = place - k
    grid(k) += (1 - f) w,     grid(k + 1) += f w

Events outside the span are dropped; one plane alone takes all others whole.  With adj = d loss / d grid at
the event's pixel,

    adj_w = (1 - f) adj(k) + f adj(k + 1),     adj_t = w (K - 1) / (end - begin) (adj(k + 1) - adj(k))
"""

from functools import cache

import warp as wp

from evqr_kernels.operations.events import CHUNK
from evqr_kernels.warp_backend.language import clear, launch, module_of
from evqr_kernels.warp_backend.transport import is_named, window_of


@cache
def make_plane_before(dtype: type) -> wp.Function:
    """Build the function that gives the plane before a time, and the share of the one after.

    The plane is -1 outside the span, and for NaN.
    """

    @wp.func
    def plane_before(t: dtype, begin: dtype, end: dtype, rate: dtype, planes: int):
        place = (t - begin) * rate
        plane = wp.int32(-1)
        share = dtype(0.0)
        if t >= begin and t <= end and place >= dtype(0.0):
            plane = wp.min(int(place), wp.max(planes - 2, 0))
            share = wp.min(place - dtype(plane), dtype(1.0))
        return plane, share

    return plane_before


@cache
def make_voxel_grid(dtype: type) -> wp.Kernel:
    """Build the kernel; launch: one thread per chunk of events, whatever windows they are of."""
    plane_before = make_plane_before(dtype)

    @wp.kernel(module=module_of("voxels", dtype))
    def voxel_grid(
        x: wp.array(dtype=dtype),
        y: wp.array(dtype=dtype),
        t: wp.array(dtype=dtype),
        weight: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        span: wp.array2d(dtype=dtype),
        grid_out: wp.array4d(dtype=dtype),
    ):
        planes = grid_out.shape[1]
        right = dtype(grid_out.shape[3])
        bottom = dtype(grid_out.shape[2])
        first = wp.tid() * CHUNK
        last = wp.min(first + CHUNK, window_ptr[window_ptr.shape[0] - 1])
        b = window_of(window_ptr, first)
        if b < 0 or last > x.shape[0]:  # some of them no window names
            first = wp.max(first, window_ptr[0])
            last = wp.min(last, x.shape[0])
            b = window_of(window_ptr, first)
        while first < last:  # ends with the last window
            stop = wp.min(last, window_ptr[b + 1])
            begin = span[b, 0]
            end = span[b, 1]
            rate = dtype(planes - 1) / (end - begin)
            for e in range(first, stop):
                column = x[e] + dtype(0.5)
                row = y[e] + dtype(0.5)
                plane, share = plane_before(t[e], begin, end, rate, planes)
                # written so that it is false for NaN
                if (
                    plane >= 0
                    and column >= dtype(0.0)
                    and row >= dtype(0.0)
                    and column < right
                    and row < bottom
                ):
                    w = weight[e]
                    wp.atomic_add(grid_out, b, plane, int(row), int(column), w - share * w)
                    if plane + 1 < planes:
                        wp.atomic_add(grid_out, b, plane + 1, int(row), int(column), share * w)
            first = wp.max(first, stop)
            b += 1

    return voxel_grid


def voxel_grid(x, y, t, weight, window_ptr, span, grid_out) -> None:
    """Launch; accumulates.  Float atomics: on a GPU sums repeat to a tolerance, not bit for bit."""
    launch(
        make_voxel_grid(x.dtype),
        -(-x.shape[0] // CHUNK),
        inputs=[x, y, t, weight, window_ptr, span],
        outputs=[grid_out],
        device=x.device,
    )


@cache
def make_voxel_grid_adjoint(dtype: type) -> wp.Kernel:
    """Build the kernel; launch: one thread per event."""
    plane_before = make_plane_before(dtype)

    @wp.kernel(module=module_of("voxels", dtype))
    def voxel_grid_adjoint(
        x: wp.array(dtype=dtype),
        y: wp.array(dtype=dtype),
        t: wp.array(dtype=dtype),
        weight: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        span: wp.array2d(dtype=dtype),
        adj_grid: wp.array4d(dtype=dtype),
        adj_weight_out: wp.array(dtype=dtype),
        adj_t_out: wp.array(dtype=dtype),
    ):
        e = wp.tid()
        adj_w = dtype(0.0)
        adj_t = dtype(0.0)
        if is_named(window_ptr, e):
            b = window_of(window_ptr, e)
            planes = adj_grid.shape[1]
            begin = span[b, 0]
            end = span[b, 1]
            rate = dtype(planes - 1) / (end - begin)
            column = x[e] + dtype(0.5)
            row = y[e] + dtype(0.5)
            plane, share = plane_before(t[e], begin, end, rate, planes)
            # written so that it is false for NaN
            if (
                plane >= 0
                and column >= dtype(0.0)
                and row >= dtype(0.0)
                and column < dtype(adj_grid.shape[3])
                and row < dtype(adj_grid.shape[2])
            ):
                after = wp.min(plane + 1, planes - 1)
                adj = adj_grid[b, plane, int(row), int(column)]
                grown = adj_grid[b, after, int(row), int(column)] - adj
                adj_w = adj + share * grown
                adj_t = weight[e] * rate * grown
        adj_weight_out[e] = adj_w
        adj_t_out[e] = adj_t

    return voxel_grid_adjoint


def voxel_grid_adjoint(x, y, t, weight, window_ptr, span, adj_grid, adj_weight_out, adj_t_out) -> None:
    """Launch; overwrites."""
    if not adj_grid.size:  # no pixel to read
        clear(adj_weight_out)
        clear(adj_t_out)
        return
    launch(
        make_voxel_grid_adjoint(x.dtype),
        x.shape[0],
        inputs=[x, y, t, weight, window_ptr, span, adj_grid],
        outputs=[adj_weight_out, adj_t_out],
        device=x.device,
    )
