"""Moving events to the reference time; the formulas are in ``warp_backend/transport.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import ti


@cache
def make_transport(dtype):
    """Build the function that brings an event to image pixels at the reference time, along one axis."""

    @ti.func
    def transport(position, t, motion, origin, inverse_scale):
        return (position - t * motion - origin + dtype(0.5)) * inverse_scale - dtype(0.5)

    return transport


@cache
def make_middle(dtype):
    """Build the function that gives the middle of an image along one axis [px]."""

    @ti.func
    def middle(origin, scale, size):
        return origin - dtype(0.5) + dtype(0.5) * scale * dtype(size)

    return middle


@cache
def make_velocity(parameters: int):
    """Build the function that gives the velocity at (dx, dy) from the middle, for 2 or 6 parameters."""

    @ti.func
    def velocity(motion: ti.template(), b, dx, dy):
        along_x = motion[b, 0]
        along_y = motion[b, 1]
        if ti.static(parameters == 6):
            along_x += motion[b, 2] * dx + motion[b, 3] * dy
            along_y += motion[b, 4] * dx + motion[b, 5] * dy
        return along_x, along_y

    return velocity
