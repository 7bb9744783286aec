"""Adjoint of ``splat_events`` in weights, motion and positions; the formulas are in ``splat.py``.

A gather: each thread takes a chunk of a window's events and reads the image's adjoint around each, so there
is no atomic, and the sums over chunks are added up in a second pass.  With S the image's adjoint smoothed
with N, at the event, and lag the vector ``lag_i d``,

    adj_w = S - lag . grad S,    adj_v = t / scale w (grad S - hess S lag)

so that S, its gradient and its second derivatives are all that is summed over pixels.

The splat is separable: on CPUs the pixels around an event are summed along columns first, with g, g' and g''
each, and what is left is one row for each of the three.  On GPUs: ``splat_strips.py``.
"""

from functools import cache

import warp as wp

from evqr_kernels.config import SplatConfig
from evqr_kernels.operations.events import CHUNK
from evqr_kernels.warp_backend.language import (
    clear,
    last_axis_as_vector,
    launch,
    launch_bounds,
    module_of,
    neighbours,
    vector,
)
from evqr_kernels.warp_backend.splat_profile import make_gauss_around, make_splat_tap
from evqr_kernels.warp_backend.splat_strips import holds_rows, make_gather_strips, strip_columns
from evqr_kernels.warp_backend.sums import add_partials
from evqr_kernels.warp_backend.transport import (
    is_named,
    make_lag_along,
    make_middle,
    make_transport,
    make_velocity,
    make_velocity_adjoint,
    window_of,
)


@cache
def make_row_or_nearest(dtype: type, columns: int) -> wp.Function:
    """Build the look-up of ``columns`` pixels of a row from the one at x on, 0 if the row is outside."""
    vec_columns = vector(columns, dtype)

    @wp.func
    def row_or_nearest(rows: wp.array3d(dtype=vec_columns), window: int, y: int, x: int) -> vec_columns:
        # without a branch
        nearest = wp.clamp(y, 0, rows.shape[1] - 1)
        return wp.where(y == nearest, dtype(1.0), dtype(0.0)) * rows[window, nearest, x]

    return row_or_nearest


@cache
def make_gather_rows(dtype: type, cfg: SplatConfig, columns: int) -> wp.Function:
    """Build the function that gives adj_w and grad S - hess S lag for an event at (cx, cy).

    ``rows``: `neighbours` of the image.  Near its sides the ``columns`` that are read are the last ones
    inside: pixels that are farther off than the splat reaches have profile 0.
    """
    reach = cfg.reach
    middle = columns // 2
    vec_columns = vector(columns, dtype)
    gauss_around = make_gauss_around(dtype, cfg)
    shrink = wp.constant(dtype(cfg.gauss(1.0) ** 2))
    splat_tap = make_splat_tap(dtype, cfg)
    row_or_nearest = make_row_or_nearest(dtype, columns)
    lag_along = make_lag_along(dtype)

    @wp.func
    def gather_rows(
        rows: wp.array3d(dtype=vec_columns),
        window: int,
        cx: dtype,
        cy: dtype,
        lag_px: dtype,
        motion_x: dtype,
        motion_y: dtype,
    ):
        row = int(wp.floor(cy + dtype(0.5)))
        first = wp.clamp(int(wp.floor(cx + dtype(0.5))) - middle, 0, rows.shape[2] - 1)
        by_g = vec_columns()
        by_s = vec_columns()
        by_c = vec_columns()
        # one tap after another: the profiles of all at once would take the registers
        offset = cy - dtype(row)
        right, up, down = gauss_around(offset)
        left = right
        for k in range(wp.static(reach + 1)):
            for side in range(2):
                if side == 0 or k > 0:
                    tap = wp.where(side == 0, k, -k)
                    g, s, c = splat_tap(wp.where(side == 0, right, left), dtype(tap) - offset)
                    values = row_or_nearest(rows, window, row + tap, first)
                    by_g += g * values
                    by_s += s * values
                    by_c += c * values
            right *= up
            left *= down
            up *= shrink
            down *= shrink
        value = dtype(0.0)
        value_x = dtype(0.0)
        value_y = dtype(0.0)
        value_xx = dtype(0.0)
        value_xy = dtype(0.0)
        value_yy = dtype(0.0)
        offset = cx - dtype(first + middle)
        right, up, down = gauss_around(offset)
        left = right
        for k in range(wp.static(middle + 1)):
            for side in range(2):
                tap = wp.where(side == 0, k, -k)
                if (side == 0 or k > 0) and middle + tap < columns:
                    g, s, c = splat_tap(wp.where(side == 0, right, left), dtype(tap) - offset)
                    value += g * by_g[middle + tap]
                    value_x += s * by_g[middle + tap]
                    value_y += g * by_s[middle + tap]
                    value_xx += c * by_g[middle + tap]
                    value_xy += s * by_s[middle + tap]
                    value_yy += g * by_c[middle + tap]
            right *= up
            left *= down
            up *= shrink
            down *= shrink
        lag_x, lag_y = lag_along(lag_px, motion_x, motion_y)  # here: the sums leave no register for it
        return (
            value - lag_x * value_x - lag_y * value_y,
            value_x - lag_x * value_xx - lag_y * value_xy,
            value_y - lag_x * value_xy - lag_y * value_yy,
        )

    return gather_rows


