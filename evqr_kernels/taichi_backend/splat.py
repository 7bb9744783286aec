"""Events to images; the formulas are in ``warp_backend/splat.py``."""

from functools import cache

from evqr_kernels.config import SplatConfig
from evqr_kernels.taichi_backend.language import array, float_of, is_on_cpu, ti
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.transcendental import make_exp

CHUNK = 64
"""Events that one thread of a GPU takes one after another: what belongs to the window is looked up once."""


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


def events_a_thread(x) -> int:
    """Choose how many events of a window a thread takes: on the CPU all, so that the window has one owner."""
    return max(x.shape[0], 1) if is_on_cpu(x) else CHUNK


def owners(x, window_ptr) -> tuple[bool, bool]:
    """Tell whether windows have several threads each, and whether there is one thread in all."""
    on_cpu = is_on_cpu(x)
    return not on_cpu, on_cpu and window_ptr.shape[0] == 2


@cache
def make_bin_events(dtype, shared: bool, alone: bool):
    """Build the binning kernel; one thread per (window, chunk of the longest window)."""
    add = make_add(shared)

    @ti.kernel
    def bin_events(
        x: array(dtype, 1),
        y: array(dtype, 1),
        weight: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        inverse_reduction: dtype,
        chunk: ti.i32,
        image_out: array(dtype, 3),
    ):
        ti.loop_config(serialize=alone)
        for b, k in ti.ndrange(image_out.shape[0], (x.shape[0] + chunk - 1) // chunk):
            right = dtype(image_out.shape[2])
            bottom = dtype(image_out.shape[1])
            first = window_ptr[b] + k * chunk
            for e in range(first, ti.min(first + chunk, window_ptr[b + 1])):
                column = (x[e] + dtype(0.5)) * inverse_reduction
                row = (y[e] + dtype(0.5)) * inverse_reduction
                # written so that it is false for NaN
                if column >= dtype(0.0) and row >= dtype(0.0) and column < right and row < bottom:
                    add(image_out, ti.Vector([b, int(row), int(column)]), weight[e])

    return bin_events


def bin_events(x, y, weight, window_ptr, reduction: float, image_out) -> None:
    """Launch; accumulates.  Float atomics on GPUs: sums repeat to a tolerance there, not bit for bit."""
    kernel = make_bin_events(float_of(x), *owners(x, window_ptr))
    launch(kernel, x, y, weight, window_ptr, 1.0 / reduction, events_a_thread(x), image_out)


@cache
def make_transport(dtype):
    """Build the function that brings an event to image pixels at the reference time."""

    @ti.func
    def transport(position, t, motion, origin, inverse_scale):
        return (position - t * motion - origin + dtype(0.5)) * inverse_scale - dtype(0.5)

    return transport


@cache
def make_splat_taps(dtype, cfg: SplatConfig):
    """Build the function that gives g and g' at the taps around an event ``offset`` px off the middle one."""
    reach = cfg.reach
    taps = 2 * reach + 1
    gauss = [cfg.norm * cfg.gauss(k) for k in range(-reach, reach + 1)]
    inverse_variance = 1.0 / cfg.epsilon_px**2
    inverse_radius_sq = 1.0 / cfg.radius_px**2
    exp = make_exp(dtype)

    @ti.func
    def splat_taps(offset):
        # exp(-(k - f)^2 / 2 eps^2) = exp(-f^2 / 2 eps^2) exp(f / eps^2)^k exp(-k^2 / 2 eps^2): two exps, not
        # one a tap
        value = ti.Vector.zero(dtype, taps)
        slope = ti.Vector.zero(dtype, taps)
        up = exp(offset * dtype(inverse_variance))
        down = dtype(1.0) / up
        right = exp(dtype(-0.5) * offset * offset * dtype(inverse_variance))
        left = right
        for k in ti.static(range(reach + 1)):
            value[reach + k] = right * dtype(gauss[reach + k])
            value[reach - k] = left * dtype(gauss[reach - k])
            right *= up
            left *= down
        for k in ti.static(range(taps)):
            r = dtype(float(k - reach)) - offset
            q = ti.max(dtype(1.0) - r * r * dtype(inverse_radius_sq), dtype(0.0))
            rate = q * dtype(inverse_variance) + dtype(4.0 * inverse_radius_sq)
            slope[k] = -r * value[k] * q * rate
            value[k] = value[k] * q * q
        return value, slope

    return splat_taps


@cache
def make_splat_events(dtype, cfg: SplatConfig, shared: bool, alone: bool):
    """Build the splat kernel for a precision and a shape of splat; one thread per (window, chunk)."""
    add = make_add(shared)
    reach = cfg.reach
    taps = 2 * reach + 1
    margin = float(taps)
    splat_taps = make_splat_taps(dtype, cfg)
    transport = make_transport(dtype)

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
        chunk: ti.i32,
        image_out: array(dtype, 3),
    ):
        ti.loop_config(serialize=alone)
        for b, k in ti.ndrange(image_out.shape[0], (x.shape[0] + chunk - 1) // chunk):
            inverse_scale = dtype(1.0) / frame[b, 2]
            motion_x = motion[b, 0]
            motion_y = motion[b, 1]
            origin_x = frame[b, 0]
            origin_y = frame[b, 1]
            lag_on = lag[b, 0]
            lag_off = lag[b, 1]
            speed = ti.sqrt(motion_x * motion_x + motion_y * motion_y)
            inverse_speed = dtype(0.0)
            if speed > dtype(0.0):
                inverse_speed = dtype(1.0) / speed
            height = image_out.shape[1]
            width = image_out.shape[2]
            first = window_ptr[b] + k * chunk
            for e in range(first, ti.min(first + chunk, window_ptr[b + 1])):
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
                    lag_px = ti.select(w < dtype(0.0), lag_off, lag_on) * inverse_speed
                    gx, sx = splat_taps(cx - dtype(column))
                    gy, sy = splat_taps(cy - dtype(row))
                    along = w * (gx - (lag_px * motion_x) * sx)
                    across = (-w * lag_px * motion_y) * gx
                    for j in range(ti.max(row - reach, 0), ti.min(row + reach + 1, height)):
                        g = gy[j - row + reach]
                        s = sy[j - row + reach]
                        for i in ti.static(range(taps)):
                            at = column + i - reach
                            if at >= 0 and at < width:
                                add(image_out, ti.Vector([b, j, at]), g * along[i] + s * across[i])

    return splat_events


def splat_events(x, y, t, weight, window_ptr, motion, lag, frame, image_out, cfg: SplatConfig) -> None:
    """Launch; accumulates.  Float atomics on GPUs: sums repeat to a tolerance there, not bit for bit."""
    kernel = make_splat_events(float_of(x), cfg, *owners(x, window_ptr))
    launch(kernel, x, y, t, weight, window_ptr, motion, lag, frame, events_a_thread(x), image_out)
