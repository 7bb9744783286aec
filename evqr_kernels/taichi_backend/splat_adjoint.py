"""Adjoint of ``splat_events`` in weights, motion and positions; see ``warp_backend/splat_adjoint.py``."""

from functools import cache

from evqr_kernels.config import SplatConfig
from evqr_kernels.operations.events import CHUNK
from evqr_kernels.taichi_backend.language import array, float_of, row_of, run_at, ti
from evqr_kernels.taichi_backend.launches import clear, launch
from evqr_kernels.taichi_backend.splat import events_of, make_splat_taps
from evqr_kernels.taichi_backend.sums import add_partials
from evqr_kernels.taichi_backend.transport import make_middle, make_transport, make_velocity


@cache
def make_splat_curvature(dtype, cfg: SplatConfig):
    """Build the function that gives g'' at the taps around an event, from the Gaussian there."""
    reach = cfg.reach
    taps = 2 * reach + 1
    inverse_variance = 1.0 / cfg.epsilon_px**2
    inverse_radius_sq = 1.0 / cfg.radius_px**2
    bent = cfg.kind == "gaussian"

    @ti.func
    def splat_curvature(gauss, offset):
        curvature = ti.Vector.zero(dtype, taps)
        for k in ti.static(range(taps if bent else 0)):
            r = dtype(float(k - reach)) - offset
            q = dtype(1.0) - r * r * dtype(inverse_radius_sq)
            rate = q * dtype(inverse_variance) + dtype(4.0 * inverse_radius_sq)
            bend = dtype(2.0 * inverse_variance) * q + dtype(4.0 * inverse_radius_sq)
            second = (r * r * dtype(inverse_variance) - dtype(1.0)) * q * rate
            second += dtype(2.0 * inverse_radius_sq) * r * r * bend
            curvature[k] = ti.select(q > dtype(0.0), gauss[k] * second, dtype(0.0))
        return curvature

    return splat_curvature


