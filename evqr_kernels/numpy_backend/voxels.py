"""Events to grids of pixels and time; the formulas are in ``warp_backend/voxels.py``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evqr_kernels.numpy_backend.pixels import pixels_of


def voxel_grid(x, y, t, weight, window_ptr, span, grid_out) -> None:
    """Share events among the planes before and after them; accumulates."""
    at = planes_of(x, y, t, window_ptr, span, grid_out.shape)
    for place, share in at.shares:
        np.add.at(grid_out, place, weight[at.event] * share)


def voxel_grid_adjoint(x, y, t, weight, window_ptr, span, adj_grid, adj_weight_out, adj_t_out) -> None:
    """Adjoint of `voxel_grid` in weight and time; overwrites."""
    at = planes_of(x, y, t, window_ptr, span, adj_grid.shape)
    adj_weight_out[:] = adj_t_out[:] = 0
    for sign, (place, share) in zip((-1, 1), at.shares, strict=False):
        adj_weight_out[at.event] += share * adj_grid[place]
        adj_t_out[at.event] += sign * weight[at.event] * at.rate * adj_grid[place]


class Planes(NamedTuple):
    """Events that lie in a grid, and the planes beside each: V events."""

    event: NDArray  # (V,) index of the event
    rate: NDArray  # (V,) planes a second
    shares: list  # of the plane before and the one after: (window, plane, row, column), share


def planes_of(x, y, t, window_ptr, span, shape) -> Planes:
    """Find the planes that events lie between."""
    _, planes, height, width = shape
    event, window, row, column = pixels_of(x, y, window_ptr, height, width)
    first, last = span[window].T
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = x.dtype.type(planes - 1) / (last - first)
        place = (t[event] - first) * rate
    # also false for NaN
    use = (t[event] >= first) & (t[event] <= last) & (place >= 0)
    event, window, row, column, rate, place = (a[use] for a in (event, window, row, column, rate, place))
    plane = np.minimum(place.astype(int), max(planes - 2, 0))
    share = np.minimum(place - plane.astype(x.dtype), 1)
    both = [((window, plane, row, column), 1 - share), ((window, plane + 1, row, column), share)]
    return Planes(event, rate, both[:planes])
