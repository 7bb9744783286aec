"""Adjoint of ``splat_events`` in the weights and the motion; the formulas are in ``splat.py``.

A gather: each thread takes a chunk of a window's events and reads the image's adjoint around each, so there
is no atomic, and the sums over chunks are added up in a second pass.  It needs the profile's second
derivative,

    g''(r) = gauss(r) / c ((r^2 / eps^2 - 1) q k + 2 (r / R)^2 (2 q / eps^2 + 4 / R^2)),
    q = 1 - (r / R)^2,    k = q / eps^2 + 4 / R^2

The splat is separable: the pixels around an event are summed along columns first, with g, g' and g'' each
(``rows``), and what is left are products of vectors of one row.
"""

from functools import cache

import warp as wp

from evqr_kernels.config import SplatConfig
from evqr_kernels.warp_backend.language import launch, module_of, neighbours, vector
from evqr_kernels.warp_backend.splat import make_splat_taps
from evqr_kernels.warp_backend.sums import add_partials
from evqr_kernels.warp_backend.transport import (
    make_middle,
    make_transport,
    make_velocity,
    make_velocity_adjoint,
)


@cache
def make_splat_curvature(dtype: type, cfg: SplatConfig) -> wp.Function:
    """Build the function that gives g'' at the taps around an event, from the Gaussian there."""
    reach = cfg.reach
    vec_taps = vector(2 * reach + 1, dtype)
    inverse_variance = wp.constant(dtype(1.0 / cfg.epsilon_px**2))
    inverse_radius_sq = wp.constant(dtype(1.0 / cfg.radius_px**2))

    @wp.func
    def splat_curvature(gauss: vec_taps, offset: dtype) -> vec_taps:
        curvature = vec_taps()
        for k in range(wp.static(2 * reach + 1)):
            r = dtype(k - reach) - offset
            q = dtype(1.0) - r * r * inverse_radius_sq
            if q > dtype(0.0):
                rate = q * inverse_variance + dtype(4.0) * inverse_radius_sq
                bend = dtype(2.0) * q * inverse_variance + dtype(4.0) * inverse_radius_sq
                second = (r * r * inverse_variance - dtype(1.0)) * q * rate
                second += dtype(2.0) * r * r * inverse_radius_sq * bend
                curvature[k] = gauss[k] * second
        return curvature

    return splat_curvature


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
    splat_taps = make_splat_taps(dtype, cfg)
    splat_curvature = make_splat_curvature(dtype, cfg)
    row_around = make_row_around(dtype, taps)
    transport = make_transport(dtype)
    middle = make_middle(dtype)
    velocity = make_velocity(dtype, parameters)
    velocity_adjoint = make_velocity_adjoint(dtype, parameters)

    @wp.kernel(
        module=module_of(f"splat_adjoint_{parameters}_{taps}_{cfg.epsilon_px:g}_{cfg.radius_px:g}", dtype),
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
                gauss, g, s = splat_taps(cy - dtype(row))
                c = splat_curvature(gauss, cy - dtype(row))
                by_g = vec_taps()
                by_s = vec_taps()
                by_c = vec_taps()
                for j in range(wp.static(taps)):
                    values = row_around(adj_image, adj_rows, window, row + j - reach, column - reach)
                    by_g += g[j] * values
                    by_s += s[j] * values
                    by_c += c[j] * values
                w = weight[e]
                lag_px = lag[window, 0]
                if w < dtype(0.0):
                    lag_px = lag[window, 1]
                speed = wp.sqrt(motion_x * motion_x + motion_y * motion_y)
                if speed > dtype(0.0):
                    lag_px /= speed
                lag_x = lag_px * motion_x
                lag_y = lag_px * motion_y
                gauss, g, s = splat_taps(cx - dtype(column))
                ahead = g - lag_x * s
                adj_w = wp.dot(ahead, by_g) - lag_y * wp.dot(g, by_s)
                slope_y = wp.dot(ahead, by_s) - lag_y * wp.dot(g, by_c)
                ahead = s - lag_x * splat_curvature(gauss, cx - dtype(column))
                slope_x = wp.dot(ahead, by_g) - lag_y * wp.dot(s, by_s)
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
