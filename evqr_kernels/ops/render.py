"""Checked functions from a planar code to what its motion makes events of, and back."""

from __future__ import annotations

from evqr_kernels import arguments
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
    arguments.render_code(checks, grid, to_grid, outside, sigma)
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
    arguments.render_code(checks, grid, to_grid, outside, sigma)
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
    arguments.brightness_residual(checks, luminance, events_image, motion)
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
