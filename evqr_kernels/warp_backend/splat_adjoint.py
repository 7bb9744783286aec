"""Adjoint of ``splat_events`` in the weights and the motion; the formulas are in ``splat.py``.

A gather: each thread takes a chunk of a window's events and reads the image's adjoint around each, so there
is no atomic, and the sums over chunks are added up in a second pass.  It needs the profile's second
derivative,

    g''(r) = gauss(r) / c ((r^2 / eps^2 - 1) q k + 2 (r / R)^2 (2 q / eps^2 + 4 / R^2)),
    q = 1 - (r / R)^2,    k = q / eps^2 + 4 / R^2

The splat is separable: the pixels around an event are summed along columns first, with g, g' and g'' each,
and what is left is one row for each of the three.
"""

from functools import cache

import warp as wp

from evqr_kernels.config import SplatConfig
from evqr_kernels.warp_backend.language import launch, module_of, neighbours, vector
from evqr_kernels.warp_backend.sums import add_partials
from evqr_kernels.warp_backend.transport import (
    make_middle,
    make_transport,
    make_velocity,
    make_velocity_adjoint,
)


@cache
def make_splat_tap(dtype: type, cfg: SplatConfig) -> wp.Function:
    """Build the function that gives g, g' and g'' at a tap that is ``r`` px off, from the Gaussian there."""
    inverse_variance = wp.constant(dtype(1.0 / cfg.epsilon_px**2))
    inverse_radius_sq = wp.constant(dtype(1.0 / cfg.radius_px**2))

    @wp.func
    def splat_tap(gauss: dtype, r: dtype):
        q = wp.max(dtype(1.0) - r * r * inverse_radius_sq, dtype(0.0))
        rate = q * inverse_variance + dtype(4.0) * inverse_radius_sq
        bend = dtype(2.0) * q * inverse_variance + dtype(4.0) * inverse_radius_sq
        second = (r * r * inverse_variance - dtype(1.0)) * q * rate
        second += dtype(2.0) * r * r * inverse_radius_sq * bend
        curvature = wp.where(q > dtype(0.0), gauss * second, dtype(0.0))
        return gauss * q * q, -r * gauss * q * rate, curvature

    return splat_tap


@cache
def make_row_around(dtype: type, taps: int) -> wp.Function:
    """Build the look-up of ``taps`` pixels of a row, 0 where they are outside the image."""
    vec_taps = vector(taps, dtype)

    @wp.func
    def row_around(
        image: wp.array3d(dtype=dtype), rows: wp.array3d(dtype=vec_taps), window: int, y: int, x: int
    ) -> vec_taps:
        values = vec_taps()
        if y >= 0 and y < image.shape[1]:
            if x >= 0 and x + taps <= image.shape[2]:
                values = rows[window, y, x]
            else:
                for i in range(taps):
                    if x + i >= 0 and x + i < image.shape[2]:
                        values[i] = image[window, y, x + i]
        return values

    return row_around


