"""Checked functions that make normal equations, multiply with them, and solve them directly."""

from __future__ import annotations

from evqr_kernels.call import checked
from evqr_kernels.checks import Floats, Ints

__all__ = [
    "code_normal_equations",
    "code_product",
    "pose_normal_equations",
    "solve_code_banded",
]


@checked
def pose_normal_equations(
    moments: Floats, gram: Floats, terms: Ints, factors: Ints, *, ridge: float = 1e-3, backend: str = "auto",
    device: str | None = None,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Make matrix and right-hand side of one Gauss-Newton step on poses, from moments.

    Parameters
    ----------
    moments : (N, C + 1) float [weight x table, weight^2]
        Of `sample_moments`.
    gram : (C, C) float [table^2]
        ``table^T table`` of its table, the last two columns of which are slopes along u and v.
    terms, factors : (P + 2, 4) int32
        Columns of the table that make up each parameter's derivative, and their factors: see
        `align_poses`.  P is 6 or 8; the last two rows are those of the gain.
    ridge : float [1]
        Regularises the gain, relative to the trace of its Gram matrix.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    gain : (N, 2) float [weight / table]
        Along u and v, by least squares.
    matrix : (N, P + 2, P + 2) float [weight^2]
        ``J^T J``; rows and columns of the gain are [weight table] and, where they meet, [table^2].
    rhs : (N, P + 2) float [weight^2]
        ``J^T r``, of the gain [weight table].  The step is ``-matrix^-1 rhs``.

    Raises
    ------
    ValueError
        If ``terms`` and ``factors`` do not have 8 or 10 rows, an entry of ``terms`` is not 0 to C - 1, or C
        is less than 2.

    See Also
    --------
    sample_moments, align_poses

    Notes
    -----
    Cost: 16 multiply-adds an entry of the matrix, by one thread each, whatever S is; no scratch.

    Determinism: bit for bit.
    """
    ...


@checked
def code_normal_equations(
    image: Floats, pose: Floats, lattice_u: Floats, lattice_v: Floats, profile: Floats, slope: Floats,
    gain: Floats, *, samples_a_module: int, reach: int = 2, space_idx: Ints | None = None,
    sides: Ints | None = None, backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Make the normal equations of the modules' least-squares problem: A^T A as a stencil, and A^T E.

    Parameters
    ----------
    image, pose, lattice_u, lattice_v, profile, slope, gain, samples_a_module, space_idx, sides
        As in `code_rhs`.
    reach : int [modules]
        On either side that the stencil covers; exact from (P - 1) // ``samples_a_module`` on.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    stencil : (B, K, K) float [weight^2]
        ``A^T A``, the same for all modules; K = 2 ``reach`` + 1.
    rhs : (B, V, U) float [weight^2]
        ``A^T E``, as of `code_rhs`.

    Raises
    ------
    ValueError
        If ``samples_a_module`` is less than 1, ``reach`` is less than 0, or an entry of ``space_idx`` is not
        0 to M - 1.

    See Also
    --------
    code_product, solve_code, solve_code_banded

    Notes
    -----
    Cost: at most 8 P multiply-adds an entry of the stencil, by one thread each, and all of `code_rhs`, with
    its scratch.

    Determinism: bit for bit.
    """
    ...


@checked
def code_product(
    q: Floats, stencil: Floats, damping: Floats, free: Ints, *, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Multiply modules with the system: ``(stencil + damping I) q`` on the free ones, 0 on the others.

    Parameters
    ----------
    q : (B, V, U) float [1]
        Taken as it is on all modules, fixed ones included.
    stencil : (B, K, K) float [weight^2]
        K odd.
    damping : (B,) float [weight^2]
        Added to the diagonal.
    free : (V, U) int32
        Modules with 0 are not free.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    product : (B, V, U) float [weight^2]
        The product.

    Raises
    ------
    ValueError
        If K is even.

    See Also
    --------
    solve_code

    Notes
    -----
    It is its own adjoint where the stencil is symmetric and q is 0 on fixed modules.

    Cost: K^2 + 1 multiply-adds a module, by one thread each; no scratch.

    Determinism: bit for bit.
    """
    ...


@checked
def solve_code_banded(
    rhs: Floats, stencil: Floats, damping: Floats, free: Ints, start: Floats, *, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Solve ``(stencil + damping I) q = -rhs`` over the free modules by a banded Cholesky factor.

    Parameters
    ----------
    rhs : (B, V, U) float [weight^2]
        Right-hand side: see `code_rhs`.
    stencil : (B, K, K) float [weight^2]
        K odd; positive definite together with the damping, or q is NaN.
    damping : (B,) float [weight^2]
        Added to the diagonal.
    free : (V, U) int32
        Modules that are solved for; those with 0 keep their start.
    start : (B, V, U) float [1]
        Values of the modules that are not free; left as it is.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    q : (B, V, U) float [1]
        The solution.

    Raises
    ------
    ValueError
        If K is even.

    See Also
    --------
    solve_code

    Notes
    -----
    Modules are numbered along the shorter side, M = min(V, U) of them.

    Cost: V U M^2 (K / 2)^2 / 2 multiply-adds a window, whatever the condition, by one thread: on a GPU it
    takes a batch of hundreds.  Scratch of (B, V U, (K // 2) (M + 1) + 1).

    Determinism: bit for bit.
    """
    ...
