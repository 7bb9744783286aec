"""Stage two: the modules q, as a damped linear least-squares problem.

For a fixed pose and gain the paper's cost is quadratic in q: ``|e + A q|^2``.  Its normal matrix is a
stencil (a module meets only its neighbours, and all alike), so a window is summed up by (2 REACH + 1)^2
numbers and one right-hand side, both of which add over windows: many windows of one code cost one solve.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.codespace import code_space, size_of
from evqr.config import StageTwoConfig
from evqr.model import QUIET_MODULES, lattice, profiles
from evqr.workspace import Workspace

REACH = 2
"""Modules on either side that a module meets in the normal matrix."""

SUPPORT = 5
"""Modules that a module's blurred profile is sampled over."""


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """What a window, or a sum of windows, knows of q - 1, the modules' distance from light.

    Attributes
    ----------
    version
    stencil : (2 REACH + 1, 2 REACH + 1) float64     A^T A
    rhs : (n, n) float64                             A^T e, quiet zone included: n = r + 2 QUIET_MODULES
    """

    version: int
    stencil: NDArray[np.float64]
    rhs: NDArray[np.float64]

    def __add__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(self.version, self.stencil + other.stencil, self.rhs + other.rhs)

    def scaled(self, weight: float) -> NormalEquations:
        """Give the same equations with a weight, one over the noise variance."""
        return NormalEquations(self.version, weight * self.stencil, weight * self.rhs)


@dataclass(frozen=True, eq=False)
class CodeEstimate:
    """Modules of one solve.

    Attributes
    ----------
    q : (r, r) float32    < 0 dark, > 0 light; the known modules have their known value
    iterations            of conjugate gradients
    """

    q: NDArray[np.float32]
    iterations: int


@functools.lru_cache(maxsize=32)
def _profile_tables(sigma: float, samples: int) -> tuple[NDArray[np.float64], ...]:
    """Sample profile and slope, and give their correlations at whole-module offsets: b b, b' b', b b'."""
    offsets = (np.arange(SUPPORT * samples) + 0.5) / samples - SUPPORT // 2
    b, slope, _ = profiles(offsets, sigma)

    def correlate(f: NDArray[np.float64], g: NDArray[np.float64]) -> NDArray[np.float64]:
        full = np.correlate(np.pad(f, REACH * samples), g, mode="valid")
        return full[::samples]

    return b, slope, correlate(b, b), correlate(slope, slope), correlate(b, slope)


def normal_equations(
    image: Any,
    pose: NDArray[np.float64],
    gain: NDArray[np.float64],
    version: int,
    sigma: float,
    cfg: StageTwoConfig,
    *,
    workspace: Workspace,
) -> NormalEquations:
    """Build a window's normal equations.

    Parameters
    ----------
    image : (1, Y, X)   event image on the device
    pose : (3, 3)       code coordinates to cells
    gain : (2,)         of stage one
    sigma               blur of the model [modules]
    """
    b, slope, bb, ss, bs = _profile_tables(sigma, cfg.samples)
    axis = lattice(size_of(version), cfg.samples)
    count, modules = len(axis), len(axis) // cfg.samples
    rhs = workspace.buffer("code rhs", (1, modules, modules))
    workspace.backend.code_rhs(
        image,
        workspace.put(pose.reshape(1, 9).astype(np.float32)),
        workspace.table(("lattice", version, cfg.samples), axis.astype(np.float32)),
        workspace.table(("profile", sigma, cfg.samples), b.astype(np.float32)),
        workspace.table(("slope", sigma, cfg.samples), slope.astype(np.float32)),
        workspace.put(gain.reshape(1, 2).astype(np.float32)),
        cfg.samples,
        workspace.buffer("code samples", (1, count, count)),
        workspace.buffer("code rows", (1, 2, count, modules)),
        rhs,
    )
    a_u, a_v = gain
    sb = bs[::-1]
    stencil = a_u * a_u * np.outer(bb, ss) + a_v * a_v * np.outer(ss, bb)
    stencil += a_u * a_v * (np.outer(bs, sb) + np.outer(sb, bs))
    workspace.backend.synchronize(workspace.device)
    return NormalEquations(version, stencil, workspace.get(rhs)[0].astype(np.float64))


@functools.cache
def _fixed(version: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Which modules are free, and q - 1 to start from: known values, and the middle where free."""
    space = code_space(version)
    inner = slice(QUIET_MODULES, QUIET_MODULES + space.size)
    modules = space.size + 2 * QUIET_MODULES
    free = np.zeros((modules, modules), np.int32)
    free[inner, inner] = ~space.known
    start = np.zeros((modules, modules), np.float32)
    start[inner, inner] = np.where(space.known, space.values - 1.0, -1.0)
    return free, start


def solve_modules(equations: NormalEquations, cfg: StageTwoConfig, *, workspace: Workspace) -> CodeEstimate:
    """Solve for the unknown modules, with function patterns and quiet zone fixed."""
    version = equations.version
    free, start = _fixed(version)
    modules = len(free)
    # one overall scale: float32 on the device, and many windows add up
    peak = float(equations.stencil[REACH, REACH]) or 1.0
    damping = cfg.damping
    q = workspace.buffer("code q", (1, modules, modules))
    workspace.get(q)[0] = start
    field = [workspace.buffer(f"code cg {k}", (1, modules, modules)) for k in range(4)]
    rows = [workspace.buffer(f"code cg rows {k}", (1, 4, modules)) for k in range(2)]
    iterations = workspace.buffer("code iterations", (1,), np.int32)
    workspace.backend.solve_code(
        # the damping pulls q to 0, not q - 1: that moves the right-hand side
        workspace.put((equations.rhs / peak + damping)[None].astype(np.float32)),
        workspace.put((equations.stencil / peak)[None].astype(np.float32)),
        workspace.put(np.array([damping], np.float32)),
        workspace.table(("free", version), free),
        q,
        (*field, *rows),
        iterations,
        max_iterations=cfg.max_iterations,
        tolerance=cfg.tolerance,
    )
    workspace.backend.synchronize(workspace.device)
    inner = slice(QUIET_MODULES, modules - QUIET_MODULES)
    return CodeEstimate(
        workspace.get(q)[0, inner, inner] + np.float32(1.0), int(workspace.get(iterations)[0])
    )
