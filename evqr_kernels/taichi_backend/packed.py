"""Events of eight bytes to images; the formulas are in ``warp_backend/packed.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import (
    array,
    float_of,
    indices_of_window,
    is_alone,
    is_on_cpu,
    ti,
    variant,
)
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.splat import make_add
from evqr_kernels.taichi_backend.transport import make_transport


def indices_of(op: str, image, alone: bool) -> int:
    """Choose how many indices of a loop a window has; on the CPU the first takes all of its events."""
    return indices_of_window(alone) if is_on_cpu(image) else variant(op, on_cpu=False).threads


@cache
def make_bin_packed_events(dtype, shared: bool, alone: bool):
    """Build the binning kernel; ``indices`` threads per window, or one."""
    add = make_add(shared)

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
            stride = indices if ti.static(shared) else 1
            height = image_out.shape[1]
            width = image_out.shape[2]
            first = window_ptr[b, 0] + k
            for i in range((ti.max(window_ptr[b, 1] - first, 0) + stride - 1) // stride):
                e = first + i * stride
                column = int((ti.cast(x[e], dtype) + dtype(0.5)) * inverse_reduction)
                row = int((ti.cast(y[e], dtype) + dtype(0.5)) * inverse_reduction)
                if column < width and row < height:
                    sign = 2 * ti.cast(stamp[e] & ti.u32(1), ti.i32) - 1
                    add(image_out, ti.Vector([b, row, column]), ti.cast(sign, dtype))

    return bin_packed_events


def bin_packed_events(x, y, stamp, window_ptr, reduction: float, image_out) -> None:
    """Launch; accumulates.  Float atomics on GPUs: sums repeat to a tolerance there, not bit for bit."""
    alone = is_alone(image_out)
    kernel = make_bin_packed_events(float_of(image_out), not is_on_cpu(image_out), alone)
    indices = indices_of("bin_packed_events", image_out, alone)
    launch(kernel, x, y, stamp, window_ptr, 1.0 / reduction, indices, image_out)


@cache
def make_deposit_packed_events(dtype, shared: bool, alone: bool):
    """Build the kernel; ``indices`` threads per window, or one."""
    add = make_add(shared)
    transport = make_transport(dtype)

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
            stride = indices if ti.static(shared) else 1
            motion_x = motion[b, 0]
            motion_y = motion[b, 1]
            origin_x = frame[b, 0]
            origin_y = frame[b, 1]
            inverse_scale = dtype(1.0) / frame[b, 2]
            bottom = dtype(extent[b, 0] - 1)
            right = dtype(extent[b, 1] - 1)
            first = window_ptr[b, 0] + k
            for i in range((ti.max(window_ptr[b, 1] - first, 0) + stride - 1) // stride):
                e = first + i * stride
                t = ti.cast(ti.cast(stamp[e] >> ti.u32(1), ti.i32) - t_ref[b], dtype)
                cx = transport(ti.cast(x[e], dtype), t, motion_x, origin_x, inverse_scale)
                cy = transport(ti.cast(y[e], dtype), t, motion_y, origin_y, inverse_scale)
                # written so that it is false for NaN
                if cx >= dtype(0.0) and cy >= dtype(0.0) and cx < right and cy < bottom:
                    column = int(cx)
                    row = int(cy)
                    on = ti.cast(stamp[e] & ti.u32(1), ti.i32)
                    w = ti.cast(2 * on - 1, dtype)
                    at_right = (cx - dtype(column)) * w
                    at_left = w - at_right
                    fy = cy - dtype(row)
                    add(deposit_out, ti.Vector([b, 1 - on, row, column]), at_left - fy * at_left)
                    add(deposit_out, ti.Vector([b, 1 - on, row, column + 1]), at_right - fy * at_right)
                    add(deposit_out, ti.Vector([b, 1 - on, row + 1, column]), fy * at_left)
                    add(deposit_out, ti.Vector([b, 1 - on, row + 1, column + 1]), fy * at_right)

    return deposit_packed_events


def deposit_packed_events(x, y, stamp, window_ptr, t_ref, motion, frame, extent, deposit_out) -> None:
    """Launch; accumulates.  Float atomics on GPUs: sums repeat to a tolerance there, not bit for bit."""
    alone = is_alone(deposit_out)
    kernel = make_deposit_packed_events(float_of(deposit_out), not is_on_cpu(deposit_out), alone)
    indices = indices_of("deposit_packed_events", deposit_out, alone)
    launch(kernel, x, y, stamp, window_ptr, t_ref, motion, frame, extent, indices, deposit_out)
