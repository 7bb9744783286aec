"""Events of eight bytes to images; the formulas are in ``warp_backend/packed.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import (
    array,
    float_of,
    indices_of_window,
    is_alone,
    is_on_cpu,
    row_of,
    row_of_plane,
    run_at,
    ti,
    variant,
)
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.splat import make_add
from evqr_kernels.taichi_backend.transport import make_transport


def indices_of(op: str, image, alone: bool) -> int:
    """Choose how many indices of a loop a window has; on the CPU the first takes all of its events."""
    return indices_of_window(alone) if is_on_cpu(image) else variant(op, on_cpu=False).threads


@ti.func
def blocks_of(first, last, stride):
    """Give how many blocks of events begin at ``first``, and every ``stride`` after, before ``last``."""
    return (ti.max(last - first, 0) + stride - 1) // stride


@cache
def make_cell_along(dtype):
    """Build the function that gives the cell of ``size`` along an axis that a place is in; -1 before them."""

    @ti.func
    def cell_along(place, size):
        return ti.floor(ti.max(ti.min(place, dtype(size)), dtype(-1.0)))

    return cell_along


@ti.func
def place_of(row, column, height, width, row_length):
    """Give the place of a cell in an image with rows of ``row_length``; -1 beside height and width."""
    place = row * row_length + column
    place = ti.select(row < 0, -1, place)
    place = ti.select(column < 0, -1, place)
    place = ti.select(row < height, place, -1)
    return ti.select(column < width, place, -1)


@cache
def make_bin_packed_events(dtype, block: int, shared: bool, alone: bool):
    """Build the binning kernel; ``indices`` threads per window, or one, with ``block`` events together."""
    add = make_add(shared)
    cell_along = make_cell_along(dtype)

    @ti.kernel
    def bin_packed_events(
        x: array(ti.u16, 1),
        y: array(ti.u16, 1),
        stamp: array(ti.u32, 1),
        window_ptr: array(ti.i32, 2),
        inverse_reduction: dtype,
        indices: ti.i32,
        image_out: array(dtype, 3),
    ):
        ti.loop_config(serialize=alone)
        for b, k in ti.ndrange(image_out.shape[0], indices):
            if ti.static(not shared):
                if k > 0:
                    continue
            stride = block * (indices if ti.static(shared) else 1)
            height = image_out.shape[1]
            width = image_out.shape[2]
            image = row_of(image_out, b, 0)
            last = window_ptr[b, 1]
            begin = window_ptr[b, 0] + block * k
            for i in range(blocks_of(begin, last, stride)):
                # the last block ends with the columns: some of it was counted
                first = run_at(ti.min(begin + i * stride, x.shape[0] - block))
                places = ti.Vector.zero(ti.i32, block)
                for p in ti.static(range(block)):
                    across = (ti.cast(x[first + p], dtype) + dtype(0.5)) * inverse_reduction
                    down = (ti.cast(y[first + p], dtype) + dtype(0.5)) * inverse_reduction
                    column = int(cell_along(across, width))
                    place = place_of(int(cell_along(down, height)), column, height, width, width)
                    place = ti.select(first + p < begin + i * stride, -1, place)
                    places[p] = ti.select(first + p < last, place, -1)
                for p in ti.static(range(block)):
                    if places[p] >= 0:
                        sign = 2 * ti.cast(stamp[first + p] & ti.u32(1), ti.i32) - 1
                        add(image_out, ti.Vector([0, 0, image + places[p]]), ti.cast(sign, dtype))

    return bin_packed_events


def bin_packed_events(x, y, stamp, window_ptr, reduction: float, image_out) -> None:
    """Launch; accumulates.  Float atomics on GPUs: sums repeat to a tolerance there, not bit for bit."""
    alone = is_alone(image_out)
    block = variant("bin_packed_events", is_on_cpu(image_out), x.shape[0]).tile
    kernel = make_bin_packed_events(float_of(image_out), block, not is_on_cpu(image_out), alone)
    indices = indices_of("bin_packed_events", image_out, alone)
    launch(kernel, x, y, stamp, window_ptr, 1.0 / reduction, indices, image_out)


@cache
def make_deposit_packed_events(dtype, block: int, shared: bool, alone: bool):
    """Build the kernel; ``indices`` threads per window, or one, with ``block`` events together."""
    add = make_add(shared)
    transport = make_transport(dtype)
    cell_along = make_cell_along(dtype)

    @ti.kernel
    def deposit_packed_events(
        x: array(ti.u16, 1),
        y: array(ti.u16, 1),
        stamp: array(ti.u32, 1),
        window_ptr: array(ti.i32, 2),
        t_ref: array(ti.i32, 1),
        motion: array(dtype, 2),
        frame: array(dtype, 2),
        extent: array(ti.i32, 2),
        indices: ti.i32,
        deposit_out: array(dtype, 4),
    ):
        ti.loop_config(serialize=alone)
        for b, k in ti.ndrange(deposit_out.shape[0], indices):
            if ti.static(not shared):
                if k > 0:
                    continue
            stride = block * (indices if ti.static(shared) else 1)
            motion_x = motion[b, 0]
            motion_y = motion[b, 1]
            origin_x = frame[b, 0]
            origin_y = frame[b, 1]
            inverse_scale = dtype(1.0) / frame[b, 2]
            reference = ti.cast(t_ref[b], ti.u32) << ti.u32(1)
            bottom = extent[b, 0] - 1
            right = extent[b, 1] - 1
            width = deposit_out.shape[3]
            on_image = row_of_plane(deposit_out, b, 0, 0)
            off_image = row_of_plane(deposit_out, b, 1, 0)
            last = window_ptr[b, 1]
            begin = window_ptr[b, 0] + block * k
            for i in range(blocks_of(begin, last, stride)):
                # the last block ends with the columns: some of it was counted
                first = run_at(ti.min(begin + i * stride, x.shape[0] - block))
                places = ti.Vector.zero(ti.i32, block)
                across = ti.Vector.zero(dtype, block)
                down = ti.Vector.zero(dtype, block)
                for p in ti.static(range(block)):
                    t = ti.cast(ti.cast(stamp[first + p] - reference, ti.i32) >> 1, dtype)
                    cx = transport(ti.cast(x[first + p], dtype), t, motion_x, origin_x, inverse_scale)
                    cy = transport(ti.cast(y[first + p], dtype), t, motion_y, origin_y, inverse_scale)
                    column = cell_along(cx, right)
                    row = cell_along(cy, bottom)
                    across[p] = cx - column
                    down[p] = cy - row
                    place = place_of(int(row), int(column), bottom, right, width)
                    place = ti.select(first + p < begin + i * stride, -1, place)
                    places[p] = ti.select(first + p < last, place, -1)
                for p in ti.static(range(block)):
                    if places[p] >= 0:
                        on = ti.cast(stamp[first + p] & ti.u32(1), ti.i32)
                        w = ti.cast(2 * on - 1, dtype)
                        at = ti.select(on == 1, on_image, off_image) + places[p]
                        right_share = across[p] * w
                        left_share = w - right_share
                        add(deposit_out, ti.Vector([0, 0, 0, at]), left_share - down[p] * left_share)
                        add(deposit_out, ti.Vector([0, 0, 0, at + 1]), right_share - down[p] * right_share)
                        add(deposit_out, ti.Vector([0, 0, 0, at + width]), down[p] * left_share)
                        add(deposit_out, ti.Vector([0, 0, 0, at + width + 1]), down[p] * right_share)

    return deposit_packed_events


def deposit_packed_events(x, y, stamp, window_ptr, t_ref, motion, frame, extent, deposit_out) -> None:
    """Launch; accumulates.  Float atomics on GPUs: sums repeat to a tolerance there, not bit for bit."""
    alone = is_alone(deposit_out)
    block = variant("deposit_packed_events", is_on_cpu(deposit_out), x.shape[0]).tile
    kernel = make_deposit_packed_events(float_of(deposit_out), block, not is_on_cpu(deposit_out), alone)
    indices = indices_of("deposit_packed_events", deposit_out, alone)
    launch(kernel, x, y, stamp, window_ptr, t_ref, motion, frame, extent, indices, deposit_out)
