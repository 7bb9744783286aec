"""Events to images.

``bin_events`` counts: each event adds its weight to the pixel it falls in, at a reduced resolution.

``splat_events`` transports and splats.  With c_i = (x_i, y_i) - t_i v_i brought to image pixels (see
``transport``) and d the direction of v_i:

    image(x) += sum_i w_i e_i(x - c_i),    e_i(r) = (1 - lag_i d . grad) N(r),    N(r) = g(r_x) g(r_y)

(g: see `SplatConfig`).  The directional derivative undoes a first-order pixel that lags by ``lag_i`` image px
along the motion; ON and OFF events (the sign of w_i) have a lag each.  The splat is separable, so it costs
one more multiply-add a tap:

    e_i(j, k) = (g_j - lag d_x g'_j) g_k - lag d_y g_j g'_k          (j columns, k rows)

CPUs add whole rows of it, all unrolled; GPUs strips (``splat_strips.py``).

Adjoint, for adj = d loss / d image; lag and direction d are parameters, no derivative is taken with respect
to them:

    adj_w_i    = sum_x adj(x) e_i(x - c_i)
    adj_v_i    = (t_i / scale) w_i sum_x adj(x) grad e_i(x - c_i)
    adj_x_i    = -(1 - t_i A)^T / scale w_i sum_x adj(x) grad e_i(x - c_i),      A of an affine motion
"""

from functools import cache

import warp as wp

from evqr_kernels.config import SplatConfig
from evqr_kernels.operations.events import CHUNK
from evqr_kernels.warp_backend.language import (
    last_axis_as_vector,
    launch,
    module_of,
    neighbours,
    vector,
)
from evqr_kernels.warp_backend.splat_profile import make_splat_taps
from evqr_kernels.warp_backend.splat_strips import holds_rows, make_add_strips, strip_columns
from evqr_kernels.warp_backend.transport import (
    is_named,
    make_lag_along,
    make_middle,
    make_transport,
    make_velocity,
    window_of,
)


@cache
def make_bin_events(dtype: type) -> wp.Kernel:
    """Build the binning kernel; launch: one thread per chunk of events, whatever windows they are of."""

    @wp.kernel(module=module_of("bin", dtype))
    def bin_events(
        x: wp.array(dtype=dtype),
        y: wp.array(dtype=dtype),
        weight: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        inverse_reduction: dtype,
        image_out: wp.array3d(dtype=dtype),
    ):
        right = dtype(image_out.shape[2])
        bottom = dtype(image_out.shape[1])
        first = wp.tid() * CHUNK
        last = wp.min(first + CHUNK, window_ptr[window_ptr.shape[0] - 1])
        b = window_of(window_ptr, first)
        if b < 0 or last > x.shape[0]:  # some of them no window names
            first = wp.max(first, window_ptr[0])
            last = wp.min(last, x.shape[0])
            b = window_of(window_ptr, first)
        while first < last:  # ends with the last window
            end = wp.min(last, window_ptr[b + 1])
            for e in range(first, end):
                column = (x[e] + dtype(0.5)) * inverse_reduction
                row = (y[e] + dtype(0.5)) * inverse_reduction
                # written so that it is false for NaN
                if column >= dtype(0.0) and row >= dtype(0.0) and column < right and row < bottom:
                    wp.atomic_add(image_out, b, int(row), int(column), weight[e])
            first = wp.max(first, end)
            b += 1

    return bin_events


