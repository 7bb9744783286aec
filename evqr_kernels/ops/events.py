"""Checked functions from events to images."""

from __future__ import annotations

from evqr_kernels.call import checked
from evqr_kernels.checks import Floats, Ints, Pixels, Stamps
from evqr_kernels.config import SplatConfig

__all__ = [
    "bin_events",
    "bin_packed_events",
    "deposit_events",
    "deposit_events_adjoint",
    "deposit_packed_events",
    "lag_operator",
    "lag_operator_adjoint",
    "splat_events",
    "splat_events_adjoint",
]


@checked
def bin_events(
    x: Floats, y: Floats, weight: Floats, window_ptr: Ints, *, reduction: float = 1.0,
    shape: tuple[int, int] | None = None, out: Floats | None = None, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Count events into pixels of ``reduction`` px.

    Parameters
    ----------
    x, y : (E,) float [px]
        Column and row; integers are pixel centres.
    weight : (E,) float [weight]
        What an event counts; a polarity, say.
    window_ptr : (B + 1,) int32
        First event of each window, and E.
    reduction : float [px]
        Side of an image pixel.
    shape : (int, int)
        (Y, X) of the image; not needed with ``out``.
    out : (B, Y, X) float [weight]
        ACCUMULATED; made and zeroed when None.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    image : (B, Y, X) float [weight]
        ``out``, or the new image; events outside it are dropped.

    Raises
    ------
    ValueError
        If ``window_ptr`` does not go from 0 to E without decreasing, or ``reduction`` is less than 1e-6.
    TypeError
        If there is neither ``shape`` nor ``out``.

    See Also
    --------
    splat_events

    Notes
    -----
    Cost: one addition to the image an event, in one pass; no scratch.

    Determinism: atomics; to rounding on GPUs, bit for bit on CPUs.
    """
    ...


@checked
def splat_events(
    x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, motion: Floats, *,
    lag: Floats | None = None, frame: Floats | None = None, cfg: SplatConfig | None = None,
    shape: tuple[int, int] | None = None, out: Floats | None = None, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Scatter events, transported to the reference time, as splats.

    Parameters
    ----------
    x, y : (E,) float [px]
        Column and row; integers are pixel centres.
    t : (E,) float [s]
        Relative to the window's reference time.
    weight : (E,) float [weight]
        Mass of the splat; its sign tells ON from OFF.
    window_ptr : (B + 1,) int32
        First event of each window, and E.
    motion : (B, 2) or (B, 6) float [px/s, 1/s]
        Velocity (m_x, m_y) [px/s], the same everywhere; or, affine in position, (m_x, m_y, A_xx, A_xy, A_yx,
        A_yy), the last four [1/s]: an event seen at p moves with ``m + A (p - c)``, c the middle of the
        image.
    lag : (B, 2) float [image px]
        How far ON and OFF pixels lag along the motion; by default not at all.
    frame : (B, 3) float [px]
        Where the image lies: the sensor's pixel (x, y) in its first corner, and the side of its pixels; by
        default (0, 0, 1).
    cfg : SplatConfig
        Shape of the splat.
    shape : (int, int)
        (Y, X) of the image; not needed with ``out``.
    out : (B, Y, X) float [weight]
        ACCUMULATED; made and zeroed when None.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    image : (B, Y, X) float [weight]
        ``out``, or the new image; events that do not reach it are dropped.

    Raises
    ------
    ValueError
        If ``window_ptr`` does not go from 0 to E without decreasing, ``motion`` has neither 2 nor 6 columns,
        or a side in ``frame`` is not positive.
    TypeError
        If there is neither ``shape`` nor ``out``.

    See Also
    --------
    splat_events_adjoint, bin_events, deposit_events

    Notes
    -----
    Cost: T^2 additions to the image an event and twice as many multiply-adds, with
    T = 2 ceil(radius - 1/2) + 1, 5 by default; four exponentials an event, whatever T is; one pass,
    no scratch.

    Determinism: atomics; to rounding on GPUs, bit for bit on CPUs.
    """
    ...


@checked
def splat_events_adjoint(
    x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, motion: Floats, adj_image: Floats, *,
    lag: Floats | None = None, frame: Floats | None = None, cfg: SplatConfig | None = None,
    backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats, Floats, Floats]:  # fmt: skip
    """Adjoint of `splat_events` in weight, motion, position; lag and the motion's direction are parameters.

    Parameters
    ----------
    x, y, t, weight, window_ptr, motion, lag, frame, cfg
        As in `splat_events`.
    adj_image : (B, Y, X) float [loss / weight]
        Derivative of the loss with respect to the image.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    adj_weight : (E,) float [loss / weight]
        Derivative of the loss with respect to ``weight``; 0 for events that do not reach the image.
    adj_motion : (B, 2) or (B, 6) float [loss s/px, loss s]
        Derivative of the loss with respect to ``motion``.
    adj_x, adj_y : (E,) float [loss / px]
        Derivatives of the loss with respect to ``x`` and ``y``: whatever warp has made the positions, its own
        derivatives take them on.

    Raises
    ------
    ValueError
        As `splat_events`, and if ``adj_image`` does not have an image for each motion.

    Notes
    -----
    Cost: T^2 reads of the image's adjoint an event and three times as many multiply-adds: up to twice the
    time of `splat_events`.  Scratch of (B, ceil(E / 64 B), 2 or 6), which a second pass adds up.

    Determinism: bit for bit, alone and in a batch of windows of a size.  Where a window has more events than
    most, more than 64 of them make a part of the sum: its ``adj_motion`` then agrees to rounding.
    """
    ...


@checked
def deposit_events(
    x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, motion: Floats, *,
    frame: Floats | None = None, shape: tuple[int, int] | None = None, out: Floats | None = None,
    backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Share transported events among the four cells around each, ON and OFF apart.

    Parameters
    ----------
    x, y, t, weight, window_ptr, frame
        As in `splat_events`.
    motion : (B, 2) float [px/s]
        Velocity, the same everywhere; affine motions are for `splat_events` alone.
    shape : (int, int)
        (Y, X) of the images; not needed with ``out``.
    out : (B, 2, Y, X) float [weight]
        ACCUMULATED; made and zeroed when None.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    deposit : (B, 2, Y, X) float [weight]
        Images of positive and of negative weights, with their signs; events that do not lie between four
        cells are dropped.

    Raises
    ------
    ValueError
        If ``window_ptr`` does not go from 0 to E without decreasing, ``motion`` has not 2 columns, or a side
        in ``frame`` is not positive.
    TypeError
        If there is neither ``shape`` nor ``out``.

    See Also
    --------
    deposit_events_adjoint, lag_operator

    Notes
    -----
    Cost: four additions to the image an event, in one pass; no scratch.

    Determinism: atomics; to rounding on GPUs, bit for bit on CPUs.
    """
    ...


@checked
def deposit_events_adjoint(
    x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, motion: Floats, adj_deposit: Floats, *,
    frame: Floats | None = None, backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats, Floats, Floats]:  # fmt: skip
    """Adjoint of `deposit_events` in weight, motion and position, while the signs of the weights stay.

    Parameters
    ----------
    x, y, t, weight, window_ptr, motion, frame
        As in `deposit_events`.
    adj_deposit : (B, 2, Y, X) float [loss / weight]
        Derivative of the loss with respect to the deposit.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    adj_weight : (E,) float [loss / weight]
        Derivative of the loss with respect to ``weight``; 0 for events that were dropped.
    adj_motion : (B, 2) float [loss s / px]
        Derivative of the loss with respect to ``motion``.
    adj_x, adj_y : (E,) float [loss / px]
        Derivatives of the loss with respect to ``x`` and ``y``; at a cell's centre, those of its later side.
        Whatever warp has made the positions, its own derivatives take them on.

    Raises
    ------
    ValueError
        As `deposit_events`, and if ``adj_deposit`` does not have two images for each motion.

    Notes
    -----
    Cost: four reads and multiply-adds an event; then a pass over the results; scratch (B, parts, 2) with
    parts = max(1, ceil(E / (tile B))).

    Determinism: bit for bit.
    """
    ...


@checked
def bin_packed_events(
    x: Pixels, y: Pixels, stamp: Stamps, window_ptr: Ints, *, reduction: float = 1.0,
    shape: tuple[int, int] | None = None, out: Floats | None = None, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Count events of eight bytes into pixels of ``reduction`` px: their polarities, +1 and -1.

    Parameters
    ----------
    x, y : (E,) uint16
        Column and row of the pixel [px].
    stamp : (E,) uint32
        Twice the time [us], modulo 2^32, plus 1 where it became brighter.
    window_ptr : (B, 2) int32
        First event of each window, and the one behind its last; windows may share events, or have none.
    reduction : float [px]
        Side of an image pixel.
    shape : (int, int)
        (Y, X) of the image; not needed with ``out``.
    out : (B, Y, X) float [1]
        ACCUMULATED; made and zeroed, in float32, when None.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    image : (B, Y, X) float [1]
        ``out``, or the new image; events outside it are dropped.

    Raises
    ------
    ValueError
        If a row of ``window_ptr`` is not 0 to E, or decreases, or ``reduction`` is less than 1e-6.
    TypeError
        If there is neither ``shape`` nor ``out``.

    See Also
    --------
    bin_events

    Notes
    -----
    Cost: one addition to the image an event, in one pass; no scratch.

    Determinism: atomics; to rounding on GPUs, bit for bit on CPUs.
    """
    ...


@checked
def deposit_packed_events(
    x: Pixels, y: Pixels, stamp: Stamps, window_ptr: Ints, t_ref: Ints, motion: Floats, *,
    frame: Floats | None = None, extent: Ints | None = None, shape: tuple[int, int] | None = None,
    out: Floats | None = None, backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Share transported events of eight bytes among the four cells around each, ON and OFF apart.

    Parameters
    ----------
    x, y, stamp, window_ptr
        As in `bin_packed_events`.
    t_ref : (B,) int32
        Time to which each window's events are brought [us], modulo 2^31; they are within 2^30 us of it.
    motion : (B, 2) float [px/us]
        Velocity, the same everywhere.
    frame : (B, 3) float [px]
        Where the images lie, as in `splat_events`.
    extent : (B, 2) int32
        Rows and columns of the images that are the window's own, from the first: cells beyond stay as they
        are; by default all, (Y, X).
    shape : (int, int)
        (Y, X) of the images; not needed with ``out``.
    out : (B, 2, Y, X) float [1]
        ACCUMULATED; made and zeroed when None.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    deposit : (B, 2, Y, X) float [1]
        Images of ON and of OFF events, which count +1 and -1; events that do not lie between four cells are
        dropped.

    Raises
    ------
    ValueError
        If a row of ``window_ptr`` is not 0 to E, or decreases, a side in ``frame`` is not positive, or
        ``extent`` is less than 0 or more than (Y, X).
    TypeError
        If there is neither ``shape`` nor ``out``.

    See Also
    --------
    deposit_events, lag_operator

    Notes
    -----
    Cost: four additions to the image an event, in one pass; no scratch.

    Determinism: atomics; to rounding on GPUs, bit for bit on CPUs.
    """
    ...


@checked
def lag_operator(
    deposit: Floats, deposit_idx: Ints, direction: Floats, lag: Floats, taps: Floats, *,
    extent: Ints | None = None, backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Blur deposits and undo pixels that lag: ``sum_p (1 - lag_p direction . grad) blur deposit_p``.

    Parameters
    ----------
    deposit : (B, 2, Y, X) float [weight]
        Of ON and of OFF events.
    deposit_idx : (N,) int32
        The deposit that each image is made of.
    direction : (N, 2) float [1]
        Unit vector along which the pixels lag.
    lag : (N, 2) float [image px]
        Of ON and of OFF pixels.
    taps : (2, K) float [1, 1 / image px]
        A sampled blur and its slope; K odd, at least 3.
    extent : (N, 2) int32
        Rows and columns that each image has for its own, from the first: what the deposit holds beyond counts
        for nothing, as if it were outside; by default all, (Y, X).
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    image : (N, Y, X) float [weight]
        The images; 0 beyond their extent, and closer to its border than the taps reach.

    Raises
    ------
    ValueError
        If an entry of ``deposit_idx`` is not 0 to B - 1, K is even or less than 3, or ``extent`` is less than
        0 or more than (Y, X).

    See Also
    --------
    deposit_events, lag_operator_adjoint

    Notes
    -----
    Cost: 6 K multiply-adds a pixel of each image, in two passes, along rows and columns; scratch of
    (N, 2, Y, X).

    Determinism: bit for bit.
    """
    ...


@checked
def lag_operator_adjoint(
    deposit_idx: Ints, direction: Floats, lag: Floats, taps: Floats, adj_image: Floats, *, deposits: int,
    extent: Ints | None = None, backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Adjoint of `lag_operator` in the deposit, in which it is linear.

    Parameters
    ----------
    deposit_idx, direction, lag, taps, extent
        As in `lag_operator`.
    adj_image : (N, Y, X) float [loss / weight]
        Derivative of the loss with respect to the images.
    deposits : int
        B, how many deposits there are.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    adj_deposit : (B, 2, Y, X) float [loss / weight]
        Derivative of the loss with respect to the deposit; 0 where no image is made of it.

    Raises
    ------
    ValueError
        If an entry of ``deposit_idx`` is not 0 to ``deposits`` - 1, ``deposits`` is less than 0, K is even or
        less than 3, or ``extent`` is less than 0 or more than (Y, X).

    Notes
    -----
    Cost: 5 K multiply-adds a pixel of each image, in two passes, along columns and rows; the second looks
    all of ``deposit_idx`` over for each cell, or block of cells.  Scratch of (N, 2, Y, X).

    Determinism: bit for bit; images of one deposit are added up in order.
    """
    ...
