"""The checked door: functions on NumPy arrays that check, choose a backend, allocate, and compute.

All arrays of a call are float32, or all float64; index arrays are int32.  Each function takes ``backend`` (a
name for `evqr_kernels.backend.get_backend`) and ``device`` ("cpu", "cuda:0", ...; by default the backend's
first), and raises

TypeError            an array that is not NumPy's, or of the wrong dtype
ValueError           a wrong shape, range, name or device
BackendUnavailable   a backend that cannot be loaded here
NotImplementedError  an operation that the backend refuses, with its reason

Who owns device buffers calls the methods of the backend, which have the same names and take the same arrays.
Shape letters: B windows, E events, Y and X image rows and columns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr_kernels.checks import ArrayChecks
from evqr_kernels.config import SplatConfig
from evqr_kernels.launch import Launch

Floats = NDArray[np.floating[Any]]
Ints = NDArray[np.int32]

CHUNK = 512
"""Events or samples that one thread adds up."""


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
    _check_events(checks, x=x, y=y, weight=weight, window_ptr=window_ptr)
    checks.at_least("reduction", reduction, 1e-6)
    size = _image_shape(checks, "out", out, shape)
    launch = Launch("bin_events", checks, backend, device)
    launch.run(*launch.put(x, y, weight, window_ptr), reduction, launch.result(out, *size))
    return launch.results()[0]


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
    size = _image_shape(checks, "out", out, shape)
    launch = Launch("splat_events", checks, backend, device)
    inputs = launch.put(x, y, t, weight, window_ptr, motion, lag, frame)
    launch.run(*inputs, launch.result(out, *size), cfg or SplatConfig())
    return launch.results()[0]


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
    (E,), (B, 2)   derivatives of the loss with respect to weight and motion
    """
    checks = ArrayChecks()
    lag, frame = _check_splat(checks, x, y, t, weight, window_ptr, motion, lag, frame)
    checks.floats("adj_image", adj_image, "B", "Y", "X")
    launch = Launch("splat_events_adjoint", checks, backend, device)
    inputs = launch.put(x, y, t, weight, window_ptr, motion, lag, frame, adj_image)
    events, windows = len(x), len(motion)
    chunks = launch.scratch(windows, max(1, -(-events // CHUNK)), 2)
    launch.run(
        *inputs, chunks, launch.result(None, events), launch.result(None, windows, 2), cfg or SplatConfig()
    )
    adj_weight, adj_motion = launch.results()
    return adj_weight, adj_motion


def motion_correlation(
    first: Floats, second: Floats, *, radius: int, backend: str = "auto", device: str | None = None
) -> Floats:
    """Correlate two images over a square of shifts.

    Parameters
    ----------
    first, second : (B, Y, X)
    radius                      largest shift along an axis [px]

    Returns
    -------
    (B, 2 R + 1, 2 R + 1)   entry (j, i) is the sum of first(y, x) second(y + j - R, x + i - R)
    """
    checks = ArrayChecks()
    checks.floats("first", first, "B", "Y", "X")
    checks.floats("second", second, "B", "Y", "X")
    checks.at_least("radius", radius, 0)
    launch = Launch("motion_correlation", checks, backend, device)
    shifts, (batch, height, _) = 2 * radius + 1, first.shape
    rows = launch.scratch(batch, height, shifts, -(-shifts // 16) * 16)
    launch.run(*launch.put(first, second), radius, rows, launch.result(None, batch, shifts, shifts))
    return launch.results()[0]


def reduce_image(image: Floats, *, ratio: float, backend: str = "auto", device: str | None = None) -> Floats:
    """Sum an image over coarser pixels, with fractional coverage at their borders.

    Parameters
    ----------
    image : (B, Y, X)
    ratio               side of a coarse pixel in fine ones, at least 1

    Returns
    -------
    (B, ceil(Y / ratio), ceil(X / ratio))
    """
    checks = ArrayChecks()
    checks.floats("image", image, "B", "Y", "X")
    checks.at_least("ratio", ratio, 1.0)
    launch = Launch("reduce_image", checks, backend, device)
    batch, height, width = image.shape
    coarse_height = int(np.ceil(height / ratio))
    out = launch.result(None, batch, coarse_height, int(np.ceil(width / ratio)))
    launch.run(*launch.put(image), ratio, launch.scratch(batch, coarse_height, width), out)
    return launch.results()[0]


def correlate_templates(
    image: Floats,
    bank: Floats,
    disc: Floats,
    floor: Floats,
    *,
    backend: str = "auto",
    device: str | None = None,
) -> tuple[Floats, Ints]:
    """Correlate an image with a bank of templates, normalised by the energy under them; keep the best.

    Parameters
    ----------
    image : (B, Y, X)
    bank : (N, N, 8)
    disc : (N, N)       weight of each place in the energy, 0 to 1
    floor : (B,)        energy below which a place is quiet; positive

    Returns
    -------
    (B, Y - N + 1, X - N + 1), the same in int32   response, its sign kept, and the index of its template
    """
    checks = ArrayChecks()
    checks.floats("image", image, "B", "Y", "X")
    checks.floats("bank", bank, "N", "N", 8)
    checks.floats("disc", disc, "N", "N")
    checks.floats("floor", floor, "B")
    if disc.size and not (disc.min() >= 0 and disc.max() <= 1):
        raise ValueError(f"disc must be 0 to 1, got {disc.min()} to {disc.max()}")
    n, (batch, height, width) = len(disc), image.shape
    # the last columns may be computed for nothing: kernels work on at least four neighbours
    wide = max(4, width - n + 1)
    image = np.pad(image, ((0, 0), (0, 0), (0, wide - (width - n + 1))))
    launch = Launch("correlate_templates", checks, backend, device)
    shape = (batch, max(0, height - n + 1), wide)
    response, angle = launch.result(None, *shape), launch.result(None, *shape, dtype=np.int32)
    launch.run(*launch.put(image, bank, disc, floor), response, angle)
    response, angle = launch.results()
    keep = max(0, width - n + 1)
    return response[:, :, :keep], angle[:, :, :keep]


def sample_moments(
    image: Floats, image_idx: Ints, pose: Floats, points: Floats, table: Floats, *,
    active: Ints | None = None, backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Moments of images seen through poses: ``sum_s e_s table[s]`` and ``sum_s e_s^2``.

    Parameters
    ----------
    image : (B, Y, X)
    image_idx : (N,) int32   the image that each pose looks at
    pose : (N, 9)            homographies, row-major: code coordinates to image pixels
    points : (S, 2)          code coordinates (u, v)
    table : (S, C)           model functions at the points
    active : (N,) int32      poses with 0 are left out, their moments 0; by default none

    Returns
    -------
    (N, C + 1)
    """
    checks = ArrayChecks()
    active = _check_moments(checks, image, image_idx, pose, points, table, active)
    launch = Launch("sample_moments", checks, backend, device)
    count, samples, moments = len(pose), len(points), table.shape[1] + 1
    chunks = launch.scratch(count, max(1, -(-samples // CHUNK)), moments)
    inputs = launch.put(image, image_idx, pose, active, points, table)
    launch.run(*inputs, chunks, launch.result(None, count, moments))
    return launch.results()[0]


def sample_moments_adjoint(
    image: Floats, image_idx: Ints, pose: Floats, points: Floats, table: Floats, adj_moments: Floats, *,
    active: Ints | None = None, out: Floats | None = None, backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Adjoint of `sample_moments` in the image.

    Parameters
    ----------
    adj_moments : (N, C + 1)   derivative of the loss with respect to the moments
    out : (B, Y, X)            ACCUMULATED; made and zeroed when None
    others                     as in `sample_moments`

    Returns
    -------
    (B, Y, X)   derivative of the loss with respect to the image
    """
    checks = ArrayChecks()
    active = _check_moments(checks, image, image_idx, pose, points, table, active)
    checks.floats("adj_moments", adj_moments, "N", table.shape[1] + 1)
    if out is not None:
        checks.floats("out", out, "B", "Y", "X")
    launch = Launch("sample_moments_adjoint", checks, backend, device)
    inputs = launch.put(image, image_idx, pose, active, points, table, adj_moments)
    launch.run(*inputs, launch.result(out, *image.shape))
    return launch.results()[0]


def align_poses(
    image: Floats, image_idx: Ints, pose: Floats, points: Floats, table: Floats, terms: Ints,
    factors: Ints, *, centre: float, scale: float, ridge: float = 1e-3, damping: float = 1e-3,
    tolerance: float = 1e-2, max_iterations: int = 10, backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Refine poses by inverse-compositional Gauss-Newton.

    Parameters
    ----------
    image, image_idx, pose, points   as in `sample_moments`; ``pose`` is where to begin
    table : (S, C)                   model functions at the points, the last two its slopes along u and v
    terms, factors : (P + 2, 4) int32
        columns of the table that make up each parameter's derivative, and what each is multiplied with: 0
        nothing, 1 and 2 the gain along u and v, 3 one; six parameters for an affine map or eight for a
        homography, then the two of the gain
    centre, scale                    of the coordinates in the table: (u - centre) / scale
    ridge, damping                   regularise the gain, relative to the trace, and the step, to the diagonal
    tolerance                        stop when the components of a step add up to less
    max_iterations                   at most so many; 0 scores the poses as they are

    Returns
    -------
    (N, 9), (N, 5)   poses; gain along u and v, score, noise and iterations

    See Also
    --------
    sample_moments
    """
    checks = ArrayChecks()
    _check_moments(checks, image, image_idx, pose, points, table, None)
    checks.ints("terms", terms, "P + 2", 4)
    checks.ints("factors", factors, "P + 2", 4)
    checks.at_least("max_iterations", max_iterations, 0)
    if len(terms) not in (8, 10):
        raise ValueError(f"terms must have shape (8, 4) or (10, 4), got {terms.shape}")
    columns = table.shape[1]
    if terms.min() < 0 or terms.max() >= columns:
        raise ValueError(f"terms must be 0 to {columns - 1}, got {terms.min()} to {terms.max()}")
    launch = Launch("align_poses", checks, backend, device)
    settings = np.array([centre, scale, ridge, damping, tolerance], launch.dtype)
    inputs = launch.put(image, image_idx, points, table, table.T @ table, terms, factors, settings)
    refined, result = launch.result(pose.copy(), *pose.shape), launch.result(None, len(pose), 5)
    launch.run(*inputs, max_iterations, refined, result)
    poses, values = launch.results()
    return poses, values


def code_rhs(
    image: Floats, pose: Floats, lattice: Floats, profile: Floats, slope: Floats, gain: Floats, *,
    samples_a_module: int, backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Right-hand side of the least-squares problem for the modules, ``A^T E``.

    Parameters
    ----------
    image : (B, Y, X)
    pose : (B, 9)              homographies, row-major: code coordinates to image pixels
    lattice : (S,) [modules]   sample positions along an axis, M modules times ``samples_a_module``
    profile, slope : (P,)      a module's profile and its derivative, centred on the module
    gain : (B, 2)              motion in modules times contrast

    Returns
    -------
    (B, M, M)
    """
    checks = ArrayChecks()
    checks.floats("image", image, "B", "Y", "X")
    checks.floats("pose", pose, "B", 9)
    checks.floats("lattice", lattice, "S")
    checks.floats("profile", profile, "P")
    checks.floats("slope", slope, "P")
    checks.floats("gain", gain, "B", 2)
    checks.at_least("samples_a_module", samples_a_module, 1)
    launch = Launch("code_rhs", checks, backend, device)
    batch, samples = len(pose), len(lattice)
    modules = samples // samples_a_module
    inputs = launch.put(image, pose, lattice, profile, slope, gain)
    scratch = launch.scratch(batch, samples, samples), launch.scratch(batch, 2, samples, modules)
    launch.run(*inputs, samples_a_module, *scratch, launch.result(None, batch, modules, modules))
    return launch.results()[0]


def solve_code(
    rhs: Floats, stencil: Floats, damping: Floats, free: Ints, start: Floats, *, max_iterations: int = 60,
    tolerance: float = 1e-3, backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Ints]:  # fmt: skip
    """Solve ``(stencil + damping I) q = -rhs`` over the free modules by conjugate gradients.

    Parameters
    ----------
    rhs : (B, M, M)
    stencil : (B, K, K)      K odd; positive definite together with the damping
    damping : (B,)
    free : (M, M) int32      modules that are solved for; the others keep their start
    start : (B, M, M)        q to begin with
    max_iterations           at most so many
    tolerance                stop when the residual is this share of what it was

    Returns
    -------
    (B, M, M), (B,) int32   q and the iterations that it took
    """
    checks = ArrayChecks()
    checks.floats("rhs", rhs, "B", "M", "M")
    checks.floats("stencil", stencil, "B", "K", "K")
    checks.floats("damping", damping, "B")
    checks.ints("free", free, "M", "M")
    checks.floats("start", start, "B", "M", "M")
    checks.at_least("max_iterations", max_iterations, 0)
    if stencil.shape[1] % 2 == 0:
        raise ValueError(f"stencil must have an odd side, got {stencil.shape}")
    launch = Launch("solve_code", checks, backend, device)
    batch, modules, _ = rhs.shape
    scratch = [launch.scratch(batch, modules, modules) for _ in range(4)]
    scratch += [launch.scratch(batch, 4, modules) for _ in range(2)]
    q = launch.result(start.copy(), *start.shape)
    iterations = launch.result(None, batch, dtype=np.int32)
    launch.run(
        *launch.put(rhs, stencil, damping, free), q, tuple(scratch), iterations,
        max_iterations=max_iterations, tolerance=tolerance,
    )  # fmt: skip
    solution, count = launch.results()
    return solution, count


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
    size = _image_shape(checks, "out", out, shape)
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


def _check_events(checks: ArrayChecks, *, window_ptr: Ints, **columns: Floats) -> None:
    for name, column in columns.items():
        checks.floats(name, column, "E")
    checks.window_ptr(window_ptr)


def _check_splat(
    checks: ArrayChecks, x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, motion: Floats,
    lag: Floats | None, frame: Floats | None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Check what `splat_events` and its adjoint share; give lag and frame, or what stands for them."""
    _check_events(checks, x=x, y=y, t=t, weight=weight, window_ptr=window_ptr)
    checks.floats("motion", motion, "B", 2)
    lag = np.zeros_like(motion) if lag is None else lag
    frame = np.tile(np.array([0.0, 0.0, 1.0], motion.dtype), (len(motion), 1)) if frame is None else frame
    checks.floats("lag", lag, "B", 2)
    checks.floats("frame", frame, "B", 3)
    if not (frame[:, 2] > 0).all():
        raise ValueError(f"frame must have a positive scale, got {frame[:, 2].min()}")
    return lag, frame


def _check_moments(
    checks: ArrayChecks, image: Floats, image_idx: Ints, pose: Floats, points: Floats, table: Floats,
    active: Ints | None,
) -> Ints:  # fmt: skip
    checks.floats("image", image, "B", "Y", "X")
    checks.floats("pose", pose, "N", 9)
    checks.ints("image_idx", image_idx, "N")
    checks.floats("points", points, "S", 2)
    checks.floats("table", table, "S", "C")
    active = np.ones(len(pose), np.int32) if active is None else active
    checks.ints("active", active, "N")
    if len(image_idx) and not (0 <= image_idx.min() and image_idx.max() < len(image)):
        raise ValueError(
            f"image_idx must be 0 to {len(image) - 1}, got {image_idx.min()} to {image_idx.max()}"
        )
    return active


def _check_render(checks: ArrayChecks, grid: Floats, affine: Floats, outside: Floats) -> None:
    checks.floats("grid", grid, "B", "G", "H")
    checks.floats("affine", affine, "B", 6)
    checks.floats("outside", outside, "B")


def _image_shape(
    checks: ArrayChecks, name: str, out: Floats | None, shape: tuple[int, int] | None
) -> tuple[int, int, int]:
    if out is not None:
        checks.floats(name, out, "B", "Y", "X")
        return checks.sizes["B"], checks.sizes["Y"], checks.sizes["X"]
    if shape is None:
        raise TypeError(f"shape of the image must be given when there is no {name}")
    height, width = shape
    return checks.sizes["B"], height, width
