"""Events to images; the formulas are in ``warp_backend/splat.py``."""

from functools import cache

from evqr_kernels.config import SplatConfig
from evqr_kernels.taichi_backend.exponential import make_exp
from evqr_kernels.taichi_backend.language import array, float_of, launch, ti


@ti.func
def window_of(window_ptr: ti.template(), event):
    """Find the window of an event: the last one that begins at or before it, by bisection."""
    low = 0
    high = window_ptr.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if window_ptr[middle] <= event:
            low = middle
        else:
            high = middle
    return low


@cache
def make_bin_events(dtype):
    """Build the binning kernel; one thread per event."""

    @ti.kernel
    def bin_events(
        x: array(dtype, 1),
        y: array(dtype, 1),
        weight: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        inverse_reduction: dtype,
        image_out: array(dtype, 3),
    ):
        for e in range(x.shape[0]):
            column = int(ti.floor((x[e] + dtype(0.5)) * inverse_reduction))
            row = int(ti.floor((y[e] + dtype(0.5)) * inverse_reduction))
            if row >= 0 and column >= 0 and row < image_out.shape[1] and column < image_out.shape[2]:
                image_out[window_of(window_ptr, e), row, column] += weight[e]

    return bin_events


def bin_events(x, y, weight, window_ptr, reduction: float, image_out) -> None:
    """Launch; accumulates.  Float atomics: sums repeat to a tolerance, not bit for bit."""
    launch(make_bin_events(float_of(x)), x, y, weight, window_ptr, 1.0 / reduction, image_out)


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
def make_splat_events(dtype, cfg: SplatConfig):
    """Build the splat kernel for one precision and shape of splat; one thread per event."""
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
        image_out: array(dtype, 3),
    ):
        for e in range(x.shape[0]):
            window = window_of(window_ptr, e)
            inverse_scale = dtype(1.0) / frame[window, 2]
            motion_x = motion[window, 0]
            motion_y = motion[window, 1]
            cx = transport(x[e], t[e], motion_x, frame[window, 0], inverse_scale)
            cy = transport(y[e], t[e], motion_y, frame[window, 1], inverse_scale)
            height = image_out.shape[1]
            width = image_out.shape[2]
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
                lag_px = lag[window, 0]
                if w < dtype(0.0):
                    lag_px = lag[window, 1]
                speed = ti.sqrt(motion_x * motion_x + motion_y * motion_y)
                if speed > dtype(0.0):
                    lag_px /= speed
                gx, sx = splat_taps(cx - dtype(column))
                gy, sy = splat_taps(cy - dtype(row))
                along = w * (gx - (lag_px * motion_x) * sx)
                across = (-w * lag_px * motion_y) * gx
                for j in range(ti.max(row - reach, 0), ti.min(row + reach + 1, height)):
                    g = gy[j - row + reach]
                    s = sy[j - row + reach]
                    for k in ti.static(range(taps)):
                        i = column + k - reach
                        if i >= 0 and i < width:
                            image_out[window, j, i] += g * along[k] + s * across[k]

    return splat_events


def splat_events(x, y, t, weight, window_ptr, motion, lag, frame, image_out, cfg: SplatConfig) -> None:
    """Launch; accumulates.  Float atomics: sums repeat to a tolerance, not bit for bit."""
    kernel = make_splat_events(float_of(x), cfg)
    launch(kernel, x, y, t, weight, window_ptr, motion, lag, frame, image_out)
