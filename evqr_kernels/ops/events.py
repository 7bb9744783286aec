"""Checked functions from events to images."""

from __future__ import annotations

import numpy as np

from evqr_kernels import arguments
from evqr_kernels.checks import ArrayChecks, Floats, Ints
from evqr_kernels.config import SplatConfig
from evqr_kernels.interop import any_arrays
from evqr_kernels.launch import CHUNK, Launch


@any_arrays
def bin_events(
    x: Floats, y: Floats, weight: Floats, window_ptr: Ints, *, reduction: float = 1.0,
    shape: tuple[int, int] | None = None, out: Floats | None = None, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Count events into pixels of ``reduction`` px.

    Parameters
    ----------
    x, y : (E,) [px]              column and row; integers are pixel centres
    weight : (E,)                 what an event counts; a polarity, say
    window_ptr : (B + 1,) int32   first event of each window; window_ptr[-1] == E
    reduction                     side of an image pixel [px]
    shape                         (Y, X) of the image; not needed with ``out``
    out : (B, Y, X)               ACCUMULATED; made and zeroed when None

    Returns
    -------
    (B, Y, X)   the image; events outside it are dropped
    """
    checks = ArrayChecks()
    arguments.events(checks, window_ptr, x=x, y=y, weight=weight)
    checks.window_values(window_ptr)
    checks.at_least("reduction", reduction, 1e-6)
    size = checks.image_shape(out, shape)
    launch = Launch("bin_events", checks, backend, device)
    launch.run(*launch.put(x, y, weight, window_ptr), reduction, launch.result(out, *size))
    return launch.results()[0]


@any_arrays
def splat_events(
    x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, motion: Floats, *,
    lag: Floats | None = None, frame: Floats | None = None, cfg: SplatConfig | None = None,
    shape: tuple[int, int] | None = None, out: Floats | None = None, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Scatter events, transported to the reference time, as splats.

    Parameters
    ----------
    x, y : (E,) [px]              column and row; integers are pixel centres
    t : (E,) [s]                  relative to the window's reference time
    weight : (E,)                 mass of the splat; its sign tells ON from OFF
    window_ptr : (B + 1,) int32   first event of each window; window_ptr[-1] == E
    motion : (B, 2) [px/s]
    lag : (B, 2) [image px]       how far ON and OFF pixels lag along the motion; by default not at all
    frame : (B, 3)                corner of the image (x, y) and side of its pixels [px]; by default 0, 0, 1
    cfg                           shape of the splat
    shape                         (Y, X) of the image; not needed with ``out``
    out : (B, Y, X)               ACCUMULATED; made and zeroed when None

    Returns
    -------
    (B, Y, X)   the image; events that do not reach it are dropped

    Notes
    -----
    One thread an event.  Float atomics: on a GPU sums repeat to a tolerance, not bit for bit.

    See Also
    --------
    splat_events_adjoint, bin_events
    """
    checks = ArrayChecks()
    lag, frame = _check_splat(checks, x, y, t, weight, window_ptr, motion, lag, frame)
    size = checks.image_shape(out, shape)
    launch = Launch("splat_events", checks, backend, device)
    inputs = launch.put(x, y, t, weight, window_ptr, motion, lag, frame)
    launch.run(*inputs, launch.result(out, *size), cfg or SplatConfig())
    return launch.results()[0]


@any_arrays
def splat_events_adjoint(
    x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, motion: Floats, adj_image: Floats, *,
    lag: Floats | None = None, frame: Floats | None = None, cfg: SplatConfig | None = None,
    backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Adjoint of `splat_events` in weight and motion; lag and the direction of the motion are parameters.

    Parameters
    ----------
    adj_image : (B, Y, X)   derivative of the loss with respect to the image
    others                  as in `splat_events`

    Returns
    -------
    (E,), (B, 2) or (B, 6)   derivatives of the loss with respect to weight and motion

    Notes
    -----
    One thread a chunk of events, no atomics: results repeat bit for bit.  Less than twice the cost of
    `splat_events`.
    """
    checks = ArrayChecks()
    lag, frame = _check_splat(checks, x, y, t, weight, window_ptr, motion, lag, frame)
    checks.floats("adj_image", adj_image, "B", "Y", "X")
    launch = Launch("splat_events_adjoint", checks, backend, device)
    inputs = launch.put(x, y, t, weight, window_ptr, motion, lag, frame, adj_image)
    events, windows = len(x), len(motion)
    chunks = launch.scratch(windows, max(1, -(-events // CHUNK)), motion.shape[1])
    adj_weight, adj_motion = launch.result(None, events), launch.result(None, *motion.shape)
    launch.run(*inputs, chunks, adj_weight, adj_motion, cfg or SplatConfig())
    adj_weight, adj_motion = launch.results()
    return adj_weight, adj_motion


@any_arrays
def deposit_events(
    x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, motion: Floats, *,
    frame: Floats | None = None, shape: tuple[int, int] | None = None, out: Floats | None = None,
    backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Share transported events among the four cells around each, ON and OFF apart.

    Parameters
    ----------
    x, y, t, weight, window_ptr, motion, frame
                         as in `splat_events`
    shape                (Y, X) of the images; not needed with ``out``
    out : (B, 2, Y, X)   ACCUMULATED; made and zeroed when None

    Returns
    -------
    (B, 2, Y, X)   images of positive and negative weights; events that do not lie between cells are dropped

    Notes
    -----
    One thread for 64 events.  Float atomics: on a GPU sums repeat to a tolerance, not bit for bit.

    See Also
    --------
    deposit_events_adjoint, lag_operator
    """
    checks = ArrayChecks()
    arguments.deposit_events(checks, x, y, t, weight, window_ptr, motion, frame)
    frame = _check_values(checks, window_ptr, motion, frame)
    if out is not None:
        checks.floats("out", out, "B", 2, "Y", "X")
        size = out.shape
    else:
        batch, height, width = checks.image_shape(None, shape)
        size = batch, 2, height, width
    launch = Launch("deposit_events", checks, backend, device)
    launch.run(*launch.put(x, y, t, weight, window_ptr, motion, frame), launch.result(out, *size))
    return launch.results()[0]


@any_arrays
def deposit_events_adjoint(
    x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, motion: Floats, adj_deposit: Floats, *,
    frame: Floats | None = None, backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Adjoint of `deposit_events` in weight, while the signs of the weights stay.

    Parameters
    ----------
    adj_deposit : (B, 2, Y, X)   derivative of the loss with respect to the deposit
    others                       as in `deposit_events`

    Returns
    -------
    (E,)   derivative of the loss with respect to weight

    Notes
    -----
    One thread an event, without atomics: results repeat bit for bit.
    """
    checks = ArrayChecks()
    arguments.deposit_events(checks, x, y, t, weight, window_ptr, motion, frame)
    frame = _check_values(checks, window_ptr, motion, frame)
    checks.floats("adj_deposit", adj_deposit, "B", 2, "Y", "X")
    launch = Launch("deposit_events_adjoint", checks, backend, device)
    inputs = launch.put(x, y, t, weight, window_ptr, motion, frame, adj_deposit)
    launch.run(*inputs, launch.result(None, len(x)))
    return launch.results()[0]


@any_arrays
def lag_operator(
    deposit: Floats, deposit_idx: Ints, direction: Floats, lag: Floats, taps: Floats, *,
    backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Blur deposits and undo pixels that lag: ``sum_p (1 - lag_p direction . grad) blur deposit_p``.

    Parameters
    ----------
    deposit : (B, 2, Y, X)         of ON and of OFF events; X at least 16 + K
    deposit_idx : (N,) int32       the deposit that each image is made of
    direction : (N, 2)             unit vector along which the pixels lag
    lag : (N, 2) [image px]        of ON and of OFF pixels
    taps : (2, K)                  a sampled blur and its slope; K odd, at least 3

    Returns
    -------
    (N, Y, X)   the images; 0 closer to the border than the taps reach

    See Also
    --------
    deposit_events, lag_operator_adjoint
    """
    checks = ArrayChecks()
    arguments.lag_operator(checks, deposit, deposit_idx, direction, lag, taps)
    checks.index("deposit_idx", deposit_idx, len(deposit))
    launch = Launch("lag_operator", checks, backend, device)
    count, (_, _, height, width) = len(deposit_idx), deposit.shape
    rows = launch.scratch(count, 2, height, width)
    launch.run(
        *launch.put(deposit, deposit_idx, direction, lag, taps),
        rows,
        launch.result(None, count, height, width),
    )
    return launch.results()[0]


@any_arrays
def lag_operator_adjoint(
    deposit_idx: Ints, direction: Floats, lag: Floats, taps: Floats, adj_image: Floats, *, deposits: int,
    backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Adjoint of `lag_operator` in the deposit, in which it is linear.

    Parameters
    ----------
    adj_image : (N, Y, X)   derivative of the loss with respect to the images
    deposits                B, how many deposits there are
    others                  as in `lag_operator`

    Returns
    -------
    (B, 2, Y, X)   derivative of the loss with respect to the deposit; 0 where no image is made of it

    Notes
    -----
    One thread a cell, without atomics: results repeat bit for bit.
    """
    checks = ArrayChecks()
    arguments.lags(checks, deposit_idx, direction, lag, taps)
    checks.floats("adj_image", adj_image, "N", "Y", "X")
    size = taps.shape[1]
    if adj_image.shape[2] < size:
        raise ValueError(f"adj_image must be at least K = {size} wide, got {adj_image.shape[2]}")
    checks.at_least("deposits", deposits, 0)
    checks.index("deposit_idx", deposit_idx, deposits)
    launch = Launch("lag_operator_adjoint", checks, backend, device)
    count, height, width = adj_image.shape
    inputs = launch.put(deposit_idx, direction, lag, taps, adj_image)
    rows = launch.scratch(count, 2, height, width)
    launch.run(*inputs, rows, launch.result(None, deposits, 2, height, width))
    return launch.results()[0]


def _check_splat(
    checks: ArrayChecks, x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, motion: Floats,
    lag: Floats | None, frame: Floats | None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Check what `splat_events` and its adjoint share; give lag and frame, or what stands for them."""
    arguments.splat_events(checks, x, y, t, weight, window_ptr, motion, lag, frame)
    frame = _check_values(checks, window_ptr, motion, frame)
    return (np.zeros((len(motion), 2), motion.dtype) if lag is None else lag), frame


def _check_values(checks: ArrayChecks, window_ptr: Ints, motion: Floats, frame: Floats | None) -> Floats:
    """Check the values of windows and frame; give the frame, or what stands for it."""
    checks.window_values(window_ptr)
    if frame is None:
        return np.tile(np.array([0.0, 0.0, 1.0], motion.dtype), (len(motion), 1))
    if not (frame[:, 2] > 0).all():
        raise ValueError(f"frame must have a positive scale, got {frame[:, 2].min()}")
    return frame
