"""Events to images.

``bin_events`` counts: each event adds its weight to the pixel it falls in, at a reduced resolution.

``splat_events`` transports and splats.  With c_i = (x_i, y_i) - t_i motion, brought to image pixels by the window's origin
and scale, and d the direction of the motion:

    image(x) = sum_i w_i (1 - lag_i d . grad) N(x - c_i),        N(r) = g(r_x) g(r_y)     (SplatConfig)

The directional derivative undoes a first-order pixel that lags by ``lag_i`` image px along the motion; ON and OFF events
(the sign of w_i) have a lag each.  It costs one more multiply-add a tap, for the splat is separable:

    tap(i, j) = a_i g_j + b_i g'_j,   a_i = w (g_i - lag d_x g'_i),   b_i = -w lag d_y g_i

Adjoint, for adj = d loss / d image and e(r) the tap above without w:

    adj_w_i      = sum_x adj(x) e(x - c_i)
    adj_motion   = sum_i t_i / scale  w_i sum_x adj(x) grad e(x - c_i)

(the lag and the direction d are parameters: no derivative is taken with respect to them).
"""

from functools import cache

import warp as wp

from evqr_kernels.config import SplatConfig


@cache
def make_bin_events(dtype: type):
    """Build the binning kernel; launch: one thread per event."""

    @wp.kernel(module="unique", enable_backward=False)
    def bin_events(
        x: wp.array(dtype=dtype),
        y: wp.array(dtype=dtype),
        weight: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        inverse_reduction: dtype,
        image_out: wp.array3d(dtype=dtype),
    ):
        e = wp.tid()
        window = wp.lower_bound(window_ptr, e + 1) - 1
        column = int(wp.floor((x[e] + dtype(0.5)) * inverse_reduction))
        row = int(wp.floor((y[e] + dtype(0.5)) * inverse_reduction))
        if row >= 0 and column >= 0 and row < image_out.shape[1] and column < image_out.shape[2]:
            wp.atomic_add(image_out, window, row, column, weight[e])

    return bin_events


@cache
def make_splat_events(dtype: type, cfg: SplatConfig):
    """Build the splat kernel for one precision and shape of splat; launch: one thread per event."""
    reach = cfg.reach
    taps = 2 * reach + 1
    vec_taps = wp.types.vector(length=taps, dtype=dtype)
    inverse_variance = 1.0 / cfg.epsilon_px**2
    inverse_radius_sq = 1.0 / cfg.radius_px**2
    norm = cfg.norm

    @wp.kernel(module="unique", enable_backward=False)
    def splat_events(
        x: wp.array(dtype=dtype),
        y: wp.array(dtype=dtype),
        t: wp.array(dtype=dtype),
        weight: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        motion: wp.array2d(dtype=dtype),
        lag: wp.array2d(dtype=dtype),
        frame: wp.array2d(dtype=dtype),
        image_out: wp.array3d(dtype=dtype),
    ):
        e = wp.tid()
        window = wp.lower_bound(window_ptr, e + 1) - 1
        inverse_scale = dtype(1.0) / frame[window, 2]
        half = dtype(0.5)
        cx = (x[e] - t[e] * motion[window, 0] - frame[window, 0] + half) * inverse_scale - half
        cy = (y[e] - t[e] * motion[window, 1] - frame[window, 1] + half) * inverse_scale - half
        height = image_out.shape[1]
        width = image_out.shape[2]
        # also false for NaN
        if not (cx > dtype(-taps) and cy > dtype(-taps) and cx < dtype(width + taps) and cy < dtype(height + taps)):
            return
        column = int(wp.floor(cx + half))
        row = int(wp.floor(cy + half))
        fx = cx - dtype(column)
        fy = cy - dtype(row)

        w = weight[e]
        speed = wp.sqrt(motion[window, 0] * motion[window, 0] + motion[window, 1] * motion[window, 1])
        lag_x = dtype(0.0)
        lag_y = dtype(0.0)
        if speed > dtype(0.0):
            lag_px = lag[window, 0]
            if w < dtype(0.0):
                lag_px = lag[window, 1]
            lag_x = lag_px * motion[window, 0] / speed
            lag_y = lag_px * motion[window, 1] / speed

        # exp(-(k - f)^2 / 2 eps^2) = exp(-f^2 / 2 eps^2) exp(f / eps^2)^k exp(-k^2 / 2 eps^2): two exps an axis, not one a tap
        gx = vec_taps()
        gy = vec_taps()
        sx = vec_taps()
        sy = vec_taps()
        ratio_x = wp.exp(fx * dtype(wp.static(inverse_variance)))
        ratio_y = wp.exp(fy * dtype(wp.static(inverse_variance)))
        base_x = dtype(wp.static(norm)) * wp.exp(-half * fx * fx * dtype(wp.static(inverse_variance)))
        base_y = dtype(wp.static(norm)) * wp.exp(-half * fy * fy * dtype(wp.static(inverse_variance)))
        up_x = dtype(1.0)
        up_y = dtype(1.0)
        down_x = dtype(1.0)
        down_y = dtype(1.0)
        for k in range(wp.static(reach + 1)):
            gauss = wp.exp(-half * dtype(k * k) * dtype(wp.static(inverse_variance)))
            gx[reach + k] = base_x * up_x * gauss
            gy[reach + k] = base_y * up_y * gauss
            gx[reach - k] = base_x * down_x * gauss
            gy[reach - k] = base_y * down_y * gauss
            up_x *= ratio_x
            up_y *= ratio_y
            down_x /= ratio_x
            down_y /= ratio_y
        for k in range(wp.static(taps)):
            rx = dtype(k - reach) - fx
            ry = dtype(k - reach) - fy
            qx = wp.max(dtype(1.0) - rx * rx * dtype(wp.static(inverse_radius_sq)), dtype(0.0))
            qy = wp.max(dtype(1.0) - ry * ry * dtype(wp.static(inverse_radius_sq)), dtype(0.0))
            four = dtype(wp.static(4.0 * inverse_radius_sq))
            sx[k] = -rx * gx[k] * qx * (qx * dtype(wp.static(inverse_variance)) + four)
            sy[k] = -ry * gy[k] * qy * (qy * dtype(wp.static(inverse_variance)) + four)
            gx[k] = gx[k] * qx * qx
            gy[k] = gy[k] * qy * qy

        for j in range(wp.static(taps)):
            yy = row + j - reach
            if yy >= 0 and yy < height:
                for i in range(wp.static(taps)):
                    xx = column + i - reach
                    if xx >= 0 and xx < width:
                        tap = w * ((gx[i] - lag_x * sx[i]) * gy[j] - lag_y * gx[i] * sy[j])
                        wp.atomic_add(image_out, window, yy, xx, tap)

    return splat_events
