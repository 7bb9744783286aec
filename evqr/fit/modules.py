"""Stage two: the modules q, as a damped linear least-squares problem.

For a fixed pose and gain the paper's cost is quadratic in q: ``|e + A q|^2``.  Its normal matrix is a
stencil (a module meets only its neighbours, and all alike), so a window is summed up by (2 REACH + 1)^2
numbers and one right-hand side, both of which add over windows: many windows of one code cost one solve.

Damping is what is known of a module before: it is dark or light, so about 1 away from grey, against the noise
of the events.  A pull to grey alone is a bias, though: where a code moves along its rows only the ends of a
dark run cause events, and its inside is pulled back half of the way.  So the modules are solved for again,
each pulled to the dark or light that it leant to before, or less where that was little, until nearly all are
clear.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.config import ModulesConfig
from evqr.fit.model import lattices, profiles, quiet_modules
from evqr.symbol.space import CodeSpace
from evqr.values import Value
from evqr.workspace import Images, Step, Workspace

REACH = 2
"""Modules on either side that a module meets in the normal matrix."""

SUPPORT = 5
"""Modules that a module's blurred profile is sampled over."""


@dataclass(frozen=True, eq=False)
class NormalEquations(Value):
    """What a window, or a sum of windows, knows of q - 1, the modules' distance from light.

    In units of one window's events, or of their noise once they are `weighted`.

    Attributes
    ----------
    space : CodeSpace
        Whose modules they are.
    stencil : (2 REACH + 1, 2 REACH + 1) float64
        A^T A.
    rhs : (V + 2 quiet, U + 2 quiet) float64
        A^T e; ``quiet`` are the modules of quiet zone on each side, `evqr.fit.model.quiet_modules`.
    """

    space: CodeSpace
    stencil: NDArray[np.float64]
    rhs: NDArray[np.float64]

    def __post_init__(self) -> None:
        # not copied: they are nobody else's
        self.stencil.setflags(write=False)
        self.rhs.setflags(write=False)

    def __add__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(self.space, self.stencil + other.stencil, self.rhs + other.rhs)

    def weighted(self, noise: float) -> NormalEquations:
        """Give the same equations with the weight that they deserve.

        Parameters
        ----------
        noise : float
            Variance of a sample; the weight is one over it.

        Returns
        -------
        equations : NormalEquations
            In units of their noise.
        """
        return self.scaled(1.0 / max(noise, 1e-12))

    def scaled(self, weight: float) -> NormalEquations:
        """Give the same equations with a weight.

        Parameters
        ----------
        weight : float
            Of all of them.

        Returns
        -------
        equations : NormalEquations
            As if there were so many alike.
        """
        return NormalEquations(self.space, weight * self.stencil, weight * self.rhs)


@dataclass(frozen=True, eq=False)
class CodeEstimate(Value):
    """Modules of one solve.

    Attributes
    ----------
    q : (V, U) float32
        < 0 dark, > 0 light; the known modules have their known value.
    iterations : int
        Of conjugate gradients, of all passes.
    """

    q: NDArray[np.float32]
    iterations: int


@functools.lru_cache(maxsize=32)
def _profile_tables(sigma: float, samples: int) -> tuple[NDArray[np.float64], ...]:
    """Sample profile and slope, and give their correlations at whole-module offsets: b b, b' b', b b'."""
    offsets = (np.arange(SUPPORT * samples) + 0.5) / samples - SUPPORT // 2
    b, slope, _ = profiles(offsets, sigma)

    def correlate(f: NDArray[np.float64], g: NDArray[np.float64]) -> NDArray[np.float64]:
        padded = np.pad(f, REACH * samples)
        starts = range(0, len(padded) - len(g) + 1, samples)
        return np.array([(padded[start : start + len(g)] * g).sum() for start in starts])

    return b, slope, correlate(b, b), correlate(slope, slope), correlate(b, slope)


class Equations(Step):
    """Right-hand side of a window's normal equations, for a pose (1, 9) and a gain (1, 2) on the device."""

    def __init__(
        self, images: Images, pose: Any, gain: Any, space: CodeSpace, sigma: float, cfg: ModulesConfig,
        workspace: Workspace,
    ) -> None:  # fmt: skip
        super().__init__(workspace.backend)
        self._space = space
        self._image, self._pose, self._gain = images.device, pose, gain
        across, down = lattices(space, cfg.samples)
        rows, columns = len(down) // cfg.samples, len(across) // cfg.samples
        b, slope, bb, ss, bs = _profile_tables(sigma, cfg.samples)
        mixed = np.outer(bs, bs[::-1])
        self._products = np.outer(bb, ss), np.outer(ss, bb), mixed + mixed.T
        self._across, self._down, self._profile, self._slope = (
            workspace.put(f.astype(np.float32)) for f in (across, down, b, slope)
        )
        self._samples = cfg.samples
        self._scratch = workspace.scratch(
            "code_rhs", B=1, S=len(across), T=len(down), samples_a_module=cfg.samples
        )
        self._rhs = workspace.mirror((1, rows, columns))

    def launch(self) -> None:
        """Launch the kernels one by one."""
        self._backend.code_rhs(
            self._image, self._pose, self._across, self._down, self._profile, self._slope, self._gain,
            self._samples, *self._scratch, self._rhs.device,
        )  # fmt: skip

    def read(self, gain: NDArray[np.float64]) -> NormalEquations:
        """Wait for the device and give the equations, whose matrix depends on the gain alone."""
        across, down, mixed = self._products
        a_u, a_v = gain.tolist()
        stencil = a_u * a_u * across + a_v * a_v * down + a_u * a_v * mixed
        return NormalEquations(self._space, stencil, self._rhs.read()[0].astype(np.float64))


