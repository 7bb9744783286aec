"""Checked functions from images to the pose and the modules of a planar code."""

from __future__ import annotations

from numpy.typing import ArrayLike

from evqr_kernels.call import checked
from evqr_kernels.checks import Floats, Ints

__all__ = [
    "align_poses",
    "code_rhs",
    "pull_modules",
    "sample_moments",
    "sample_moments_adjoint",
    "score_poses",
    "solve_code",
    "sum_equations",
]


@checked
def sample_moments(
    image: Floats, image_idx: Ints, pose: Floats, points: Floats, table: Floats, *,
    active: Ints | None = None, backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Moments of images seen through poses: ``sum_s e_s table[s]`` and ``sum_s e_s^2``.

    Parameters
    ----------
    image : (B, Y, X) float [weight]
        What is looked at, between pixels bilinearly: ``e_s``, 0 outside the image.
    image_idx : (N,) int32
        The image that each pose looks at.
    pose : (N, 9) float [modules to image px]
        Homographies, row-major: code coordinates to image pixels.
    points : (S, 2) float [modules]
        Code coordinates (u, v).
    table : (S, C) float [any]
        Model functions at the points.
    active : (N,) int32
        Poses with 0 are left out, their moments 0; by default none.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    moments : (N, C + 1) float [weight x table, weight^2]
        C sums with the functions of the table, and the sum of squares.

    Raises
    ------
    ValueError
        If an entry of ``image_idx`` is not 0 to B - 1.

    See Also
    --------
    sample_moments_adjoint, align_poses, pose_normal_equations

    Notes
    -----
    Cost: a projection, a look at four pixels and C + 1 multiply-adds a pose and point; scratch of
    (N, ceil(S / 512), C + 1), which a second pass adds up.

    Determinism: bit for bit.
    """
    ...


@checked
def sample_moments_adjoint(
    image: Floats, image_idx: Ints, pose: Floats, points: Floats, table: Floats, adj_moments: Floats, *,
    active: Ints | None = None, out: Floats | None = None, backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Adjoint of `sample_moments` in the image.

    Parameters
    ----------
    image, image_idx, pose, points, table, active
        As in `sample_moments`.
    adj_moments : (N, C + 1) float [loss / moments]
        Derivative of the loss with respect to the moments.
    out : (B, Y, X) float [loss / weight]
        ACCUMULATED; made and zeroed when None.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    adj_image : (B, Y, X) float [loss / weight]
        ``out``, or a new array: derivative of the loss with respect to the image.

    Raises
    ------
    ValueError
        If an entry of ``image_idx`` is not 0 to B - 1.

    Notes
    -----
    Cost: a projection, a look at four pixels, C + 1 multiply-adds and four additions to the image a pose and
    point, in one pass; no scratch.

    Determinism: atomics, by poses that may look at the same image; to rounding on GPUs, and on CPUs with
    Taichi on more than one thread; bit for bit on CPUs else.
    """
    ...


@checked
def align_poses(
    image: Floats, image_idx: Ints, pose: Floats, points: Floats, table: Floats, terms: Ints,
    factors: Ints, *, centre: ArrayLike, scale: ArrayLike, ridge: float = 1e-3, damping: float = 1e-3,
    tolerance: float = 1e-2, max_iterations: int = 10, table_idx: Ints | None = None,
    table_ptr: Ints | None = None, parameters: Ints | None = None, image_part: Ints | None = None,
    backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Refine poses by inverse-compositional Gauss-Newton.

    Parameters
    ----------
    image, image_idx, points
        As in `sample_moments`.
    pose : (N, 9) float [modules to image px]
        Homographies, row-major, where to begin; left as they are.
    table : (S, C) float [any]
        Model functions at the points, the last two its slopes along u and v; of several codes one behind the
        other.
    terms, factors : (P + 2, 4) int32
        Columns of the table that make up each parameter's derivative, and what each is multiplied with: 0
        nothing, 1 and 2 the gain along u and v, 3 one.  P is 6 for an affine map, 8 for a homography; the
        last two rows are those of the gain.
    centre, scale : (2,) or (M, 2) array-like [modules]
        Of the coordinates in the table, along u and v: ``u' = (u - centre[0]) / scale[0]``,
        ``v' = (v - centre[1]) / scale[1]``; half the size of the code, as a rule.
    ridge : float [1]
        Regularises the gain, relative to the trace of its Gram matrix.
    damping : float [1]
        Regularises the step, relative to the diagonal of its matrix.
    tolerance : float [1]
        Stop when the components of a step, of coordinates in the table, add up to less.
    max_iterations : int
        At most so many; 0 scores the poses as they are.
    table_idx : (N,) int32
        Which of M tables each pose is of; by default the first.
    table_ptr : (M, 2) int32
        First point of each table, and the one behind its last; by default one table of all points.
    parameters : (M,) int32
        How many of a table's parameters are free, 6 or 8: with 6 perspective stays; by default P.
    image_part : (N, 3) int32
        First row, rows and columns of the part of its image that each pose looks at: rows of the pose count
        from the first, and beyond the part an image is 0.  By default all of it.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    refined : (N, 9) float [modules to image px]
        Poses, their last entry 1 once they took a step.
    result : (N, 5) float [weight / table, weight / table, 1, weight^2, 1]
        Gain along u and v, score (correlation of model and image, at most 1), noise (mean square of what the
        model leaves), and iterations.

    Raises
    ------
    ValueError
        If an entry of ``image_idx`` is not 0 to B - 1, ``terms`` and ``factors`` do not have 8 or 10 rows, an
        entry of ``terms`` is not 0 to C - 1, one of ``table_idx`` not 0 to M - 1, one of ``table_ptr`` not 0
        to S, ``image_part`` is not within the image, ``max_iterations`` is less than 0, or ``centre`` or
        ``scale`` is neither a pair nor a pair a table.

    See Also
    --------
    sample_moments, pose_normal_equations

    Notes
    -----
    The parameters are displacements [modules]: 1, u', v' along u, the same along v, and ``w u'``, ``w v'``
    with ``w = (u - centre[0], v - centre[1]) / max(scale)``.  Where both scales are the same, w is (u', v'):
    the derivative in the seventh is ``G_u u' u' + G_v u' v'``, with G the model's derivative along each axis.

    There is a scale an axis so that every parameter is what moves at the code's edge, by which steps are
    limited and end.  With one scale for a code of 7 x 139 modules those along the short side would tell of
    places far outside of it: from a start half a module off it takes 8 iterations in place of 3, and one of
    three poses with perspective is not found.

    Cost: an iteration takes a pass over all points, as `sample_moments` does, and a few thousand
    multiply-adds; one pass more scores the last pose.  One thread a pose on a CPU, a block of threads on a
    GPU, which stop when their pose does; no scratch.  The Gram matrix, S C^2 multiply-adds, is made by NumPy.

    Determinism: bit for bit.
    """
    ...


@checked
def score_poses(
    image: Floats, image_idx: Ints, pose: Floats, model_idx: Ints, model_ptr: Ints, model: Floats, *,
    ridge: float = 1e-3, image_part: Ints | None = None, backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Correlate images seen through poses with models of few points, of any number of kinds in one call.

    Parameters
    ----------
    image, image_idx, pose
        As in `sample_moments`.
    model_idx : (N,) int32
        The model that each pose is of.
    model_ptr : (K, 3) int32
        Of each model its first point, the first point of its second part, and the one behind its last.
    model : (S, 4) float [modules, modules, any, any]
        Code coordinates (u, v), and the slope of what is printed along u and along v there.
    ridge : float [1]
        Regularises the gain, relative to the trace of its Gram matrix.
    image_part : (N, 3) int32
        First row, rows and columns of the part of its image that each pose looks at: rows of the pose count
        from the first, and beyond the part an image is 0.  By default all of it.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    score : (N, 3) float [1]
        Correlation with the model, -1 to 1, for the gain that fits it best: of all its points, of the first
        part and of the second; 0 of no points.

    Raises
    ------
    ValueError
        If an entry of ``image_idx`` is not 0 to B - 1, one of ``model_idx`` not 0 to K - 1, a row of
        ``model_ptr`` is not in order, ``image_part`` is not within the image, or ``ridge`` is less than 0.

    See Also
    --------
    align_poses

    Notes
    -----
    Cost: a projection, a look at four pixels and six multiply-adds a pose and point, by one thread a pose; no
    scratch.

    Determinism: bit for bit.
    """
    ...


@checked
def code_rhs(
    image: Floats, pose: Floats, lattice_u: Floats, lattice_v: Floats, profile: Floats, slope: Floats,
    gain: Floats, *, samples_a_module: int, space_idx: Ints | None = None, sides: Ints | None = None,
    backend: str = "auto", device: str | None = None,
) -> Floats:  # fmt: skip
    """Right-hand side of the least-squares problem for the modules, ``A^T E``.

    Parameters
    ----------
    image : (B, Y, X) float [weight]
        Images of events, one a pose.
    pose : (B, 9) float [modules to image px]
        Homographies, row-major: code coordinates to image pixels.
    lattice_u : (M, S) or (S,) float [modules]
        Sample positions along u of M codes, or of one: U modules times ``samples_a_module``.
    lattice_v : (M, T) or (T,) float [modules]
        Sample positions along v, V modules times ``samples_a_module``; of a square code the same array.
    profile, slope : (P,) float [1, 1 / modules]
        A module's profile and its derivative, sampled, centred on the module.
    gain : (B, 2) float [weight modules]
        Motion in modules times contrast, along u and v.
    samples_a_module : int
        Samples of all lattices, and of the profile, in a module.
    space_idx : (B,) int32
        Which of the codes each window shows; by default the first.
    sides : (M, 2) int32
        Rows and columns of modules of each code, by default V and U; what lies behind them on its lattices is
        not used.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    rhs : (B, V, U) float [weight^2]
        Right-hand side, 0 beyond a window's code; U and V are S and T over ``samples_a_module``, rounded
        down.

    Raises
    ------
    ValueError
        If ``samples_a_module`` is less than 1, an entry of ``space_idx`` is not 0 to M - 1, or a code has
        more rows or columns than V or U.

    See Also
    --------
    code_normal_equations, solve_code

    Notes
    -----
    Cost: T S projections and looks at four pixels, and 2 V P (S + U) multiply-adds a window, in two passes;
    scratch of (B, T, S) and (B, 2, V, S), a few modules wider.

    Determinism: bit for bit.
    """
    ...


@checked
def sum_equations(
    rhs: Floats, gain: Floats, noise: Floats, products: Floats, rhs_before: Floats, stencil_before: Floats,
    known: Floats, *, damping: float, least_damping: float, most_damping: float,
    score: Floats | None = None, least: Floats | None = None, space_idx: Ints | None = None,
    backend: str = "auto", device: str | None = None,
) -> tuple[Floats, Floats, Floats, Floats, Floats, Ints]:  # fmt: skip
    """Add windows' equations to those of earlier windows, by their noise, and make ready to solve the sums.

    Parameters
    ----------
    rhs : (B, V, U) float [weight^2]
        ``A^T E`` of each window: see `code_rhs`.
    gain : (B, 2) float [weight modules]
        Motion in modules times contrast, along u and v, on which a window's ``A^T A`` depends.
    noise : (B,) float [weight^2]
        Variance of a sample: a window counts by one over it.
    products : (3, K, K) float [1 / modules^2]
        K odd; ``A^T A`` as a stencil for a gain of 1 along u, of 1 along v, and what both add to that.
    rhs_before : (B, V, U) float [1]
        Sum of earlier windows, in units of their noise.
    stencil_before : (B, K, K) float [1]
        Sum of their stencils.
    known : (M, V, U) or (V, U) float [1]
        Distance of modules from light, of M codes, or of one, to begin a solution with.
    damping : float [1]
        Of the sums, in units of the noise.
    least_damping, most_damping : float [1]
        Of what is solved it is no less and no more than this.
    score : (B,) float [1]
        How well each window agrees; by default 1.
    least : (B,) float [1]
        A window that agrees less well than this is not solved for; by default 0.
    space_idx : (B,) int32
        Which of the codes each window shows; by default the first.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    rhs : (B, V, U) float [1]
        ``(rhs_before + rhs / noise) / peak``.
    stencil : (B, K, K) float [1]
        ``(stencil_before + (gain_u^2 products_0 + gain_v^2 products_1 + gain_u gain_v products_2) / noise)
        / peak``.
    peak : (B,) float [1]
        The middle of the summed stencil, or 1 where that is 0: however many windows add up, what is solved is
        of one size.
    damping : (B,) float [1]
        ``damping / peak`` within its bounds, for `pull_modules` and `solve_code`.
    q : (B, V, U) float [1]
        ``known`` of each window's code.
    solved_idx : (B,) int32
        ``space_idx``; 0 of windows that are not solved for, as no code has number 0 where others share a
        call.

    Raises
    ------
    ValueError
        If K is even, an entry of ``space_idx`` is not 0 to M - 1, or ``damping``, ``least_damping`` or
        ``most_damping`` is less than 0.

    See Also
    --------
    code_rhs, pull_modules, solve_code

    Notes
    -----
    A noise below 1e-12 counts as 1e-12.

    Cost: two operations a module, by one thread a row of modules; no scratch.

    Determinism: bit for bit.
    """
    ...


@checked
def pull_modules(
    seen: Floats, q: Floats, damping: Floats, *, certainty: float, backend: str = "auto",
    device: str | None = None,
) -> tuple[Floats, Ints]:  # fmt: skip
    """Make the right-hand side whose damping pulls each module to the dark or light that it leans to.

    Parameters
    ----------
    seen : (B, V, U) float [weight^2]
        ``A^T E``: see `code_rhs`.
    q : (B, V, U) float [1]
        Distance from light that an earlier solution found: -2 dark, 0 light.
    damping : (B,) float [weight^2]
        Of the next solution.
    certainty : float [1]
        Factor by which the pull goes beyond what was found, up to dark or light.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    rhs : (B, V, U) float [weight^2]
        ``seen + damping (1 - clip(certainty (q + 1), -1, 1))``.
    unclear : (B, V) int32
        How many modules of each row did not get to dark or light.

    Raises
    ------
    ValueError
        If ``certainty`` is less than 0, or infinite.

    See Also
    --------
    solve_code

    Notes
    -----
    Cost: some five operations a module, by one thread a row of modules; no scratch.

    Determinism: bit for bit.
    """
    ...


@checked
def solve_code(
    rhs: Floats, stencil: Floats, damping: Floats, free: Ints, start: Floats, *, max_iterations: int = 60,
    tolerance: float = 1e-3, space_idx: Ints | None = None, bounds: Ints | None = None,
    unclear: Ints | None = None, enough: Ints | None = None, backend: str = "auto",
    device: str | None = None,
) -> tuple[Floats, Ints]:  # fmt: skip
    """Solve ``(stencil + damping I) q = -rhs`` over the free modules by conjugate gradients.

    Parameters
    ----------
    rhs : (B, V, U) float [weight^2]
        Right-hand side: see `code_rhs`.
    stencil : (B, K, K) float [weight^2]
        K odd; positive definite together with the damping.
    damping : (B,) float [weight^2]
        Added to the diagonal.
    free : (M, V, U) or (V, U) int32
        Modules of M codes, or of one, that are solved for; those with 0 keep their start.
    start : (B, V, U) float [1]
        q to begin with; left as it is.
    max_iterations : int
        At most so many.
    tolerance : float [1]
        Stop when the residual is this share of what it was.
    space_idx : (B,) int32
        Which of the codes each window shows; by default the first.
    bounds : (M, 4) int32
        First row and the one behind the last, first column and the one behind the last, between which each
        code has free modules: others are not looked at; by default all.
    unclear : (B, V) int32
        Modules of each row that are unclear yet: see `pull_modules`; by default some.
    enough : (M,) int32
        A window with no more unclear modules than this is left as it is, with no iterations; by default 0.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    q : (B, V, U) float [1]
        The solution.
    iterations : (B,) int32
        How many it took.

    Raises
    ------
    ValueError
        If K is even, ``max_iterations`` is less than 0, an entry of ``space_idx`` is not 0 to M - 1, or
        ``bounds`` are not 0 to V and 0 to U.

    See Also
    --------
    solve_code_banded, code_product

    Notes
    -----
    Cost: K^2 + 6 multiply-adds a module and iteration.  On a CPU one thread a window, which stops when it has
    converged; on a GPU a block of threads a window, likewise, in the same one launch.  Its direction lies in
    memory that the block shares, up to some 100 modules a side.  Scratch of (B, 5, V, U) and
    (B, V + K - 1, U + K - 1).

    Determinism: bit for bit.
    """
    ...
