"""Events to images; the formulas are in ``warp_backend/splat.py``."""

from functools import cache

from evqr_kernels.config import SplatConfig
from evqr_kernels.operations.events import CHUNK
from evqr_kernels.taichi_backend.language import (
    array,
    float_of,
    indices_of_window,
    is_on_cpu,
    row_of,
    run_at,
    ti,
)
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.transcendental import make_exp
from evqr_kernels.taichi_backend.transport import make_middle, make_transport, make_velocity


@cache
def make_add(shared: bool):
    """Build the addition to an element that other threads may add to at the same time, if it is shared."""

    @ti.func
    def add(image: ti.template(), index, value):
        if ti.static(shared):
            image[index] += value  # atomic
        else:
            image[index] = image[index] + value

    return add


@cache
def make_add_run(length: int, shared: bool):
    """Build the addition of a vector to neighbours in memory, `run_at` the index."""

    @ti.func
    def add_run(image: ti.template(), at, values):
        if ti.static(shared):
            for k in ti.static(range(length)):
                image[0, 0, at + k] += values[k]  # atomic
        else:
            for k in ti.static(range(length)):
                values[k] += image[0, 0, at + k]
            for k in ti.static(range(length)):
                image[0, 0, at + k] = values[k]

    return add_run


def owners(x, window_ptr) -> tuple[bool, bool]:
    """Tell whether windows have several threads each, and whether there is one thread in all.

    On the CPU a thread takes all of a window's events, so that the window has one owner.
    """
    on_cpu = is_on_cpu(x)
    return not on_cpu, on_cpu and window_ptr.shape[0] == 2


