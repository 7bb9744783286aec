"""Adjoint of ``splat_events`` in the weights and the motion; the formulas are in ``splat.py``.

A gather: each thread takes a chunk of a window's events and reads the image's adjoint around each, so there
is no atomic, and the sums over chunks are added up in a second pass.  It needs the profile's second
derivative,

    g''(r) = gauss(r) / c ((r^2 / eps^2 - 1) q k + 2 (r / R)^2 (2 q / eps^2 + 4 / R^2)),
    q = 1 - (r / R)^2,    k = q / eps^2 + 4 / R^2

and is not on the path of reading a code, so it favours clarity: one exponential a tap.
"""

from functools import cache

import warp as wp

from evqr_kernels.config import SplatConfig
from evqr_kernels.warp_backend.language import launch, module_of
from evqr_kernels.warp_backend.splat import make_transport
from evqr_kernels.warp_backend.sums import add_partials


@cache
def make_splat_events_adjoint(dtype: type, cfg: SplatConfig) -> wp.Kernel:
    """Build the adjoint for a precision and a shape of splat; launch: one thread per (window, chunk)."""
    reach = cfg.reach
    taps = 2 * reach + 1
    norm = wp.constant(dtype(cfg.norm))
    inverse_variance = wp.constant(dtype(1.0 / cfg.epsilon_px**2))
    inverse_radius_sq = wp.constant(dtype(1.0 / cfg.radius_px**2))
    vec3 = wp.types.vector(length=3, dtype=dtype)
    transport = make_transport(dtype)

    @wp.func
    def profile(r: dtype) -> vec3:
        q = dtype(1.0) - r * r * inverse_radius_sq
        result = vec3()
        if q > dtype(0.0):
            gauss = norm * wp.exp(dtype(-0.5) * r * r * inverse_variance)
            rate = q * inverse_variance + dtype(4.0) * inverse_radius_sq
            bend = dtype(2.0) * q * inverse_variance + dtype(4.0) * inverse_radius_sq
            second = (r * r * inverse_variance - dtype(1.0)) * q * rate
            second += dtype(2.0) * r * r * inverse_radius_sq * bend
            result = vec3(gauss * q * q, -r * gauss * q * rate, gauss * second)
        return result

    @wp.kernel(module=module_of(f"splat_adjoint_{taps}_{cfg.epsilon_px:g}_{cfg.radius_px:g}", dtype))
    def splat_events_adjoint(
        x: wp.array(dtype=dtype),
        y: wp.array(dtype=dtype),
        t: wp.array(dtype=dtype),
        weight: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        motion: wp.array2d(dtype=dtype),
        lag: wp.array2d(dtype=dtype),
        frame: wp.array2d(dtype=dtype),
        adj_image: wp.array3d(dtype=dtype),
        chunks_out: wp.array3d(dtype=dtype),
        adj_weight_out: wp.array(dtype=dtype),
    ):
        window, chunk = wp.tid()
        begin = window_ptr[window]
        end = window_ptr[window + 1]
        length = (end - begin + chunks_out.shape[1] - 1) // chunks_out.shape[1]
        height = adj_image.shape[1]
        width = adj_image.shape[2]
        motion_x = motion[window, 0]
        motion_y = motion[window, 1]
        inverse_scale = dtype(1.0) / frame[window, 2]
        inverse_speed = dtype(0.0)
        speed = wp.sqrt(motion_x * motion_x + motion_y * motion_y)
        if speed > dtype(0.0):
            inverse_speed = dtype(1.0) / speed
        adj_motion_x = dtype(0.0)
        adj_motion_y = dtype(0.0)
        for e in range(begin + chunk * length, wp.min(begin + (chunk + 1) * length, end)):
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
                cx > dtype(-taps)
                and cy > dtype(-taps)
                and cx < dtype(width + taps)
                and cy < dtype(height + taps)
            ):
                column = int(wp.floor(cx + dtype(0.5)))
                row = int(wp.floor(cy + dtype(0.5)))
                for j in range(wp.max(row - reach, 0), wp.min(row + reach + 1, height)):
                    gy = profile(dtype(j) - cy)
                    for i in range(wp.max(column - reach, 0), wp.min(column + reach + 1, width)):
                        gx = profile(dtype(i) - cx)
                        adj = adj_image[window, j, i]
                        adj_w += adj * ((gx[0] - lag_x * gx[1]) * gy[0] - lag_y * gx[0] * gy[1])
                        slope_x += adj * ((gx[1] - lag_x * gx[2]) * gy[0] - lag_y * gx[1] * gy[1])
                        slope_y += adj * ((gx[0] - lag_x * gx[1]) * gy[1] - lag_y * gx[0] * gy[2])
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
        make_splat_events_adjoint(x.dtype, cfg),
        chunks_out.shape[:2],
        inputs=[x, y, t, weight, window_ptr, motion, lag, frame, adj_image],
        outputs=[chunks_out, adj_weight_out],
        device=x.device,
    )
    add_partials(chunks_out, adj_motion_out)
