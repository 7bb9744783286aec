"""Splats on GPUs: strips of a few columns, one after another, each along a loop over its rows.

What is held in registers, and how many instructions there are, does not grow with the splat's width: both
loops end when a pixel is out of sight, a number of times that no compiler can know and unroll.  CPUs, whose
vectors hold a whole row, take all columns at once (``splat.py``, ``splat_adjoint.py``).

Only pixels inside the image are visited.  A strip that would end outside is moved back inside and leaves out
the columns that it shares with the one before; columns beyond the splat have profile 0.
"""

from functools import cache

import warp as wp

from evqr_kernels.config import SplatConfig
from evqr_kernels.warp_backend.language import vector
from evqr_kernels.warp_backend.splat_profile import make_splat_profile
from evqr_kernels.warp_backend.transport import make_lag_along

MOST_COLUMNS = 5
"""In a strip: the adjoint's sums of more would not fit in registers."""


def holds_rows(device: wp.Device) -> bool:
    """Whether kernels for the device take all columns of a splat at once, however wide it is."""
    return device.is_cpu


def strip_columns(cfg: SplatConfig, width: int) -> int:
    """Give the columns of a strip: as few strips as there can be, of the same size, in an image that wide."""
    taps = 2 * cfg.reach + 1
    strips = -(-taps // MOST_COLUMNS)
    return min(-(-taps // strips), width)


@cache
def make_add_strips(dtype: type, cfg: SplatConfig, columns: int) -> wp.Function:
    """Build the function that adds w e(x - c) to the image, for the lag (lag_x, lag_y).

    ``rows``: `neighbours` of the image, ``columns`` of them.
    """
    reach = cfg.reach
    radius = wp.constant(dtype(cfg.radius_px))
    vec_columns = vector(columns, dtype)
    splat_profile = make_splat_profile(dtype, cfg)

    @wp.func
    def add_strips(
        image: wp.array3d(dtype=dtype),
        rows: wp.array3d(dtype=vec_columns),
        window: int,
        cx: dtype,
        cy: dtype,
        w: dtype,
        lag_x: dtype,
        lag_y: dtype,
    ):
        x = wp.max(int(wp.floor(cx + dtype(0.5))) - reach, 0)
        while x < image.shape[2] and dtype(x) - cx < radius:
            first = wp.min(x, rows.shape[2] - 1)
            along = vec_columns()
            across = vec_columns()
            for k in range(columns):
                if first + k >= x:
                    g, s, _c = splat_profile(dtype(first + k) - cx)
                    along[k] = w * (g - lag_x * s)
                    across[k] = -w * lag_y * g
            y = wp.max(int(wp.floor(cy + dtype(0.5))) - reach, 0)
            while y < image.shape[1] and dtype(y) - cy < radius:
                g, s, _c = splat_profile(dtype(y) - cy)
                wp.atomic_add(rows, window, y, first, g * along + s * across)
                y += 1
            x = first + columns

    return add_strips


@cache
def make_gather_strips(dtype: type, cfg: SplatConfig, columns: int) -> wp.Function:
    """Build the function that gives adj_w and grad S - hess S lag for an event at (cx, cy).

    ``rows``: `neighbours` of the image, ``columns`` of them.
    """
    reach = cfg.reach
    radius = wp.constant(dtype(cfg.radius_px))
    vec_columns = vector(columns, dtype)
    splat_profile = make_splat_profile(dtype, cfg)
    lag_along = make_lag_along(dtype)

    @wp.func
    def gather_strips(
        rows: wp.array3d(dtype=vec_columns),
        window: int,
        cx: dtype,
        cy: dtype,
        lag_px: dtype,
        motion_x: dtype,
        motion_y: dtype,
    ):
        lag_x, lag_y = lag_along(lag_px, motion_x, motion_y)
        adj_w = dtype(0.0)
        slope_x = dtype(0.0)
        slope_y = dtype(0.0)
        x = wp.max(int(wp.floor(cx + dtype(0.5))) - reach, 0)
        while x < rows.shape[2] + columns - 1 and dtype(x) - cx < radius:
            first = wp.min(x, rows.shape[2] - 1)
            gx = vec_columns()
            sx = vec_columns()
            bend_x = vec_columns()
            for k in range(columns):
                if first + k >= x:
                    g, s, c = splat_profile(dtype(first + k) - cx)
                    gx[k] = g
                    sx[k] = s
                    bend_x[k] = c
            y = wp.max(int(wp.floor(cy + dtype(0.5))) - reach, 0)
            while y < rows.shape[1] and dtype(y) - cy < radius:
                values = rows[window, y, first]
                by_g = wp.dot(gx, values)
                by_s = wp.dot(sx, values)
                ahead = by_g - lag_x * by_s
                bend = by_s - lag_x * wp.dot(bend_x, values)
                g, s, c = splat_profile(dtype(y) - cy)
                adj_w += g * ahead - lag_y * s * by_g
                slope_x += g * bend - lag_y * s * by_s
                slope_y += s * ahead - lag_y * c * by_g
                y += 1
            x = first + columns
        return adj_w, slope_x, slope_y

    return gather_strips