@functools.cache
def _fixed(space: CodeSpace) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Which modules are free, and q - 1 to start from: known values, and the middle where free."""
    quiet = quiet_modules(space)
    free = np.pad(~space.known, quiet).astype(np.int32)
    start = np.pad(np.where(space.known, space.values - 1.0, -1.0), quiet).astype(np.float32)
    return free, start


class Solution(Step):
    """One pass: the modules, and the right-hand side that pulls the next pass to them.

    After `write` comes `run_first`, then `run` for every further pass.
    """

    def __init__(self, space: CodeSpace, cfg: ModulesConfig, workspace: Workspace) -> None:
        super().__init__(workspace.backend)
        free, self._start = _fixed(space)
        (rows, columns), quiet, reach = free.shape, quiet_modules(space), 2 * REACH + 1
        self._inner = np.s_[quiet : rows - quiet, quiet : columns - quiet]
        self._cfg, self._free = cfg, workspace.put(free)
        self._seen, self._q = (workspace.mirror((1, rows, columns)) for _ in range(2))
        self._stencil, self._damping = workspace.mirror((1, reach, reach)), workspace.mirror((1,))
        self._scratch = workspace.scratch("solve_code", B=1, V=rows, U=columns)
        self._rhs = workspace.empty(1, rows, columns)
        self._iterations = workspace.mirror((1,), np.int32)
        self._unclear = workspace.mirror((1, rows), np.int32)
        self.run_first = workspace.backend.record(self.launch_first)

    def write(self, equations: NormalEquations) -> None:
        """Say what was seen."""
        cfg = self._cfg
        # one overall scale: float32 on the device, and many windows add up
        peak = float(equations.stencil[REACH, REACH]) or 1.0
        np.multiply(equations.rhs, 1.0 / peak, out=self._seen.host[0], casting="unsafe")
        self._seen.push()
        self._stencil.write(equations.stencil / peak)
        least, most = cfg.damping_range
        self._damping.write(min(max(cfg.damping / peak, least), most))
        self._q.write(self._start)

    def launch_first(self) -> None:
        """Launch the first pass: modules are pulled to what they start from, free ones to grey."""
        self._pull()
        self.launch()

    def launch(self) -> None:
        """Launch the kernels one by one."""
        cfg = self._cfg
        self._backend.solve_code(
            self._rhs, self._stencil.device, self._damping.device, self._free, cfg.max_iterations,
            cfg.tolerance, *self._scratch, self._q.device, self._iterations.device,
        )  # fmt: skip
        self._pull()

    def _pull(self) -> None:
        self._backend.pull_modules(
            self._seen.device, self._q.device, self._damping.device, self._cfg.certainty, self._rhs,
            self._unclear.device,
        )  # fmt: skip

    @property
    def iterations(self) -> int:
        """Conjugate gradients of the last pass."""
        return int(self._iterations.read()[0])

    @property
    def unclear(self) -> int:
        """Modules that the last pass left unclear."""
        return sum(self._unclear.read()[0].tolist())

    def read(self) -> NDArray[np.float32]:
        """Wait for the device and give the modules (V, U)."""
        return self._q.read()[0][self._inner] + np.float32(1.0)


def solve_modules(equations: NormalEquations, cfg: ModulesConfig, *, workspace: Workspace) -> CodeEstimate:
    """Solve for the unknown modules, with function patterns and quiet zone fixed.

    Parameters
    ----------
    equations : NormalEquations
        Weighted by one over the variance of the noise.
    cfg : ModulesConfig
        Settings.
    workspace : Workspace
        Buffers.

    Returns
    -------
    estimate : CodeEstimate
        Of all modules.
    """
    space = equations.space
    step = workspace.once(("code", space, cfg), lambda: Solution(space, cfg, workspace))
    step.write(equations)
    step.run_first()
    iterations, most_unclear = step.iterations, cfg.unclear * space.known.size
    for _ in range(cfg.passes - 1):
        if step.unclear <= most_unclear:
            break
        step.run()
        iterations += step.iterations
    return CodeEstimate(step.read(), iterations)
