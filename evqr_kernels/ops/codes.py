"""Checked functions from images to the pose and the modules of a planar code."""

from __future__ import annotations

import numpy as np

from evqr_kernels import arguments
from evqr_kernels.checks import ArrayChecks, Floats, Ints
from evqr_kernels.interop import any_arrays
from evqr_kernels.launch import CHUNK, Launch


@any_arrays
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


@any_arrays
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


@any_arrays
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


@any_arrays
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


@any_arrays
def pull_modules(
    seen: Floats, q: Floats, damping: Floats, *, certainty: float, backend: str = "auto",
    device: str | None = None,
) -> tuple[Floats, Ints]:  # fmt: skip
    """Make the right-hand side whose damping pulls each module to the dark or light that it leans to.

    Parameters
    ----------
    seen : (B, M, M)   A^T E
    q : (B, M, M)      distance from light that an earlier solution found: -2 dark, 0 light
    damping : (B,)     of the next solution
    certainty          factor by which the pull goes beyond what was found, up to dark or light; >= 0

    Returns
    -------
    (B, M, M), (B, M) int32   ``seen + damping (1 - clip(certainty (q + 1), -1, 1))``, and how many modules of
                              each row did not get to dark or light

    Notes
    -----
    One thread a row: results repeat bit for bit.

    See Also
    --------
    solve_code
    """
    checks = ArrayChecks()
    checks.floats("seen", seen, "B", "M", "M")
    checks.floats("q", q, "B", "M", "M")
    checks.floats("damping", damping, "B")
    checks.at_least("certainty", certainty, 0.0)
    if certainty == np.inf:  # times zero, of modules that lean nowhere
        raise ValueError("certainty must be finite, got inf")
    launch = Launch("pull_modules", checks, backend, device)
    batch, modules, _ = q.shape
    results = launch.result(None, *q.shape), launch.result(None, batch, modules, dtype=np.int32)
    launch.run(*launch.put(seen, q, damping), certainty, *results)
    rhs, unclear = launch.results()
    return rhs, unclear


@any_arrays
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


def _check_moments(
    checks: ArrayChecks, image: Floats, image_idx: Ints, pose: Floats, points: Floats, table: Floats,
    active: Ints | None,
) -> Ints:  # fmt: skip
    """Check what reads images through poses; give ``active``, or what stands for it."""
    arguments.sample_moments(checks, image, image_idx, pose, active, points, table)
    checks.index("image_idx", image_idx, len(image))
    return np.ones(len(pose), np.int32) if active is None else active
