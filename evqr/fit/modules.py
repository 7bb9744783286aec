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
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.config import ModulesConfig
from evqr.fit.align import Align
from evqr.fit.image import count_for
from evqr.fit.model import profiles, quiet_modules
from evqr.fit.tables import REACH, Codes, ModuleTables
from evqr.symbol.space import CodeSpace, closed
from evqr.values import Value
from evqr.workspace import Images, Staging, Step, Workspace

SUPPORT = 5
"""Modules that a module's blurred profile is sampled over."""


def weight_of(noise: float) -> float:
    """Give the weight of what was seen with a noise of that variance a sample."""
    return 1.0 / max(noise, 1e-12)


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
        return self.scaled(weight_of(noise))

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
    """Right-hand sides of windows' normal equations, for the poses and gains that an alignment ends with."""

    def __init__(
        self, images: Images, poses: Align, tables: ModuleTables, room: tuple[int, int], sigma: float,
        cfg: ModulesConfig, workspace: Workspace, staging: Staging | None = None,
    ) -> None:  # fmt: skip
        super().__init__(workspace, staging)
        count = images.device.shape[0]
        rows, columns = room
        self._image, self._poses, self._tables = images.device, poses, tables
        b, slope, bb, ss, bs = _profile_tables(sigma, cfg.samples)
        mixed = np.outer(bs, bs[::-1])
        self._products = np.outer(bb, ss), np.outer(ss, bb), mixed + mixed.T
        self._profile, self._slope = (workspace.put(f.astype(np.float32)) for f in (b, slope))
        self._samples = cfg.samples
        self._scratch = workspace.scratch(
            "code_rhs", B=count, S=columns * cfg.samples, T=rows * cfg.samples, P=len(b),
            samples_a_module=cfg.samples,
        )  # fmt: skip
        self._rhs = self._staging.output((count, rows, columns))

    def launch(self) -> None:
        """Launch the kernels one by one."""
        tables, poses = self._tables, self._poses
        self._backend.code_rhs(
            self._image, poses.pose, poses.number, tables["lattice_u"], tables["lattice_v"], tables["sides"],
            self._profile, self._slope, poses.gain, self._samples, *self._scratch, self._rhs.device,
        )  # fmt: skip

    def read(self, gain: NDArray[np.float64], spaces: Sequence[CodeSpace]) -> list[NormalEquations]:
        """Wait for the device and give the equations, whose matrices depend on the gains (N, 2) alone."""
        across, down, mixed = self._products
        a_u, a_v = gain[:, 0, None, None], gain[:, 1, None, None]
        stencil = a_u * a_u * across + a_v * a_v * down + a_u * a_v * mixed
        stencil, rhs, found = closed(stencil), self._rhs.read(), []
        for k, space in enumerate(spaces):
            around = 2 * quiet_modules(space)
            seen = closed(rhs[k, : space.rows + around, : space.columns + around].astype(np.float64))
            found.append(NormalEquations.trusted(space=space, stencil=stencil[k], rhs=seen))
        return found


class Solution(Step):
    """Modules of N codes, in passes, of which each pulls them to what the one before says.

    A code of which nearly all modules are clear is left as it is by the passes that are left.
    """

    def __init__(
        self,
        count: int,
        tables: ModuleTables,
        room: tuple[int, int],
        cfg: ModulesConfig,
        workspace: Workspace,
    ) -> None:
        super().__init__(workspace)
        reach, staging = 2 * REACH + 1, self._staging
        self._cfg, self._tables = cfg, tables
        self._numbers: list[int] = [0] * count
        self._number = staging.input((count,), np.int32)
        self._seen, self._q = staging.input((count, *room)), staging.both((count, *room))
        self._stencil, self._damping = staging.input((count, reach, reach)), staging.input((count,))
        self._scratch = workspace.scratch("solve_code", B=count, V=room[0], U=room[1])
        self._rhs = workspace.empty(count, *room)
        self._iterations = [staging.output((count,), np.int32) for _ in range(cfg.passes)]
        self._unclear = workspace.empty(count, room[0], dtype=np.int32)

    def write(
        self, equations: Sequence[NormalEquations], numbers: Sequence[int], weights: Sequence[float]
    ) -> None:
        """Say what was seen, of which codes, and how much it counts against what is known before."""
        least, most = self._cfg.damping_range
        seen, q, stencil, damping = (m.host for m in (self._seen, self._q, self._stencil, self._damping))
        numbers = [*numbers, *[0] * (len(self._numbers) - len(numbers))]
        for k, number in enumerate(numbers):
            if number != self._numbers[k]:
                seen[k] = q[k] = 0.0
        start = self._tables.start
        for k, (each, weight) in enumerate(zip(equations, weights, strict=True)):
            # one overall scale: float32 on the device, and many windows add up
            peak = float(each.stencil[REACH, REACH]) or 1.0
            rows, columns = each.rhs.shape
            seen[k, :rows, :columns] = each.rhs * (1.0 / peak)
            stencil[k] = each.stencil * (1.0 / peak)
            damping[k] = min(max(self._cfg.damping / (weight * peak), least), most)
            q[k, :rows, :columns] = start[numbers[k]]
        self._numbers = numbers
        self._number.write(numbers)

    def launch(self) -> None:
        """Launch the kernels one by one: modules are pulled to what they start from, free ones to grey."""
        cfg, tables, number = self._cfg, self._tables, self._number.device
        for iterations in self._iterations:
            self._backend.pull_modules(
                self._seen.device, self._q.device, self._damping.device, cfg.certainty, self._rhs,
                self._unclear,
            )  # fmt: skip
            self._backend.solve_code(
                self._rhs, self._stencil.device, self._damping.device, number, tables["free"],
                tables["bounds"], self._unclear, tables["enough"], cfg.max_iterations, cfg.tolerance,
                *self._scratch, self._q.device, iterations.device,
            )  # fmt: skip

    def read(self, spaces: Sequence[CodeSpace]) -> list[CodeEstimate]:
        """Wait for the device and give the modules of each code."""
        q = self._q.read()[: len(spaces)] + np.float32(1.0)
        iterations = functools.reduce(np.add, [mirror.read() for mirror in self._iterations]).tolist()
        found = []
        for k, space in enumerate(spaces):
            quiet = quiet_modules(space)
            inner = q[k, quiet : quiet + space.rows, quiet : quiet + space.columns].copy()
            found.append(CodeEstimate.trusted(q=closed(inner), iterations=iterations[k]))
        return found


def solve_modules(
    equations: Sequence[NormalEquations],
    cfg: ModulesConfig,
    *,
    workspace: Workspace,
    weights: Sequence[float] | None = None,
) -> list[CodeEstimate]:
    """Solve for the unknown modules of codes, with function patterns and quiet zone fixed.

    Parameters
    ----------
    equations : sequence of NormalEquations
        Of any codes.
    cfg : ModulesConfig
        Settings.
    workspace : Workspace
        Buffers.
    weights : sequence of float
        Of each, one over the variance of its noise; default 1, as of equations that are weighted already.

    Returns
    -------
    estimates : list of CodeEstimate
        Of all modules of each.  None depends on the others.
    """
    if not equations:
        return []
    codes, spaces = Codes.of(workspace), [each.space for each in equations]
    numbers = [codes.number(space) for space in spaces]
    tables, room, count = codes.modules(cfg, numbers), codes.room(numbers), count_for(len(spaces))
    step = workspace.once(
        ("solution", cfg, count, room, tables.version),
        lambda: Solution(count, tables, room, cfg, workspace),
    )
    step.write(equations, numbers, weights or [1.0] * len(equations))
    step.run()
    return step.read(spaces)