def bin_events(x, y, weight, window_ptr, reduction: float, image_out) -> None:
    """Launch; accumulates.  Float atomics: on a GPU sums repeat to a tolerance, not bit for bit."""
    launch(
        make_bin_events(x.dtype),
        -(-x.shape[0] // CHUNK),
        inputs=[x, y, weight, window_ptr, 1.0 / reduction],
        outputs=[image_out],
        device=x.device,
    )


@cache
def make_add_rows(dtype: type, cfg: SplatConfig) -> wp.Function:
    """Build the function that adds w e(x - c) to the image, for the lag (lag_x, lag_y), a row at a time.

    ``rows``: `neighbours` of the image, as many as there are taps.
    """
    reach = cfg.reach
    taps = 2 * reach + 1
    vec_taps = vector(taps, dtype)
    splat_taps = make_splat_taps(dtype, cfg)

    @wp.func
    def add_rows(
        image: wp.array3d(dtype=dtype),
        rows: wp.array3d(dtype=vec_taps),
        window: int,
        cx: dtype,
        cy: dtype,
        w: dtype,
        lag_x: dtype,
        lag_y: dtype,
    ):
        column = int(wp.floor(cx + dtype(0.5)))
        row = int(wp.floor(cy + dtype(0.5)))
        height = image.shape[1]
        width = image.shape[2]
        _gauss_x, gx, sx = splat_taps(cx - dtype(column))
        _gauss_y, gy, sy = splat_taps(cy - dtype(row))
        along = w * (gx - lag_x * sx)
        across = (-w * lag_y) * gx
        if row >= reach and column >= reach and row < height - reach and column < width - reach:
            for j in range(wp.static(taps)):
                wp.atomic_add(rows, window, row + j - reach, column - reach, gy[j] * along + sy[j] * across)
        else:
            for j in range(taps):
                for i in range(taps):
                    yy = row + j - reach
                    xx = column + i - reach
                    if yy >= 0 and yy < height and xx >= 0 and xx < width:
                        wp.atomic_add(image, window, yy, xx, gy[j] * along[i] + sy[j] * across[i])

    return add_rows


@cache
def make_splat_events(
    dtype: type, cfg: SplatConfig, parameters: int, columns: int, on_cpu: bool
) -> wp.Kernel:
    """Build the kernel for a precision, a shape of splat and a motion; launch: one thread per event.

    ``columns``: pixels of a row that are added to at once.
    ``on_cpu``: the variant for CPUs, where these are all that a splat reaches.
    """
    margin = 2 * cfg.reach + 1
    vec_columns = vector(columns, dtype)
    vec_parameters = vector(parameters, dtype)
    add_splat = make_add_rows(dtype, cfg) if on_cpu else make_add_strips(dtype, cfg, columns)
    transport = make_transport(dtype)
    middle = make_middle(dtype)
    velocity = make_velocity(dtype, parameters)
    lag_along = make_lag_along(dtype)

    @wp.kernel(module=module_of(f"splat_{parameters}_{columns}_{cfg.name}{'_on_cpu' * on_cpu}", dtype))
    def splat_events(
        x: wp.array(dtype=dtype),
        y: wp.array(dtype=dtype),
        t: wp.array(dtype=dtype),
        weight: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        motion: wp.array(dtype=vec_parameters),
        lag: wp.array2d(dtype=dtype),
        frame: wp.array2d(dtype=dtype),
        image_out: wp.array3d(dtype=dtype),
        rows_out: wp.array3d(dtype=vec_columns),
    ):
        e = wp.tid()
        if not is_named(window_ptr, e):
            return
        window = window_of(window_ptr, e)
        scale = frame[window, 2]
        inverse_scale = dtype(1.0) / scale
        dx = x[e] - middle(frame[window, 0], scale, image_out.shape[2])
        dy = y[e] - middle(frame[window, 1], scale, image_out.shape[1])
        motion_x, motion_y = velocity(motion[window], dx, dy)
        cx = transport(x[e], t[e], motion_x, frame[window, 0], inverse_scale)
        cy = transport(y[e], t[e], motion_y, frame[window, 1], inverse_scale)
        # written so that it also holds for NaN
        if not (
            cx > dtype(-margin)
            and cy > dtype(-margin)
            and cx < dtype(image_out.shape[2] + margin)
            and cy < dtype(image_out.shape[1] + margin)
        ):
            return
        w = weight[e]
        lag_px = lag[window, 0]
        if w < dtype(0.0):
            lag_px = lag[window, 1]
        lag_x, lag_y = lag_along(lag_px, motion_x, motion_y)
        add_splat(image_out, rows_out, window, cx, cy, w, lag_x, lag_y)

    return splat_events


def splat_events(x, y, t, weight, window_ptr, motion, lag, frame, image_out, cfg: SplatConfig) -> None:
    """Launch; accumulates.  Float atomics: on a GPU sums repeat to a tolerance, not bit for bit."""
    if not image_out.size:  # no pixel to add to
        return
    on_cpu = holds_rows(x.device)
    columns = 2 * cfg.reach + 1 if on_cpu else strip_columns(cfg, image_out.shape[2])
    launch(
        make_splat_events(x.dtype, cfg, motion.shape[1], columns, on_cpu),
        x.shape[0],
        inputs=[x, y, t, weight, window_ptr, last_axis_as_vector(motion), lag, frame],
        outputs=[image_out, neighbours(image_out, columns)],
        device=x.device,
    )
