"""Checked functions from events to grids of pixels, polarity and time, as networks take them."""

from __future__ import annotations

from evqr_kernels.call import checked
from evqr_kernels.checks import Floats, Ints

__all__ = [
    "event_histogram",
    "time_surface",
    "voxel_grid",
    "voxel_grid_adjoint",
]


@checked
def voxel_grid(
    x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, span: Floats, *,
    bins: int | None = None, shape: tuple[int, int] | None = None, out: Floats | None = None,
    backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Share events among the two planes of time around each, at the pixel that it falls in.

    Parameters
    ----------
    x, y : (E,) float [px]
        Column and row; integers are pixel centres.
    t : (E,) float [s]
        Relative to the window's reference time.
    weight : (E,) float [weight]
        What an event counts; a polarity, say.
    window_ptr : (B + 1,) int32
        First event of each window, and E.
    span : (B, 2) float [s]
        Times of each window's first plane and last; the others lie evenly between them.
    bins : int
        K, how many planes; not needed with ``out``.
    shape : (int, int)
        (Y, X) of the planes; not needed with ``out``.
    out : (B, K, Y, X) float [weight]
        ACCUMULATED; made and zeroed when None.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    grid : (B, K, Y, X) float [weight]
        ``out``, or the new grid; events beside the image or outside the span are dropped.

    Raises
    ------
    ValueError
        If ``window_ptr`` does not go from 0 to E without decreasing, ``span`` does not end after it begins,
        or ``bins`` is less than 1.
    TypeError
        If there is neither ``shape`` and ``bins`` nor ``out``.

    See Also
    --------
    voxel_grid_adjoint, event_histogram, time_surface

    Notes
    -----
    Cost: two additions to the grid an event, in one pass; no scratch.

    Determinism: atomics; to rounding on GPUs, bit for bit on CPUs.
    """
    ...


@checked
def voxel_grid_adjoint(
    x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, span: Floats, adj_grid: Floats, *,
    backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Adjoint of `voxel_grid` in weight and time.

    Parameters
    ----------
    x, y, t, weight, window_ptr, span
        As in `voxel_grid`.
    adj_grid : (B, K, Y, X) float [loss / weight]
        Derivative of the loss with respect to the grid.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    adj_weight : (E,) float [loss / weight]
        Derivative of the loss with respect to ``weight``; 0 for events that were dropped.
    adj_t : (E,) float [loss / s]
        Derivative of the loss with respect to ``t``; at the time of a plane, that of the plane's later side.

    Raises
    ------
    ValueError
        As `voxel_grid`, and if ``adj_grid`` does not have a grid for each window.

    Notes
    -----
    Cost: two reads and multiply-adds an event, in one pass; no scratch.

    Determinism: bit for bit.
    """
    ...


@checked
def time_surface(
    x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, *, decay: float = 0.0,
    shape: tuple[int, int] | None = None, out: Floats | None = None, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Give the time of each pixel's last event, ON and OFF apart, or how far it has decayed.

    Parameters
    ----------
    x, y : (E,) float [px]
        Column and row; integers are pixel centres.
    t : (E,) float [s]
        Relative to the window's reference time; in any order.
    weight : (E,) float [any]
        Its sign tells ON from OFF.
    window_ptr : (B + 1,) int32
        First event of each window, and E.
    decay : float [s]
        Time in which an event's mark decays to 1 / e; 0: no decay.
    shape : (int, int)
        (Y, X) of the surfaces; not needed with ``out``.
    out : (B, 2, Y, X) float [s, 1]
        OVERWRITTEN; made when None.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    surface : (B, 2, Y, X) float [s, 1]
        ``out``, or new: the last times of ON and of OFF events, -infinity where there was none; with a decay
        ``exp(time / decay)``, 1 at the reference time and 0 where there was none.  Events beside the image or
        with a time that is NaN are dropped.

    Raises
    ------
    ValueError
        If ``window_ptr`` does not go from 0 to E without decreasing, or ``decay`` is less than 0.
    TypeError
        If there is neither ``shape`` nor ``out``.

    See Also
    --------
    event_histogram, voxel_grid

    Notes
    -----
    Cost: a comparison with the surface an event, after a pass that fills it; an exponential a pixel with a
    decay; no scratch.

    Determinism: bit for bit: the greatest of several times does not depend on their order.
    """
    ...


@checked
def event_histogram(
    x: Floats, y: Floats, weight: Floats, window_ptr: Ints, *, shape: tuple[int, int] | None = None,
    out: Ints | None = None, backend: str = "auto", device: str | None = None,
) -> Ints:  # fmt: skip
    """Count each pixel's events, ON and OFF apart; for bins in time give a window for each.

    Parameters
    ----------
    x, y : (E,) float [px]
        Column and row; integers are pixel centres.
    weight : (E,) float [any]
        Its sign tells ON from OFF.
    window_ptr : (B + 1,) int32
        First event of each window, and E.
    shape : (int, int)
        (Y, X) of the histograms; not needed with ``out``.
    out : (B, 2, Y, X) int32
        ACCUMULATED; made and zeroed when None.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    counts : (B, 2, Y, X) int32
        ``out``, or the new histograms of ON and of OFF events; events beside the image are dropped.

    Raises
    ------
    ValueError
        If ``window_ptr`` does not go from 0 to E without decreasing.
    TypeError
        If there is neither ``shape`` nor ``out``.

    See Also
    --------
    bin_events, time_surface, voxel_grid

    Notes
    -----
    Cost: one addition to a histogram an event, in one pass; no scratch.

    Determinism: atomics, of integers: bit for bit everywhere.
    """
    ...
