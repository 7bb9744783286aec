"""Checked functions from a planar code to what its motion makes events of, and back."""

from __future__ import annotations

import numpy as np

from evqr_kernels.checks import ArrayChecks, Floats
from evqr_kernels.interop import any_arrays
from evqr_kernels.launch import Launch


@any_arrays
def render_code(
    grid: Floats, to_grid: Floats, outside: Floats, *, sigma: float = 0.0,
    shape: tuple[int, int] | None = None, out: Floats | None = None, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Image of a grid of modules under an affine map or a homography.

    Parameters
    ----------
    grid : (B, G, H)     values at the nodes; integers of grid coordinates are module centres
    to_grid : (B, 6) or (B, 8)
        image pixel to grid: u = (W_0 x + W_1 y + W_2) / d, v = (W_3 x + W_4 y + W_5) / d with d = 1, or
        d = W_6 x + W_7 y + 1 where that is positive
    outside : (B,)       value beyond the grid
    sigma [modules]      a module is a box blurred by a Gaussian of 0.02 to 1; 0: bilinear between the nodes
    shape                (Y, X) of the image; not needed with ``out``
    out : (B, Y, X)      OVERWRITTEN; made when None

    Returns
    -------
    (B, Y, X)

    Notes
    -----
    One thread a row of pixels, each pixel written once: results repeat bit for bit.

    See Also
    --------
    render_code_adjoint, brightness_residual
    """
    checks = ArrayChecks()
    _check_render(checks, grid, to_grid, outside, sigma)
    size = checks.image_shape(out, shape)
    launch = Launch("render_code", checks, backend, device)
    launch.run(*launch.put(grid, to_grid, outside), sigma, launch.result(out, *size))
    return launch.results()[0]


@any_arrays
def render_code_adjoint(
    grid: Floats, to_grid: Floats, outside: Floats, adj_image: Floats, *, sigma: float = 0.0,
    backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Adjoint of `render_code` in grid and map.

    Parameters
    ----------
    adj_image : (B, Y, X)   derivative of the loss with respect to the image
    others                  as in `render_code`

    Returns
    -------
    (B, G, H), (B, 6) or (B, 8)   derivatives of the loss with respect to grid and map

    Notes
    -----
    Rows of pixels, and on a GPU nodes, add up on a thread each: results repeat bit for bit.
    """
    checks = ArrayChecks()
    _check_render(checks, grid, to_grid, outside, sigma)
    checks.floats("adj_image", adj_image, "B", "Y", "X")
    launch = Launch("render_code_adjoint", checks, backend, device)
    batch, height, _ = adj_image.shape
    inputs = launch.put(grid, to_grid, outside, adj_image)
    rows = launch.scratch(batch, height, to_grid.shape[1])
    adj_grid, adj_to_grid = launch.result(None, *grid.shape), launch.result(None, *to_grid.shape)
    launch.run(*inputs[:3], sigma, inputs[3], rows, adj_grid, adj_to_grid)
    adj_grid, adj_to_grid = launch.results()
    return adj_grid, adj_to_grid


@any_arrays
def brightness_residual(
    luminance: Floats, events_image: Floats, motion: Floats, *, out: Floats | None = None,
    backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Slope of the luminance along the motion, by central differences, plus the image of events.

    Parameters
    ----------
    luminance, events_image : (B, Y, X)
    motion : (B, 2)                       displacement over the window [px]
    out : (B, Y, X)                       OVERWRITTEN; made when None

    Returns
    -------
    (B, Y, X)
    """
    checks = ArrayChecks()
    checks.floats("luminance", luminance, "B", "Y", "X")
    checks.floats("events_image", events_image, "B", "Y", "X")
    checks.floats("motion", motion, "B", 2)
    if out is not None:
        checks.floats("out", out, "B", "Y", "X")
    launch = Launch("brightness_residual", checks, backend, device)
    launch.run(*launch.put(luminance, events_image, motion), launch.result(out, *luminance.shape))
    return launch.results()[0]


@any_arrays
def brightness_residual_adjoint(
    luminance: Floats,
    motion: Floats,
    adj_residual: Floats,
    *,
    backend: str = "auto",
    device: str | None = None,
) -> tuple[Floats, Floats]:
    """Adjoint of `brightness_residual`; that in the events' image is ``adj_residual`` itself.

    Parameters
    ----------
    luminance : (B, Y, X)
    motion : (B, 2)            displacement over the window [px]
    adj_residual : (B, Y, X)   derivative of the loss with respect to the residual

    Returns
    -------
    (B, Y, X), (B, 2)   derivatives of the loss with respect to luminance and motion
    """
    checks = ArrayChecks()
    checks.floats("luminance", luminance, "B", "Y", "X")
    checks.floats("motion", motion, "B", 2)
    checks.floats("adj_residual", adj_residual, "B", "Y", "X")
    launch = Launch("brightness_residual_adjoint", checks, backend, device)
    batch, height, _ = luminance.shape
    inputs = launch.put(luminance, motion, adj_residual)
    rows = launch.scratch(batch, height, 2)
    launch.run(*inputs, rows, launch.result(None, *luminance.shape), launch.result(None, batch, 2))
    adj_luminance, adj_motion = launch.results()
    return adj_luminance, adj_motion


@any_arrays
def brightness_cost(
    luminance: Floats, events_image: Floats, motion: Floats, *, mask: Floats | None = None,
    backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Half the sum of squared residuals over the pixels of a window, each with a weight.

    Parameters
    ----------
    luminance, events_image : (B, Y, X)   float32 or float64
    motion : (B, 2)                       displacement over the window [px]
    mask : (B, Y, X)                      weight of each pixel, at least 0: 1 used, 0 not; None: all used

    Returns
    -------
    (B,)   1/2 sum of ``mask * brightness_residual(luminance, events_image, motion) ** 2``, in the square of
           the unit that luminance and events have

    Raises
    ------
    TypeError    an array of another dtype than float32 or float64, or than the arrays before it
    ValueError   a wrong shape, a weight that is negative or NaN

    Notes
    -----
    One pass over the three images, linear in pixels; the residual is not written.  A pixel of weight 0 must
    still be finite.  One thread a row of pixels, then one a window that adds up rows in order: results repeat
    bit for bit.

    See Also
    --------
    brightness_residual, brightness_cost_adjoint
    """
    checks = ArrayChecks()
    mask = _check_cost(checks, luminance, events_image, motion, mask)
    launch = Launch("brightness_cost", checks, backend, device)
    batch, height, _ = luminance.shape
    inputs = launch.put(luminance, events_image, motion, mask)
    launch.run(*inputs, launch.scratch(batch, height), launch.result(None, batch))
    return launch.results()[0]


@any_arrays
def brightness_cost_adjoint(
    luminance: Floats, events_image: Floats, motion: Floats, adj_cost: Floats, *, mask: Floats | None = None,
    backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Adjoint of `brightness_cost` in luminance, image of events and motion.

    Parameters
    ----------
    adj_cost : (B,)   derivative of the loss with respect to the cost
    others            as in `brightness_cost`

    Returns
    -------
    (B, Y, X), (B, Y, X), (B, 2)   derivatives of the loss with respect to luminance, events' image and motion

    Raises
    ------
    TypeError, ValueError   as in `brightness_cost`

    Notes
    -----
    A mask says what is looked at and is held: there is no derivative in it (it is half the squared residual).
    Two passes, linear in pixels: the residual is found anew, and written once, weighted, as the derivative in
    the image of events.  One thread a row of pixels, then one for each component of a window's motion, which
    adds up rows in order: results repeat bit for bit.
    """
    checks = ArrayChecks()
    mask = _check_cost(checks, luminance, events_image, motion, mask)
    checks.floats("adj_cost", adj_cost, "B")
    launch = Launch("brightness_cost_adjoint", checks, backend, device)
    batch, height, _ = luminance.shape
    inputs = launch.put(luminance, events_image, motion, mask, adj_cost)
    rows = launch.scratch(batch, height, 2)
    image = luminance.shape
    launch.run(
        *inputs, rows, launch.result(None, *image), launch.result(None, *image), launch.result(None, batch, 2)
    )
    adj_luminance, adj_events, adj_motion = launch.results()
    return adj_luminance, adj_events, adj_motion


def _check_cost(
    checks: ArrayChecks, luminance: Floats, events_image: Floats, motion: Floats, mask: Floats | None
) -> Floats:
    """Check the arguments of the cost; give the mask, made where there is none."""
    checks.floats("luminance", luminance, "B", "Y", "X")
    checks.floats("events_image", events_image, "B", "Y", "X")
    checks.floats("motion", motion, "B", 2)
    if mask is None:
        return np.ones_like(luminance)
    checks.floats("mask", mask, "B", "Y", "X")
    if mask.size:
        checks.at_least("mask", float(mask.min()), 0.0)
    return mask


def _check_render(checks: ArrayChecks, grid: Floats, to_grid: Floats, outside: Floats, sigma: float) -> None:
    checks.floats("grid", grid, "B", "G", "H")
    checks.parameters("to_grid", to_grid, (6, 8))
    checks.floats("outside", outside, "B")
    if not (sigma == 0.0 or 0.02 <= sigma <= 1.0):
        raise ValueError(f"sigma must be 0, or 0.02 to 1, got {sigma}")