def chunks_of(x, window_ptr, shared: bool, alone: bool) -> int:
    """Choose how many indices of a loop a window has: a chunk of events each, or all of them the first."""
    windows = window_ptr.shape[0] - 1
    return -(-x.shape[0] // (CHUNK * max(windows, 1))) if shared else indices_of_window(alone)


@ti.func
def events_of(window_ptr: ti.template(), b, count):
    """Give the first event of a window and the one behind its last, of ``count``, whatever the pointers."""
    end = ti.max(ti.min(window_ptr[b + 1], count), 0)
    return ti.min(ti.max(window_ptr[b], 0), end), end


@ti.func
def length_of_chunk(count, chunks, shared: ti.template()):
    """Give how many of a window's ``count`` events each of its ``chunks`` has."""
    return ti.max((count + chunks - 1) // chunks, CHUNK) if ti.static(shared) else count


@cache
def make_bin_events(dtype, shared: bool, alone: bool):
    """Build the binning kernel; one thread per (window, chunk of events)."""
    add = make_add(shared)

    @ti.kernel
    def bin_events(
        x: array(dtype, 1),
        y: array(dtype, 1),
        weight: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        inverse_reduction: dtype,
        chunks: ti.i32,
        image_out: array(dtype, 3),
    ):
        ti.loop_config(serialize=alone)
        for b, k in ti.ndrange(image_out.shape[0], chunks):
            if ti.static(not shared):
                if k > 0:
                    continue
            right = dtype(image_out.shape[2])
            bottom = dtype(image_out.shape[1])
            begin, end = events_of(window_ptr, b, x.shape[0])
            length = length_of_chunk(end - begin, chunks, shared)
            first = begin + k * length
            for e in range(first, ti.min(first + length, end)):
                column = (x[e] + dtype(0.5)) * inverse_reduction
                row = (y[e] + dtype(0.5)) * inverse_reduction
                # written so that it is false for NaN
                if column >= dtype(0.0) and row >= dtype(0.0) and column < right and row < bottom:
                    add(image_out, ti.Vector([b, int(row), int(column)]), weight[e])

    return bin_events


def bin_events(x, y, weight, window_ptr, reduction: float, image_out) -> None:
    """Launch; accumulates.  Float atomics on GPUs: sums repeat to a tolerance there, not bit for bit."""
    threads = owners(x, window_ptr)
    kernel = make_bin_events(float_of(x), *threads)
    launch(kernel, x, y, weight, window_ptr, 1.0 / reduction, chunks_of(x, window_ptr, *threads), image_out)


@cache
def make_splat_taps(dtype, cfg: SplatConfig):
    """Build the function that gives the Gaussian, g and g' at the taps around an event.

    The event is ``offset`` px off the middle one.
    """
    if cfg.kind == "bilinear":
        return make_hat_taps(dtype)
    reach = cfg.reach
    taps = 2 * reach + 1
    gauss_at_taps = [cfg.norm * cfg.gauss(k) for k in range(-reach, reach + 1)]
    inverse_variance = 1.0 / cfg.epsilon_px**2
    inverse_radius_sq = 1.0 / cfg.radius_px**2
    exp = make_exp(dtype)

    @ti.func
    def splat_taps(offset):
        # exp(-(k - f)^2 / 2 eps^2) = exp(-f^2 / 2 eps^2) exp(f / eps^2)^k exp(-k^2 / 2 eps^2): two exps, not
        # one a tap
        gauss = ti.Vector.zero(dtype, taps)
        value = ti.Vector.zero(dtype, taps)
        slope = ti.Vector.zero(dtype, taps)
        up = exp(offset * dtype(inverse_variance))
        down = dtype(1.0) / up
        right = exp(dtype(-0.5) * offset * offset * dtype(inverse_variance))
        left = right
        for k in ti.static(range(reach + 1)):
            gauss[reach + k] = right * dtype(gauss_at_taps[reach + k])
            gauss[reach - k] = left * dtype(gauss_at_taps[reach - k])
            right *= up
            left *= down
        for k in ti.static(range(taps)):
            r = dtype(float(k - reach)) - offset
            q = ti.max(dtype(1.0) - r * r * dtype(inverse_radius_sq), dtype(0.0))
            rate = q * dtype(inverse_variance) + dtype(4.0 * inverse_radius_sq)
            value[k] = gauss[k] * q * q
            slope[k] = -r * gauss[k] * q * rate
        return gauss, value, slope

    return splat_taps


@cache
def make_hat_taps(dtype):
    """Build the function that gives max(0, 1 - |r|) and its slope at the three taps around an event."""

    @ti.func
    def hat_taps(offset):
        value = ti.Vector.zero(dtype, 3)
        slope = ti.Vector.zero(dtype, 3)
        for k in ti.static(range(3)):
            r = dtype(float(k - 1)) - offset
            value[k] = ti.max(dtype(1.0) - ti.abs(r), dtype(0.0))
            if value[k] > dtype(0.0) and r != dtype(0.0):
                slope[k] = ti.select(r < dtype(0.0), dtype(1.0), dtype(-1.0))
        return ti.Vector.zero(dtype, 3), value, slope

    return hat_taps


@cache
def make_splat_events(dtype, cfg: SplatConfig, parameters: int, shared: bool, alone: bool):
    """Build the kernel for a precision, a splat and a motion; one thread per (window, chunk)."""
    reach = cfg.reach
    taps = 2 * reach + 1
    add = make_add(shared)
    add_run = make_add_run(taps, shared)
    margin = float(taps)
    splat_taps = make_splat_taps(dtype, cfg)
    transport = make_transport(dtype)
    middle = make_middle(dtype)
    velocity = make_velocity(parameters)

    @ti.kernel
    def splat_events(
        x: array(dtype, 1),
        y: array(dtype, 1),
        t: array(dtype, 1),
        weight: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        motion: array(dtype, 2),
        lag: array(dtype, 2),
        frame: array(dtype, 2),
        chunks: ti.i32,
        image_out: array(dtype, 3),
    ):
        ti.loop_config(serialize=alone)
        for b, k in ti.ndrange(image_out.shape[0], chunks):
            if ti.static(not shared):
                if k > 0:
                    continue
            scale = frame[b, 2]
            inverse_scale = dtype(1.0) / scale
            origin_x = frame[b, 0]
            origin_y = frame[b, 1]
            lag_on = lag[b, 0]
            lag_off = lag[b, 1]
            height = image_out.shape[1]
            width = image_out.shape[2]
            middle_x = middle(origin_x, scale, width)
            middle_y = middle(origin_y, scale, height)
            begin, end = events_of(window_ptr, b, x.shape[0])
            length = length_of_chunk(end - begin, chunks, shared)
            first = begin + k * length
            for e in range(first, ti.min(first + length, end)):
                motion_x, motion_y = velocity(motion, b, x[e] - middle_x, y[e] - middle_y)
                cx = transport(x[e], t[e], motion_x, origin_x, inverse_scale)
                cy = transport(y[e], t[e], motion_y, origin_y, inverse_scale)
                # written so that it is false for NaN
                if (
                    cx > dtype(-margin)
                    and cy > dtype(-margin)
                    and cx < dtype(width) + dtype(margin)
                    and cy < dtype(height) + dtype(margin)
                ):
                    column = int(ti.floor(cx + dtype(0.5)))
                    row = int(ti.floor(cy + dtype(0.5)))
                    w = weight[e]
                    lag_px = ti.select(w < dtype(0.0), lag_off, lag_on)
                    speed = ti.sqrt(motion_x * motion_x + motion_y * motion_y)
                    if speed > dtype(0.0):
                        lag_px /= speed
                    _gauss_x, gx, sx = splat_taps(cx - dtype(column))
                    _gauss_y, gy, sy = splat_taps(cy - dtype(row))
                    along = w * (gx - (lag_px * motion_x) * sx)
                    across = (-w * lag_px * motion_y) * gx
                    if row >= reach and column >= reach and row < height - reach and column < width - reach:
                        corner = row_of(image_out, b, row - reach) + column - reach
                        for j in range(taps):
                            add_run(image_out, run_at(corner + j * width), gy[j] * along + sy[j] * across)
                    else:
                        for j in range(ti.max(row - reach, 0), ti.min(row + reach + 1, height)):
                            values = gy[j - row + reach] * along + sy[j - row + reach] * across
                            for i in ti.static(range(taps)):
                                at = column + i - reach
                                if at >= 0 and at < width:
                                    add(image_out, ti.Vector([b, j, at]), values[i])

    return splat_events


def splat_events(x, y, t, weight, window_ptr, motion, lag, frame, image_out, cfg: SplatConfig) -> None:
    """Launch; accumulates.  Float atomics on GPUs: sums repeat to a tolerance there, not bit for bit."""
    threads = owners(x, window_ptr)
    kernel = make_splat_events(float_of(x), cfg, motion.shape[1], *threads)
    launch(
        kernel, x, y, t, weight, window_ptr, motion, lag, frame, chunks_of(x, window_ptr, *threads), image_out
    )
