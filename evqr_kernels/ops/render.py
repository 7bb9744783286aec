"""Checked functions from a planar code to what its motion makes events of, and back."""

from __future__ import annotations

from evqr_kernels.call import checked
from evqr_kernels.checks import Floats

__all__ = [
    "brightness_cost",
    "brightness_cost_adjoint",
    "brightness_residual",
    "brightness_residual_adjoint",
    "render_code",
    "render_code_adjoint",
]


@checked
def render_code(
    grid: Floats, to_grid: Floats, outside: Floats, *, sigma: float = 0.0,
    shape: tuple[int, int] | None = None, out: Floats | None = None, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Image of a grid of modules under an affine map or a homography.

    Parameters
    ----------
    grid : (B, G, H) float [any]
        Values at the nodes; integers of grid coordinates are module centres.
    to_grid : (B, 6) or (B, 8) float [image px to modules]
        W, from a pixel to the grid: u = (W_0 x + W_1 y + W_2) / d, v = (W_3 x + W_4 y + W_5) / d with d = 1,
        or d = W_6 x + W_7 y + 1 where that is positive.
    outside : (B,) float [of grid]
        Value beyond the grid, and where d is not positive.
    sigma : float [modules]
        A module is a box blurred by a Gaussian of 0.02 to 1; 0: bilinear between the nodes.
    shape : (int, int)
        (Y, X) of the image; not needed with ``out``.
    out : (B, Y, X) float [of grid]
        OVERWRITTEN; made when None.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    image : (B, Y, X) float [of grid]
        ``out``, or the new image.

    Raises
    ------
    ValueError
        If ``to_grid`` has neither 6 nor 8 columns, or ``sigma`` is neither 0 nor 0.02 to 1.
    TypeError
        If there is neither ``shape`` nor ``out``.

    See Also
    --------
    render_code_adjoint, brightness_residual

    Notes
    -----
    Cost: T^2 + T multiply-adds a pixel that sees the grid, where it sees T nodes along an axis: 2, or with
    ``sigma`` ceil(1 + 12 sigma) but at least 3, and then it takes 2 T + 2 error functions.  One thread a row
    of pixels, no scratch.

    Determinism: bit for bit.
    """
    ...


@checked
def render_code_adjoint(
    grid: Floats, to_grid: Floats, outside: Floats, adj_image: Floats, *, sigma: float = 0.0,
    backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Adjoint of `render_code` in grid and map.

    Parameters
    ----------
    grid, to_grid, outside, sigma
        As in `render_code`.
    adj_image : (B, Y, X) float [loss / grid]
        Derivative of the loss with respect to the image.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    adj_grid : (B, G, H) float [loss / grid]
        Derivative of the loss with respect to the grid.
    adj_to_grid : (B, 6) or (B, 8) float [loss / to_grid]
        Derivative of the loss with respect to the map.

    Raises
    ------
    ValueError
        If ``to_grid`` has neither 6 nor 8 columns, or ``sigma`` is neither 0 nor 0.02 to 1.

    Notes
    -----
    Cost: some three times the multiply-adds of `render_code`; on a GPU one pass more, in which each node
    visits all pixels that can see it.  Scratch of (B, Y, 6 or 8), which a last pass adds up.

    Determinism: bit for bit.
    """
    ...


@checked
def brightness_residual(
    luminance: Floats, events_image: Floats, motion: Floats, *, out: Floats | None = None,
    backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Slope of the luminance along the motion, by central differences, plus the image of events.

    Parameters
    ----------
    luminance : (B, Y, X) float [any]
        The image of the code; beyond the border lies the border's own pixel.
    events_image : (B, Y, X) float [of luminance]
        The image of events, in units of the luminance.
    motion : (B, 2) float [image px]
        Displacement (x, y) over the window.
    out : (B, Y, X) float [of luminance]
        OVERWRITTEN; made when None.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    residual : (B, Y, X) float [of luminance]
        ``out``, or the new image.

    Raises
    ------
    TypeError, ValueError
        As every operation, and for nothing else.

    See Also
    --------
    render_code, brightness_residual_adjoint

    Notes
    -----
    Cost: five reads and two multiply-adds a pixel, in one pass, by one thread a row; no scratch.

    Determinism: bit for bit.
    """
    ...


@checked
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
    luminance, motion
        As in `brightness_residual`.
    adj_residual : (B, Y, X) float [loss / luminance]
        Derivative of the loss with respect to the residual.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    adj_luminance : (B, Y, X) float [loss / luminance]
        Derivative of the loss with respect to the luminance.
    adj_motion : (B, 2) float [loss / image px]
        Derivative of the loss with respect to the motion.

    Raises
    ------
    TypeError, ValueError
        As every operation, and for nothing else.

    Notes
    -----
    Cost: nine reads and some five multiply-adds a pixel, by one thread a row; scratch of (B, Y, 2), which a
    second pass adds up.

    Determinism: bit for bit.
    """
    ...


@checked
def brightness_cost(
    luminance: Floats, events_image: Floats, motion: Floats, *, mask: Floats | None = None,
    backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Half the sum of squared residuals over the pixels of a window, each with a weight.

    ``1/2 sum of mask * brightness_residual(luminance, events_image, motion) ** 2``

    Parameters
    ----------
    luminance, events_image : (B, Y, X) float [luminance]
        As in `brightness_residual`.
    motion : (B, 2) float [image px]
        Displacement over the window.
    mask : (B, Y, X) float [1]
        Weight of each pixel: 1 used, 0 not used, though it must be finite.  By default all are used.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    cost : (B,) float [luminance^2]
        That of each window.

    Raises
    ------
    ValueError
        As every operation, and if ``mask`` is below 0.

    Notes
    -----
    Cost: seven reads and some eight multiply-adds a pixel, by one thread a row; the residual is not written.
    Scratch of (B, Y), which a second pass adds up.

    Determinism: bit for bit.
    """
    ...


@checked
def brightness_cost_adjoint(
    luminance: Floats, events_image: Floats, motion: Floats, adj_cost: Floats, *, mask: Floats | None = None,
    backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Adjoint of `brightness_cost` in luminance, image of events and motion.

    A mask says what is looked at, and is held: the derivative in it would be half the squared residual.

    Parameters
    ----------
    luminance, events_image, motion, mask
        As in `brightness_cost`.
    adj_cost : (B,) float [loss / luminance^2]
        Derivative of the loss with respect to the cost.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    adj_luminance, adj_events : (B, Y, X) float [loss / luminance]
        Derivatives of the loss with respect to the luminance and to the image of events.
    adj_motion : (B, 2) float [loss / image px]
        Derivative of the loss with respect to the motion.

    Raises
    ------
    ValueError
        As `brightness_cost`.

    Notes
    -----
    Cost: two passes of one thread a row, some ten multiply-adds and two writes a pixel: the residual is found
    anew, and written once, weighted, as the derivative in the image of events.  Scratch of (B, Y, 2), which a
    third pass adds up.

    Determinism: bit for bit.
    """
    ...
