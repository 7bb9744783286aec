"""Adjoint of ``splat_events`` in the weights and the motion; see ``warp_backend/splat_adjoint.py``."""

from functools import cache

from evqr_kernels.config import SplatConfig
from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.splat import make_transport
from evqr_kernels.taichi_backend.sums import add_partials
from evqr_kernels.taichi_backend.transcendental import make_exp


@cache
def make_profile(dtype, cfg: SplatConfig):
    """Build g, g' and g'' at r; zero outside the radius."""
    norm = cfg.norm
    inverse_variance = 1.0 / cfg.epsilon_px**2
    inverse_radius_sq = 1.0 / cfg.radius_px**2
    exp = make_exp(dtype)

    @ti.func
    def profile(r):
        value = dtype(0.0)
        slope = dtype(0.0)
        second = dtype(0.0)
        q = dtype(1.0) - r * r * dtype(inverse_radius_sq)
        if q > dtype(0.0):
            gauss = dtype(norm) * exp(dtype(-0.5) * r * r * dtype(inverse_variance))
            rate = q * dtype(inverse_variance) + dtype(4.0 * inverse_radius_sq)
            bend = dtype(2.0 * inverse_variance) * q + dtype(4.0 * inverse_radius_sq)
            value = gauss * q * q
            slope = -r * gauss * q * rate
            second = (r * r * dtype(inverse_variance) - dtype(1.0)) * q * rate
            second += dtype(2.0 * inverse_radius_sq) * r * r * bend
            second *= gauss
        return value, slope, second

    return profile


@cache
def make_splat_events_adjoint(dtype, cfg: SplatConfig):
    """Build the adjoint for a precision and a shape of splat; one thread per (window, chunk)."""
    reach = cfg.reach
    margin = float(2 * reach + 1)
    profile = make_profile(dtype, cfg)
    transport = make_transport(dtype)

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
    ):
        for window, chunk in ti.ndrange(chunks_out.shape[0], chunks_out.shape[1]):
            begin = window_ptr[window]
            end = window_ptr[window + 1]
            length = (end - begin + chunks_out.shape[1] - 1) // chunks_out.shape[1]
            height = adj_image.shape[1]
            width = adj_image.shape[2]
            motion_x = motion[window, 0]
            motion_y = motion[window, 1]
            inverse_scale = dtype(1.0) / frame[window, 2]
            inverse_speed = dtype(0.0)
            speed = ti.sqrt(motion_x * motion_x + motion_y * motion_y)
            if speed > dtype(0.0):
                inverse_speed = dtype(1.0) / speed
            adj_motion_x = dtype(0.0)
            adj_motion_y = dtype(0.0)
            for e in range(begin + chunk * length, ti.min(begin + (chunk + 1) * length, end)):
                w = weight[e]
                lag_px = lag[window, 0]
                if w < dtype(0.0):
                    lag_px = lag[window, 1]
                lag_x = lag_px * motion_x * inverse_speed
                lag_y = lag_px * motion_y * inverse_speed
                cx = transport(x[e], t[e], motion_x, frame[window, 0], inverse_scale)
                cy = transport(y[e], t[e], motion_y, frame[window, 1], inverse_scale)
                adj_w = dtype(0.0)
                slope_x = dtype(0.0)
                slope_y = dtype(0.0)
                # also false for NaN
                if (
                    cx > dtype(-margin)
                    and cy > dtype(-margin)
                    and cx < dtype(width) + dtype(margin)
                    and cy < dtype(height) + dtype(margin)
                ):
                    column = int(ti.floor(cx + dtype(0.5)))
                    row = int(ti.floor(cy + dtype(0.5)))
                    for j in range(ti.max(row - reach, 0), ti.min(row + reach + 1, height)):
                        gy, sy, cy2 = profile(dtype(j) - cy)
                        for i in range(ti.max(column - reach, 0), ti.min(column + reach + 1, width)):
                            gx, sx, cx2 = profile(dtype(i) - cx)
                            adj = adj_image[window, j, i]
                            adj_w += adj * ((gx - lag_x * sx) * gy - lag_y * gx * sy)
                            slope_x += adj * ((sx - lag_x * cx2) * gy - lag_y * sx * sy)
                            slope_y += adj * ((gx - lag_x * sx) * sy - lag_y * gx * cy2)
                adj_weight_out[e] = adj_w
                adj_motion_x += t[e] * inverse_scale * w * slope_x
                adj_motion_y += t[e] * inverse_scale * w * slope_y
            chunks_out[window, chunk, 0] = adj_motion_x
            chunks_out[window, chunk, 1] = adj_motion_y

    return splat_events_adjoint


def splat_events_adjoint(
    x, y, t, weight, window_ptr, motion, lag, frame, adj_image, chunks_out, adj_weight_out, adj_motion_out,
    cfg: SplatConfig,
) -> None:  # fmt: skip
    """Launch both passes; overwrites."""
    launch(
        make_splat_events_adjoint(float_of(x), cfg),
        x, y, t, weight, window_ptr, motion, lag, frame, adj_image, chunks_out, adj_weight_out,
    )  # fmt: skip
    add_partials(chunks_out, adj_motion_out)