@cache
def make_splat_events_adjoint(
    dtype: type, cfg: SplatConfig, parameters: int, columns: int, on_cpu: bool
) -> wp.Kernel:
    """Build the adjoint for a precision, a splat and a motion; launch: one thread per (window, chunk).

    ``columns``: pixels of a row that are read at once.
    ``on_cpu``: the variant for CPUs, where these are all that a splat reaches or all there are.
    """
    margin = 2 * cfg.reach + 1
    vec_columns = vector(columns, dtype)
    vec_parameters = vector(parameters, dtype)
    gather = make_gather_rows(dtype, cfg, columns) if on_cpu else make_gather_strips(dtype, cfg, columns)
    transport = make_transport(dtype)
    middle = make_middle(dtype)
    velocity = make_velocity(dtype, parameters)
    velocity_adjoint = make_velocity_adjoint(dtype, parameters)

    @wp.kernel(
        module=module_of(
            f"splat_adjoint_{parameters}_{columns}_{cfg.name}{'_on_cpu' * on_cpu}",
            dtype,
        ),
        launch_bounds=launch_bounds(dtype),
    )
    def splat_events_adjoint(
        x: wp.array(dtype=dtype),
        y: wp.array(dtype=dtype),
        t: wp.array(dtype=dtype),
        weight: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        motion: wp.array(dtype=vec_parameters),
        lag: wp.array2d(dtype=dtype),
        frame: wp.array2d(dtype=dtype),
        adj_image: wp.array3d(dtype=dtype),
        adj_rows: wp.array3d(dtype=vec_columns),
        chunks_out: wp.array2d(dtype=vec_parameters),
        adj_weight_out: wp.array(dtype=dtype),
        adj_x_out: wp.array(dtype=dtype),
        adj_y_out: wp.array(dtype=dtype),
    ):
        window, chunk = wp.tid()
        end = wp.clamp(window_ptr[window + 1], 0, x.shape[0])
        begin = wp.clamp(window_ptr[window], 0, end)
        length = wp.max((end - begin + chunks_out.shape[1] - 1) // chunks_out.shape[1], CHUNK)
        height = adj_image.shape[1]
        width = adj_image.shape[2]
        # values, not look-ups: the addresses would be kept in more registers
        origin_x = frame[window, 0]
        origin_y = frame[window, 1]
        scale = frame[window, 2]
        inverse_scale = dtype(1.0) / scale
        lag_on = lag[window, 0]
        lag_off = lag[window, 1]
        chunks_out[window, chunk] = vec_parameters()
        for e in range(begin + chunk * length, wp.min(begin + (chunk + 1) * length, end)):
            dx = x[e] - middle(origin_x, scale, width)
            dy = y[e] - middle(origin_y, scale, height)
            motion_x, motion_y = velocity(motion[window], dx, dy)
            cx = transport(x[e], t[e], motion_x, origin_x, inverse_scale)
            cy = transport(y[e], t[e], motion_y, origin_y, inverse_scale)
            # also false for NaN
            if (
                cx > dtype(-margin)
                and cy > dtype(-margin)
                and cx < dtype(width + margin)
                and cy < dtype(height + margin)
            ):
                w = weight[e]
                lag_px = wp.where(w < dtype(0.0), lag_off, lag_on)
                adj_w, slope_x, slope_y = gather(adj_rows, window, cx, cy, lag_px, motion_x, motion_y)
                slope_x *= inverse_scale * w
                slope_y *= inverse_scale * w
                # what belongs to an event is 0 already
                adj_weight_out[e] = adj_w
                adj_x_out[e] = -slope_x
                adj_y_out[e] = -slope_y
                adj = velocity_adjoint(t[e] * slope_x, t[e] * slope_y, dx, dy)
                # the sums are in memory: no register is left for them, and `+=` would be atomic
                chunks_out[window, chunk] = chunks_out[window, chunk] + adj

    return splat_events_adjoint


@cache
def make_seen_where_it_moves(dtype: type) -> wp.Kernel:
    """Build the adjoint of an affine motion's transport in where events were seen; launch: one thread each.

    A pass of its own: the one before has no register left.
    """

    @wp.kernel(module=module_of("splat_adjoint", dtype))
    def seen_where_it_moves(
        t: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        motion: wp.array2d(dtype=dtype),
        adj_x_inout: wp.array(dtype=dtype),
        adj_y_inout: wp.array(dtype=dtype),
    ):
        e = wp.tid()
        if not is_named(window_ptr, e):
            return
        b = window_of(window_ptr, e)
        adj_x = adj_x_inout[e]
        adj_y = adj_y_inout[e]
        if adj_x == dtype(0.0) and adj_y == dtype(0.0):  # dropped, perhaps of a time that is not finite
            return
        adj_x_inout[e] = adj_x - t[e] * (motion[b, 2] * adj_x + motion[b, 4] * adj_y)
        adj_y_inout[e] = adj_y - t[e] * (motion[b, 3] * adj_x + motion[b, 5] * adj_y)

    return seen_where_it_moves


def splat_events_adjoint(
    x, y, t, weight, window_ptr, motion, lag, frame, adj_image, chunks_out, adj_weight_out, adj_motion_out,
    adj_x_out, adj_y_out, cfg: SplatConfig,
) -> None:  # fmt: skip
    """Launch both passes; overwrites."""
    for of_events in (adj_weight_out, adj_x_out, adj_y_out):
        clear(of_events)  # that do not reach the image, or that no window names
    if not adj_image.size:  # no pixel to read
        clear(adj_motion_out)
        return
    on_cpu, width = holds_rows(x.device), adj_image.shape[2]
    columns = min(2 * cfg.reach + 1, width) if on_cpu else strip_columns(cfg, width)
    launch(
        make_splat_events_adjoint(x.dtype, cfg, motion.shape[1], columns, on_cpu),
        chunks_out.shape[:2],
        inputs=[
            x,
            y,
            t,
            weight,
            window_ptr,
            last_axis_as_vector(motion),
            lag,
            frame,
            adj_image,
            neighbours(adj_image, columns),
        ],
        outputs=[last_axis_as_vector(chunks_out), adj_weight_out, adj_x_out, adj_y_out],
        device=x.device,
    )
    add_partials(chunks_out, adj_motion_out)
    if motion.shape[1] == 6:
        launch(
            make_seen_where_it_moves(x.dtype),
            x.shape[0],
            inputs=[t, window_ptr, motion],
            outputs=[adj_x_out, adj_y_out],
            device=x.device,
        )
