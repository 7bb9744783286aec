"""Residual of the brightness change along a motion: what the method's cost sums the squares of.

    residual(y, x) = m_x L_x(y, x) + m_y L_y(y, x) + E(y, x)

with m the motion [px per window], L the luminance, E the image of events and L_x, L_y central differences;
beyond the border lies the border's own pixel again.  Adjoint, for a = d loss / d residual, continued beyond
the border by minus the border's own value:

    adj_L(y, x)  = m_x (a(y, x - 1) - a(y, x + 1)) / 2 + m_y (a(y - 1, x) - a(y + 1, x)) / 2
    adj_m        = sum_{y, x} a (L_x, L_y)
    adj_E        = a
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of
from evqr_kernels.warp_backend.sums import add_partials


@cache
def make_slopes(dtype: type) -> wp.Function:
    """Build the central differences at one pixel."""

    @wp.func
    def slopes(image: wp.array3d(dtype=dtype), b: int, y: int, x: int):
        right = image[b, y, wp.min(x + 1, image.shape[2] - 1)]
        left = image[b, y, wp.max(x - 1, 0)]
        below = image[b, wp.min(y + 1, image.shape[1] - 1), x]
        above = image[b, wp.max(y - 1, 0), x]
        return dtype(0.5) * (right - left), dtype(0.5) * (below - above)

    return slopes


@cache
def make_brightness_residual(dtype: type) -> wp.Kernel:
    """Build the forward kernel; launch: one thread per row."""
    slopes = make_slopes(dtype)

    @wp.kernel(module=module_of("residual", dtype))
    def brightness_residual(
        luminance: wp.array3d(dtype=dtype),
        events_image: wp.array3d(dtype=dtype),
        motion: wp.array2d(dtype=dtype),
        residual_out: wp.array3d(dtype=dtype),
    ):
        b, y = wp.tid()
        for x in range(luminance.shape[2]):
            dx, dy = slopes(luminance, b, y, x)
            residual_out[b, y, x] = motion[b, 0] * dx + motion[b, 1] * dy + events_image[b, y, x]

    return brightness_residual


def brightness_residual(luminance, events_image, motion, residual_out) -> None:
    """Launch; overwrites."""
    launch(
        make_brightness_residual(luminance.dtype),
        luminance.shape[:2],
        inputs=[luminance, events_image, motion],
        outputs=[residual_out],
        device=luminance.device,
    )


@cache
def make_brightness_residual_adjoint(dtype: type) -> wp.Kernel:
    """Build the adjoint kernel; launch: one thread per row."""
    slopes = make_slopes(dtype)

    @wp.func
    def beyond(adj: wp.array3d(dtype=dtype), b: int, y: int, x: int) -> dtype:
        row = wp.clamp(y, 0, adj.shape[1] - 1)
        column = wp.clamp(x, 0, adj.shape[2] - 1)
        value = adj[b, row, column]
        if row != y or column != x:
            value = -value
        return value

    @wp.kernel(module=module_of("residual_adjoint", dtype))
    def brightness_residual_adjoint(
        luminance: wp.array3d(dtype=dtype),
        motion: wp.array2d(dtype=dtype),
        adj_residual: wp.array3d(dtype=dtype),
        rows_out: wp.array3d(dtype=dtype),
        adj_luminance_out: wp.array3d(dtype=dtype),
    ):
        b, y = wp.tid()
        adj_x = dtype(0.0)
        adj_y = dtype(0.0)
        for x in range(luminance.shape[2]):
            dx, dy = slopes(luminance, b, y, x)
            adj_x += adj_residual[b, y, x] * dx
            adj_y += adj_residual[b, y, x] * dy
            along_x = beyond(adj_residual, b, y, x - 1) - beyond(adj_residual, b, y, x + 1)
            along_y = beyond(adj_residual, b, y - 1, x) - beyond(adj_residual, b, y + 1, x)
            adj_luminance_out[b, y, x] = dtype(0.5) * (motion[b, 0] * along_x + motion[b, 1] * along_y)
        rows_out[b, y, 0] = adj_x
        rows_out[b, y, 1] = adj_y

    return brightness_residual_adjoint


def brightness_residual_adjoint(
    luminance, motion, adj_residual, rows_out, adj_luminance_out, adj_motion_out
) -> None:
    """Launch both passes; overwrites."""
    launch(
        make_brightness_residual_adjoint(luminance.dtype),
        luminance.shape[:2],
        inputs=[luminance, motion, adj_residual],
        outputs=[rows_out, adj_luminance_out],
        device=luminance.device,
    )
    add_partials(rows_out, adj_motion_out)
