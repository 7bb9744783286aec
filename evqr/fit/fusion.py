"""Windows of one code, combined into one estimate of its modules.

Windows are added up, each with the weight that its noise deserves.  That is best where all of them are right.
A window whose pose is wrong spoils the sum, though, and where a code turns or tilts many are: so windows that
agree are summed apart as well, and a window speaks for itself.  Which of these sums is right cannot be told
before one decodes; `Fusion.others` gives those that are worth trying.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from evqr.config import ModulesConfig, Vote
from evqr.fit.model import quiet_modules
from evqr.fit.modules import REACH, CodeEstimate, Fused, NormalEquations, solve_modules
from evqr.workspace import Workspace

T = TypeVar("T")

Solving: TypeAlias = Generator["list[NormalEquations]", "list[CodeEstimate]", T]
"""Work that asks for equations to be solved, in units of their noise, and is sent their solutions."""

MOST_GROUPS = 4
"""Groups of windows that agree at most; of more, the one that waits longest for another window goes."""

NOISE_EXPLAINS = 3.0
"""Misfit that noise explains: 1 were its variance known and the other windows without noise."""

MODULES_DIFFER = 0.2
"""Mean square difference of modules that counts as agreement; 4 is that of dark and light.  Measured: 0.01 to
0.11 between windows that are read, 0.3 to 0.5 where the pose of one is off by a module in one corner."""


def misfit(weighted: NormalEquations, q: NDArray[np.float32]) -> float:
    """Give how badly modules explain a window.

    Parameters
    ----------
    weighted : NormalEquations
        Of the window, in units of their noise.
    q : (V, U) float32
        The modules.

    Returns
    -------
    misfit : float
        Mean square of what is left of the equations of a module that is not known before, in units of their
        noise: 1 where the modules are right and nothing but noise is left.
    """
    quiet = quiet_modules(weighted.space)
    rows, columns = weighted.rhs.shape
    from_light = np.pad(q.astype(np.float64) - 1.0, quiet + REACH)  # the quiet zone is light
    left = weighted.rhs.copy()
    for i, row in enumerate(weighted.stencil):
        for j, factor in enumerate(row):
            left += factor * from_light[i : i + rows, j : j + columns]
    inside = left[quiet : rows - quiet, quiet : columns - quiet][~weighted.space.known]
    return float(np.square(inside).mean()) / max(weighted.information, 1e-12)


class _Sum:
    """What some windows say together."""

    def __init__(self, vote: Vote) -> None:
        self._vote = vote
        self._equations: NormalEquations | None = None
        self._votes: NDArray[np.float64] | None = None
        self._weight = 0.0
        self._voters: NormalEquations | None = None
        self.windows = 0
        self.estimate: CodeEstimate | None = None

    @property
    def before(self) -> NormalEquations | None:
        """What another window's equations are added to before they are solved; None: nothing."""
        return self._equations

    def adding(self, weighted: NormalEquations, alone: CodeEstimate | None = None) -> Solving[CodeEstimate]:
        """Add a window, and what it says alone where that is known, and return the estimate of all so far."""
        self.windows += 1
        self.estimate = yield from self._with(weighted, alone)
        return self.estimate

    def added(self, weighted: NormalEquations, fused: Fused) -> Solving[CodeEstimate]:
        """Add a window that was solved for with `before`."""
        if self._vote is not Vote.INFORMATION:
            return (yield from self.adding(weighted, fused.estimate))
        self.windows += 1
        self._equations, self.estimate = fused.equations, fused.estimate
        return fused.estimate

    def _with(self, weighted: NormalEquations, alone: CodeEstimate | None) -> Solving[CodeEstimate]:
        if self._vote is Vote.INFORMATION:
            self._equations = weighted if self._equations is None else self._equations + weighted
            if alone is not None and self.windows == 1:
                return alone
            (estimate,) = yield [self._equations]
            return estimate
        if alone is None:
            (alone,) = yield [weighted]
        if self._vote is Vote.MODE:
            ballot, weight = np.sign(alone.q).astype(np.float64), 1.0
        else:
            weight = max(float(np.mean(np.trace(weighted.stencil))), 1e-12)
            ballot = weight * alone.q.astype(np.float64)
        votes = ballot if self._votes is None else self._votes + ballot
        self._votes = votes
        self._weight += weight
        self._voters = weighted if self._voters is None else self._voters + weighted
        return CodeEstimate((votes / self._weight).astype(np.float32), alone.iterations, self._voters)


