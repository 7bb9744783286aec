"""Moving events to the reference time.

An event at x, seen t after it, comes from ``x - t v(x)``, in pixels of an image with a corner and a scale
(``frame``).  The velocity is the same everywhere, or affine in position,

    v = m                                  2 parameters
    v(x) = m + A (x - c)                   6 parameters: m_x, m_y, A_xx, A_xy, A_yx, A_yy

with c the middle of the image, so that m is what the image does as a whole and A how it turns and grows.
Adjoint, for f = d loss / d v of one event: ``adj_m = f``, ``adj_A = f (x - c)^T``; and, for g = d loss / d
(x - t v), ``adj_x = (1 - t A)^T g``.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import vector


@cache
def make_transport(dtype: type) -> wp.Function:
    """Build the function that brings an event to image pixels at the reference time, along one axis."""

    @wp.func
    def transport(position: dtype, t: dtype, motion: dtype, origin: dtype, inverse_scale: dtype) -> dtype:
        return (position - t * motion - origin + dtype(0.5)) * inverse_scale - dtype(0.5)

    return transport


@wp.func
def is_named(window_ptr: wp.array(dtype=wp.int32), event: int) -> bool:
    """Whether an event lies in a window: of those before the first and behind the last none is made."""
    return event >= window_ptr[0] and event < window_ptr[window_ptr.shape[0] - 1]


@wp.func
def window_of(window_ptr: wp.array(dtype=wp.int32), event: int) -> int:
    """Give the window of an event that is named: an index of one whatever ``window_ptr`` holds."""
    return wp.lower_bound(window_ptr, event + 1) - 1


@cache
def make_middle(dtype: type) -> wp.Function:
    """Build the function that gives the middle of an image along one axis [px]."""

    @wp.func
    def middle(origin: dtype, scale: dtype, size: int) -> dtype:
        return origin - dtype(0.5) + dtype(0.5) * scale * dtype(size)

    return middle


@cache
def make_lag_along(dtype: type) -> wp.Function:
    """Build the function that gives the lag as a vector along the motion [image px]."""

    @wp.func
    def lag_along(lag_px: dtype, motion_x: dtype, motion_y: dtype):
        speed = wp.sqrt(motion_x * motion_x + motion_y * motion_y)
        if speed > dtype(0.0):
            lag_px /= speed
        return lag_px * motion_x, lag_px * motion_y

    return lag_along


@cache
def make_velocity(dtype: type, parameters: int) -> wp.Function:
    """Build the function that gives the velocity at (dx, dy) from the middle, for 2 or 6 parameters."""
    vec = vector(parameters, dtype)
    if parameters == 2:

        @wp.func
        def velocity(motion: vec, dx: dtype, dy: dtype):
            return motion[0], motion[1]

        return velocity

    @wp.func
    def velocity_field(motion: vec, dx: dtype, dy: dtype):
        along_x = motion[0] + motion[2] * dx + motion[3] * dy
        along_y = motion[1] + motion[4] * dx + motion[5] * dy
        return along_x, along_y

    return velocity_field


@cache
def make_velocity_adjoint(dtype: type, parameters: int) -> wp.Function:
    """Build the adjoint of the velocity of one event in the parameters."""
    vec = vector(parameters, dtype)
    if parameters == 2:

        @wp.func
        def velocity_adjoint(adj_x: dtype, adj_y: dtype, dx: dtype, dy: dtype) -> vec:
            return vec(adj_x, adj_y)

        return velocity_adjoint

    @wp.func
    def velocity_field_adjoint(adj_x: dtype, adj_y: dtype, dx: dtype, dy: dtype) -> vec:
        return vec(adj_x, adj_y, adj_x * dx, adj_x * dy, adj_y * dx, adj_y * dy)

    return velocity_field_adjoint
