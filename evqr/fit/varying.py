"""Modules of a code whose motion is not the same all over it: stage two with a gain that varies.

Where a code turns, the gain a = (a_u, a_v) of a sample is linear in its place.  The right-hand side is exact;
the normal matrix has a stencil of its own in each module, that of the gain halfway between the two modules
that meet.  This is rare, so it is solved on the host, one code after another.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from evqr.config import ModulesConfig
from evqr.fit.model import lattices, profiles, quiet_modules
from evqr.fit.tables import REACH, fixed
from evqr.symbol.space import CodeSpace, closed

STEPS = 2 * REACH + 1


def gain_at(gain: NDArray[np.float64], space: CodeSpace, u: NDArray, v: NDArray) -> NDArray[np.float64]:
    """Give the gain (2, ...) at places (u, v) [modules]: ``gain`` (2, 3) of 1, u' and v' of `PoseTable`."""
    across, down = space.columns / 2.0, space.rows / 2.0
    along = np.ones_like(u), (u - across) / across, (v - down) / down
    return np.stack([row[0] * along[0] + row[1] * along[1] + row[2] * along[2] for row in gain])


def stencils(
    gain: NDArray[np.float64], products: tuple[NDArray[np.float64], ...], space: CodeSpace
) -> NDArray[np.float64]:
    """Give A^T A (2 REACH + 1, 2 REACH + 1, V, U): how each module meets those around it."""
    quiet, (across, down, mixed) = quiet_modules(space), products
    rows, columns = (n + 2 * quiet for n in space.shape)
    half = 0.5 * (np.arange(STEPS) - REACH)
    v = (np.arange(rows) + 0.5 - quiet)[:, None] + half[:, None, None, None]
    u = (np.arange(columns) + 0.5 - quiet) + half[:, None, None]
    u, v = np.broadcast_arrays(u, v)
    a_u, a_v = gain_at(gain, space, u, v)
    across, down, mixed = (each[:, :, None, None] for each in (across, down, mixed))
    return closed(a_u * a_u * across + a_v * a_v * down + a_u * a_v * mixed)


def right_hand_side(
    samples: NDArray[np.float64], gain: NDArray[np.float64], space: CodeSpace, sigma: float, each: int
) -> NDArray[np.float64]:
    """Give A^T e (V, U) of an image's samples on the lattice of the code, so many of each module."""
    (b_u, slope_u), (b_v, slope_v) = _along(space, sigma, each)
    across, down = lattices(space, each)
    a_u, a_v = gain_at(gain, space, *np.meshgrid(across, down))
    both = np.einsum("tv,ts->vs", b_v, a_u * samples), np.einsum("tv,ts->vs", slope_v, a_v * samples)
    return closed(np.einsum("vs,su->vu", both[0], slope_u) + np.einsum("vs,su->vu", both[1], b_u))


@functools.lru_cache(maxsize=32)
def _along(space: CodeSpace, sigma: float, each: int) -> tuple[tuple[NDArray[np.float64], ...], ...]:
    """Profile and slope of each module at all samples, (samples, modules), along u and along v."""
    quiet = quiet_modules(space)
    made = []
    for axis in lattices(space, each):
        edges = np.arange(round(len(axis) / each)) - quiet
        made.append(tuple(closed(f) for f in profiles(axis[:, None] - edges, sigma)[:2]))
    return tuple(made)


def apply_stencils(stencil: NDArray[np.floating], field: NDArray[np.floating]) -> NDArray[np.float64]:
    """Give the product of A^T A with modules (V, U), outside of which everything is 0."""
    rows, columns = field.shape
    around = np.pad(field.astype(np.float64), REACH)
    total = np.zeros((rows, columns))
    for i in range(STEPS):
        for j in range(STEPS):
            total += stencil[i, j] * around[i : i + rows, j : j + columns]
    return total


def solve_varying(
    rhs: NDArray[np.floating], stencil: NDArray[np.floating], space: CodeSpace, cfg: ModulesConfig
) -> tuple[NDArray[np.float32], int]:
    """Solve for modules in passes, as `evqr.fit.modules.Solution` does.

    Parameters
    ----------
    rhs : (V + 2 quiet, U + 2 quiet) float
        A^T e, in units of its noise.
    stencil : (2 REACH + 1, 2 REACH + 1, V + 2 quiet, U + 2 quiet) float
        A^T A.
    space : CodeSpace
        Of the code.
    cfg : ModulesConfig
        Settings.

    Returns
    -------
    q : (V, U) float32
        The modules.
    iterations : int
        Of conjugate gradients, of all passes.
    """
    which, start = fixed(space)
    free, quiet = which != 0, quiet_modules(space)
    diagonal = stencil[REACH, REACH]
    peak = float(diagonal[free].max())
    least, most = cfg.damping_range
    damping = min(max(cfg.damping / peak, least), most) * peak
    q, taken = start.astype(np.float64), 0
    enough = int(cfg.unclear * space.known.size)

    def system(field: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(free, apply_stencils(stencil, field) + damping * field, 0.0)

    for _ in range(cfg.passes):
        leaning = cfg.certainty * (q + 1.0)
        if np.count_nonzero(np.abs(leaning[free]) < 1.0) <= enough:
            break
        pulled = rhs + damping * (1.0 - np.clip(leaning, -1.0, 1.0))
        residual = np.where(free, -pulled, 0.0) - system(q)
        direction, norm = np.zeros_like(residual), 0.0
        before = first = float(np.square(residual).sum())
        for _step in range(cfg.max_iterations):
            norm = float(np.square(residual).sum())
            if not norm > cfg.tolerance**2 * first:
                break
            direction = residual + norm / before * direction
            product = system(direction)
            step = norm / float((direction * product).sum())
            q += step * direction
            residual -= step * product
            before, taken = norm, taken + 1
    rows, columns = space.shape
    inside = q[quiet : quiet + rows, quiet : quiet + columns]
    return closed((inside + 1.0).astype(np.float32)), taken