@cache
def make_splat_events_adjoint(dtype, cfg: SplatConfig, parameters: int):
    """Build the adjoint for a precision, a splat and a motion; one thread per (window, chunk)."""
    reach = cfg.reach
    taps = 2 * reach + 1
    margin = float(taps)
    splat_taps = make_splat_taps(dtype, cfg)
    splat_curvature = make_splat_curvature(dtype, cfg)
    transport = make_transport(dtype)
    middle = make_middle(dtype)
    velocity = make_velocity(parameters)

    @ti.kernel
    def splat_events_adjoint(
        x: array(dtype, 1),
        y: array(dtype, 1),
        t: array(dtype, 1),
        weight: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        motion: array(dtype, 2),
        lag: array(dtype, 2),
        frame: array(dtype, 2),
        adj_image: array(dtype, 3),
        chunks_out: array(dtype, 3),
        adj_weight_out: array(dtype, 1),
        adj_x_out: array(dtype, 1),
        adj_y_out: array(dtype, 1),
    ):
        for window, chunk in ti.ndrange(chunks_out.shape[0], chunks_out.shape[1]):
            begin, end = events_of(window_ptr, window, x.shape[0])
            length = ti.max((end - begin + chunks_out.shape[1] - 1) // chunks_out.shape[1], CHUNK)
            height = adj_image.shape[1]
            width = adj_image.shape[2]
            origin_x = frame[window, 0]
            origin_y = frame[window, 1]
            scale = frame[window, 2]
            lag_on = lag[window, 0]
            lag_off = lag[window, 1]
            inverse_scale = dtype(1.0) / scale
            middle_x = middle(origin_x, scale, width)
            middle_y = middle(origin_y, scale, height)
            adj_motion = ti.Vector.zero(dtype, parameters)
            for e in range(begin + chunk * length, ti.min(begin + (chunk + 1) * length, end)):
                dx = x[e] - middle_x
                dy = y[e] - middle_y
                motion_x, motion_y = velocity(motion, window, dx, dy)
                cx = transport(x[e], t[e], motion_x, origin_x, inverse_scale)
                cy = transport(y[e], t[e], motion_y, origin_y, inverse_scale)
                adj_w = dtype(0.0)
                position_x = dtype(0.0)
                position_y = dtype(0.0)
                # also false for NaN
                if (
                    cx > dtype(-margin)
                    and cy > dtype(-margin)
                    and cx < dtype(width) + dtype(margin)
                    and cy < dtype(height) + dtype(margin)
                ):
                    column = int(ti.floor(cx + dtype(0.5)))
                    row = int(ti.floor(cy + dtype(0.5)))
                    # along columns first, with g, g' and g'' each: what is left are products of one row
                    gauss, g, s = splat_taps(cy - dtype(row))
                    c = splat_curvature(gauss, cy - dtype(row))
                    by_g = ti.Vector.zero(dtype, taps)
                    by_s = ti.Vector.zero(dtype, taps)
                    by_c = ti.Vector.zero(dtype, taps)
                    if row >= reach and column >= reach and row < height - reach and column < width - reach:
                        corner = row_of(adj_image, window, row - reach) + column - reach
                        for j in range(taps):
                            at = run_at(corner + j * width)
                            values = ti.Vector([adj_image[0, 0, at + i] for i in range(taps)])
                            by_g += g[j] * values
                            by_s += s[j] * values
                            by_c += c[j] * values
                    else:
                        for j in range(ti.max(reach - row, 0), ti.min(height - row + reach, taps)):
                            for i in ti.static(range(taps)):
                                at = column + i - reach
                                if at >= 0 and at < width:
                                    value = adj_image[window, row + j - reach, at]
                                    by_g[i] += g[j] * value
                                    by_s[i] += s[j] * value
                                    by_c[i] += c[j] * value
                    w = weight[e]
                    lag_px = ti.select(w < dtype(0.0), lag_off, lag_on)
                    speed = ti.sqrt(motion_x * motion_x + motion_y * motion_y)
                    if speed > dtype(0.0):
                        lag_px /= speed
                    lag_x = lag_px * motion_x
                    lag_y = lag_px * motion_y
                    gauss_x, gx, sx = splat_taps(cx - dtype(column))
                    ahead = gx - lag_x * sx
                    adj_w = ahead.dot(by_g) - lag_y * gx.dot(by_s)
                    slope_y = inverse_scale * w * (ahead.dot(by_s) - lag_y * gx.dot(by_c))
                    ahead = sx - lag_x * splat_curvature(gauss_x, cx - dtype(column))
                    slope_x = inverse_scale * w * (ahead.dot(by_g) - lag_y * sx.dot(by_s))
                    position_x = -slope_x
                    position_y = -slope_y
                    if ti.static(parameters == 6):
                        position_x += t[e] * (motion[window, 2] * slope_x + motion[window, 4] * slope_y)
                        position_y += t[e] * (motion[window, 3] * slope_x + motion[window, 5] * slope_y)
                    adj_x = t[e] * slope_x
                    adj_y = t[e] * slope_y
                    adj_motion[0] += adj_x
                    adj_motion[1] += adj_y
                    if ti.static(parameters == 6):
                        adj_motion[2] += adj_x * dx
                        adj_motion[3] += adj_x * dy
                        adj_motion[4] += adj_y * dx
                        adj_motion[5] += adj_y * dy
                adj_weight_out[e] = adj_w
                adj_x_out[e] = position_x
                adj_y_out[e] = position_y
            for k in ti.static(range(parameters)):
                chunks_out[window, chunk, k] = adj_motion[k]

    return splat_events_adjoint


def splat_events_adjoint(
    x, y, t, weight, window_ptr, motion, lag, frame, adj_image, chunks_out, adj_weight_out, adj_motion_out,
    adj_x_out, adj_y_out, cfg: SplatConfig,
) -> None:  # fmt: skip
    """Launch both passes; overwrites."""
    for of_events in (adj_weight_out, adj_x_out, adj_y_out):
        clear(of_events)  # that no window names
    launch(
        make_splat_events_adjoint(float_of(x), cfg, motion.shape[1]),
        x, y, t, weight, window_ptr, motion, lag, frame, adj_image, chunks_out, adj_weight_out, adj_x_out,
        adj_y_out,
    )  # fmt: skip
    add_partials(chunks_out, adj_motion_out)
