"""Checked functions from a planar code to what its motion makes events of, and back."""

from __future__ import annotations

from evqr_kernels.checks import ArrayChecks, Floats
from evqr_kernels.launch import Launch


def render_affine(
    grid: Floats, affine: Floats, outside: Floats, *, shape: tuple[int, int] | None = None,
    out: Floats | None = None, backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Image of a grid of modules under an affine map, bilinear.

    Parameters
    ----------
    grid : (B, G, H)     values at the nodes; integers of grid coordinates are module centres
    affine : (B, 6)      image pixel to grid: u = W_0 x + W_1 y + W_2, v = W_3 x + W_4 y + W_5
    outside : (B,)       value beyond the grid
    shape                (Y, X) of the image; not needed with ``out``
    out : (B, Y, X)      OVERWRITTEN; made when None

    Returns
    -------
    (B, Y, X)
    """
    checks = ArrayChecks()
    _check_render(checks, grid, affine, outside)
    size = checks.image_shape(out, shape)
    launch = Launch("render_affine", checks, backend, device)
    launch.run(*launch.put(grid, affine, outside), launch.result(out, *size))
    return launch.results()[0]


def render_affine_adjoint(
    grid: Floats, affine: Floats, outside: Floats, adj_image: Floats, *, backend: str = "auto",
    device: str | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Adjoint of `render_affine`.

    Parameters
    ----------
    adj_image : (B, Y, X)   derivative of the loss with respect to the image
    others                  as in `render_affine`

    Returns
    -------
    (B, G, H), (B, 6)   derivatives of the loss with respect to grid and affine
    """
    checks = ArrayChecks()
    _check_render(checks, grid, affine, outside)
    checks.floats("adj_image", adj_image, "B", "Y", "X")
    launch = Launch("render_affine_adjoint", checks, backend, device)
    batch, height, _ = adj_image.shape
    inputs = launch.put(grid, affine, outside, adj_image)
    rows = launch.scratch(batch, height, 6)
    launch.run(*inputs, rows, launch.result(None, *grid.shape), launch.result(None, batch, 6))
    adj_grid, adj_affine = launch.results()
    return adj_grid, adj_affine


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


def _check_render(checks: ArrayChecks, grid: Floats, affine: Floats, outside: Floats) -> None:
    checks.floats("grid", grid, "B", "G", "H")
    checks.floats("affine", affine, "B", 6)
    checks.floats("outside", outside, "B")
