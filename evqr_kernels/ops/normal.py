"""Checked functions that make normal equations, multiply with them, and solve them directly."""

from __future__ import annotations

import numpy as np

from evqr_kernels.checks import ArrayChecks, Floats, Ints
from evqr_kernels.launch import Launch


def pose_normal_equations(
    moments: Floats, gram: Floats, terms: Ints, factors: Ints, *, ridge: float = 1e-3, backend: str = "auto",
    device: str | None = None,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Make matrix and right-hand side of one Gauss-Newton step on poses, from moments.

    Parameters
    ----------
    moments : (N, C + 1)             of `sample_moments`
    gram : (C, C)                    table^T table of its table
    terms, factors : (P + 2, 4) int32
        columns of the table that make up each parameter's derivative, and their factors: see `align_poses`;
        six or eight parameters, then the two of the gain
    ridge                            regularises the gain, relative to the trace of its Gram matrix

    Returns
    -------
    (N, 2), (N, P + 2, P + 2), (N, P + 2)   gain; J^T J; J^T r.  The step is -matrix^-1 rhs

    Notes
    -----
    One thread an entry, no atomics: results repeat bit for bit.

    See Also
    --------
    sample_moments, align_poses
    """
    checks = ArrayChecks()
    checks.floats("gram", gram, "C", "C")
    checks.floats("moments", moments, "N", len(gram) + 1)
    checks.ints("terms", terms, "P + 2", 4)
    checks.ints("factors", factors, "P + 2", 4)
    if len(terms) not in (8, 10):
        raise ValueError(f"terms must have shape (8, 4) or (10, 4), got {terms.shape}")
    checks.at_least("C", len(gram), 2)
    checks.index("terms", terms, len(gram))
    launch = Launch("pose_normal_equations", checks, backend, device)
    count, parameters = len(moments), len(terms)
    shapes = (count, 2), (count, parameters, parameters), (count, parameters)
    inputs = launch.put(moments, gram, terms, factors)
    launch.run(*inputs, ridge, *(launch.result(None, *shape) for shape in shapes))
    gain, matrix, rhs = launch.results()
    return gain, matrix, rhs


def code_normal_equations(
    image: Floats, pose: Floats, lattice: Floats, profile: Floats, slope: Floats, gain: Floats, *,
    samples_a_module: int, reach: int = 2, backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Make the normal equations of the modules' least-squares problem: A^T A as a stencil, and A^T E.

    Parameters
    ----------
    reach    modules on either side that the stencil covers; exact from (P - 1) // samples_a_module on
    others   as in `code_rhs`

    Returns
    -------
    (B, K, K), (B, M, M)   stencil, K = 2 reach + 1, and right-hand side

    Notes
    -----
    One thread an entry of the stencil, no atomics: results repeat bit for bit.

    See Also
    --------
    code_product, solve_code, solve_code_banded
    """
    checks = ArrayChecks()
    checks.floats("image", image, "B", "Y", "X")
    checks.floats("pose", pose, "B", 9)
    checks.floats("lattice", lattice, "S")
    checks.floats("profile", profile, "P")
    checks.floats("slope", slope, "P")
    checks.floats("gain", gain, "B", 2)
    checks.at_least("samples_a_module", samples_a_module, 1)
    checks.at_least("reach", reach, 0)
    launch = Launch("code_normal_equations", checks, backend, device)
    batch, samples, side = len(pose), len(lattice), 2 * reach + 1
    modules = samples // samples_a_module
    inputs = launch.put(image, pose, lattice, profile, slope, gain)
    scratch = launch.scratch(batch, samples, samples), launch.scratch(batch, 2, samples, modules)
    results = launch.result(None, batch, side, side), launch.result(None, batch, modules, modules)
    launch.run(*inputs, samples_a_module, *scratch, *results)
    stencil, rhs = launch.results()
    return stencil, rhs


def code_product(
    q: Floats, stencil: Floats, damping: Floats, free: Ints, *, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Multiply modules with the system: ``(stencil + damping I) q`` on the free ones, 0 on the others.

    Parameters
    ----------
    q : (B, M, M)            taken as it is on all modules, fixed ones included
    stencil : (B, K, K)      K odd
    damping : (B,)
    free : (M, M) int32

    Returns
    -------
    (B, M, M)

    Notes
    -----
    One thread a module: results repeat bit for bit.  It is its own adjoint where q is 0 on fixed modules.
    """
    checks = ArrayChecks()
    checks.floats("q", q, "B", "M", "M")
    _check_system(checks, stencil, damping, free)
    launch = Launch("code_product", checks, backend, device)
    launch.run(*launch.put(q, stencil, damping, free), launch.result(None, *q.shape))
    return launch.results()[0]


def solve_code_banded(
    rhs: Floats, stencil: Floats, damping: Floats, free: Ints, start: Floats, *, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Solve ``(stencil + damping I) q = -rhs`` over the free modules by a banded Cholesky factor.

    Parameters
    ----------
    rhs : (B, M, M)
    stencil : (B, K, K)      K odd; positive definite together with the damping, or q is NaN
    damping : (B,)
    free : (M, M) int32      modules that are solved for; the others keep their start
    start : (B, M, M)        values of the modules that are not free

    Returns
    -------
    (B, M, M)   q

    Notes
    -----
    One thread a window, no atomics: results repeat bit for bit.  M^4 (K / 2)^2 / 2 multiply-adds and
    M^3 (K / 2) numbers of scratch a window, whatever the condition.

    See Also
    --------
    solve_code
    """
    checks = ArrayChecks()
    checks.floats("rhs", rhs, "B", "M", "M")
    _check_system(checks, stencil, damping, free)
    checks.floats("start", start, "B", "M", "M")
    launch = Launch("solve_code_banded", checks, backend, device)
    batch, modules, _ = rhs.shape
    band = launch.scratch(batch, modules**2, (stencil.shape[1] // 2) * (modules + 1) + 1)
    launch.run(*launch.put(rhs, stencil, damping, free), band, launch.result(np.array(start), *start.shape))
    return launch.results()[0]


def _check_system(checks: ArrayChecks, stencil: Floats, damping: Floats, free: Ints) -> None:
    checks.floats("stencil", stencil, "B", "K", "K")
    checks.floats("damping", damping, "B")
    checks.ints("free", free, "M", "M")
    if stencil.shape[1] % 2 == 0:
        raise ValueError(f"stencil must have an odd side, got {stencil.shape}")