class Fusion:
    """What the windows of one code say so far.

    `adding` and `grouping` leave it to others to solve the equations, as many at once as there are; `add` and
    `others` do all of it.
    """

    def __init__(self, vote: Vote, cfg: ModulesConfig, *, workspace: Workspace) -> None:
        self._vote = vote
        self._cfg = cfg
        self._workspace = workspace
        self._all = _Sum(vote)
        self._groups: list[_Sum] = []
        self._waiting: list[NormalEquations] = []

    @property
    def windows(self) -> int:
        """Windows that were added."""
        return self._all.windows

    def add(self, equations: NormalEquations, noise: float) -> CodeEstimate:
        """Add a window and return the estimate of all so far.

        Parameters
        ----------
        equations : NormalEquations
            Of the window.
        noise : float
            Variance of a sample: a window counts by one over it.

        Returns
        -------
        estimate : CodeEstimate
            Its strength says where it is sure.
        """
        return self._solved(self.adding(equations, noise))

    @property
    def before(self) -> NormalEquations | None:
        """What a window is to be solved for with, as `Solver.follow` does it; None: alone."""
        return self._all.before

    def adding(
        self, equations: NormalEquations, noise: float, fused: Fused | None = None
    ) -> Solving[CodeEstimate]:
        """Add a window, and what came of it with `before`; other parameters and result as of `add`."""
        weighted = equations.weighted(noise)
        self._waiting.append(weighted)
        if fused is not None:
            return (yield from self._all.added(weighted, fused))
        return (yield from self._all.adding(weighted))

    def others(self) -> Iterator[tuple[CodeEstimate, int]]:
        """Give what else may be right of the newest window, where the sum of all is not.

        Windows are put into groups when this is first asked for: a code that decodes at once costs nothing.

        Yields
        ------
        estimate : CodeEstimate
            Of the windows that agree with the newest, where they are some and not all, then of the newest
            alone, unless it is the only one.
        windows : int
            How many windows it is of.
        """
        yield from self._solved(self.grouping())

    def grouping(self) -> Solving[list[tuple[CodeEstimate, int]]]:
        """Put windows into groups; gives what `others` does."""
        group, alone, waiting = None, None, self._waiting
        self._waiting = []
        for weighted, alone in zip(waiting, (yield waiting), strict=True):
            group = yield from self._joining(weighted, alone)
        if group is None or alone is None or self.windows == 1:
            return []
        if 1 < group.windows < self.windows and group.estimate is not None:
            return [(group.estimate, group.windows), (alone, 1)]
        return [(alone, 1)]

    def _joining(self, weighted: NormalEquations, alone: CodeEstimate) -> Solving[_Sum]:
        """Add a window to the group that it agrees with best, or let it begin one."""
        best, least = None, np.inf
        for group in self._groups:
            assert group.estimate is not None
            off = misfit(weighted, group.estimate.q)
            if off < least:
                best, least = group, off
        if best is None or least > max(NOISE_EXPLAINS, MODULES_DIFFER * weighted.information):
            best = _Sum(self._vote)
            del self._groups[: max(0, len(self._groups) - MOST_GROUPS + 1)]
        else:
            self._groups.remove(best)
        self._groups.append(best)
        yield from best.adding(weighted, alone)
        return best

    def _solved(self, solving: Solving[T]) -> T:
        """Solve what is asked for."""
        try:
            equations = next(solving)
            while True:
                equations = solving.send(solve_modules(equations, self._cfg, workspace=self._workspace))
        except StopIteration as end:
            return end.value