@cache
def make_splat_events_adjoint(dtype: type, cfg: SplatConfig, parameters: int) -> wp.Kernel:
    """Build the adjoint for a precision, a splat and a motion; launch: one thread per (window, chunk).

    ``rows``: `neighbours` of the image's adjoint.
    """
    reach = cfg.reach
    taps = 2 * reach + 1
    vec_taps = vector(taps, dtype)
    vec_parameters = vector(parameters, dtype)
    registers = 80 if parameters == 2 else 96  # fewer would spill
    splat_tap = make_splat_tap(dtype, cfg)
    inverse_variance = wp.constant(dtype(1.0 / cfg.epsilon_px**2))
    gauss_at_tap = wp.constant(vector(reach + 1, dtype)(*(cfg.norm * cfg.gauss(k) for k in range(reach + 1))))
    row_around = make_row_around(dtype, taps)
    transport = make_transport(dtype)
    middle = make_middle(dtype)
    velocity = make_velocity(dtype, parameters)
    velocity_adjoint = make_velocity_adjoint(dtype, parameters)

    @wp.kernel(
        module=module_of(f"splat_adjoint_{parameters}_{taps}_{cfg.epsilon_px:g}_{cfg.radius_px:g}", dtype),
        cuda_max_registers=registers if dtype is wp.float32 else registers + 64,
    )
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
        adj_rows: wp.array3d(dtype=vec_taps),
        chunks_out: wp.array3d(dtype=dtype),
        adj_weight_out: wp.array(dtype=dtype),
    ):
        window, chunk = wp.tid()
        begin = window_ptr[window]
        end = window_ptr[window + 1]
        length = (end - begin + chunks_out.shape[1] - 1) // chunks_out.shape[1]
        height = adj_image.shape[1]
        width = adj_image.shape[2]
        adj_motion = vec_parameters()
        for e in range(begin + chunk * length, wp.min(begin + (chunk + 1) * length, end)):
            scale = frame[window, 2]
            inverse_scale = dtype(1.0) / scale
            dx = x[e] - middle(frame[window, 0], scale, width)
            dy = y[e] - middle(frame[window, 1], scale, height)
            motion_x, motion_y = velocity(motion, window, dx, dy)
            cx = transport(x[e], t[e], motion_x, frame[window, 0], inverse_scale)
            cy = transport(y[e], t[e], motion_y, frame[window, 1], inverse_scale)
            adj_w = dtype(0.0)
            # also false for NaN
            if (
                cx > dtype(-taps)
                and cy > dtype(-taps)
                and cx < dtype(width + taps)
                and cy < dtype(height + taps)
            ):
                column = int(wp.floor(cx + dtype(0.5)))
                row = int(wp.floor(cy + dtype(0.5)))
                by_g = vec_taps()
                by_s = vec_taps()
                by_c = vec_taps()
                # Gaussians as in `splat_taps`, one after another: all at once they would take the registers
                offset = cy - dtype(row)
                right = wp.exp(dtype(-0.5) * offset * offset * inverse_variance)
                left = right
                up = wp.exp(offset * inverse_variance)
                down = dtype(1.0) / up
                for k in range(wp.static(reach + 1)):
                    for side in range(2):
                        if side == 0 or k > 0:
                            tap = wp.where(side == 0, k, -k)
                            gauss = wp.where(side == 0, right, left) * gauss_at_tap[k]
                            g, s, c = splat_tap(gauss, dtype(tap) - offset)
                            values = row_around(adj_image, adj_rows, window, row + tap, column - reach)
                            by_g += g * values
                            by_s += s * values
                            by_c += c * values
                    right *= up
                    left *= down
                w = weight[e]
                lag_px = lag[window, 0]
                if w < dtype(0.0):
                    lag_px = lag[window, 1]
                speed = wp.sqrt(motion_x * motion_x + motion_y * motion_y)
                if speed > dtype(0.0):
                    lag_px /= speed
                lag_x = lag_px * motion_x
                lag_y = lag_px * motion_y
                slope_x = dtype(0.0)
                slope_y = dtype(0.0)
                offset = cx - dtype(column)
                right = wp.exp(dtype(-0.5) * offset * offset * inverse_variance)
                left = right
                up = wp.exp(offset * inverse_variance)
                down = dtype(1.0) / up
                for k in range(wp.static(reach + 1)):
                    for side in range(2):
                        if side == 0 or k > 0:
                            tap = wp.where(side == 0, k, -k)
                            gauss = wp.where(side == 0, right, left) * gauss_at_tap[k]
                            g, s, c = splat_tap(gauss, dtype(tap) - offset)
                            ahead = g - lag_x * s
                            turned = s - lag_x * c
                            adj_w += ahead * by_g[reach + tap]
                            adj_w -= lag_y * g * by_s[reach + tap]
                            slope_x += turned * by_g[reach + tap]
                            slope_x -= lag_y * s * by_s[reach + tap]
                            slope_y += ahead * by_s[reach + tap]
                            slope_y -= lag_y * g * by_c[reach + tap]
                    right *= up
                    left *= down
                factor = t[e] * inverse_scale * w
                adj_motion += velocity_adjoint(factor * slope_x, factor * slope_y, dx, dy)
            adj_weight_out[e] = adj_w
        for k in range(wp.static(parameters)):
            chunks_out[window, chunk, k] = adj_motion[k]

    return splat_events_adjoint


def splat_events_adjoint(
    x, y, t, weight, window_ptr, motion, lag, frame, adj_image, chunks_out, adj_weight_out, adj_motion_out,
    cfg: SplatConfig,
) -> None:  # fmt: skip
    """Launch both passes; overwrites."""
    launch(
        make_splat_events_adjoint(x.dtype, cfg, motion.shape[1]),
        chunks_out.shape[:2],
        inputs=[
            x,
            y,
            t,
            weight,
            window_ptr,
            motion,
            lag,
            frame,
            adj_image,
            neighbours(adj_image, 2 * cfg.reach + 1),
        ],
        outputs=[chunks_out, adj_weight_out],
        device=x.device,
    )
    add_partials(chunks_out, adj_motion_out)
