"""Windows of one code, combined into one estimate of its modules."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evqr.config import ModulesConfig, Vote
from evqr.fit.modules import CodeEstimate, NormalEquations, solve_modules
from evqr.workspace import Workspace


class Fusion:
    """What the windows of one code say so far."""

    def __init__(self, vote: Vote, cfg: ModulesConfig, *, workspace: Workspace) -> None:
        self._vote = vote
        self._cfg = cfg
        self._workspace = workspace
        self._sum: NormalEquations | None = None
        self._votes: NDArray[np.float64] | None = None
        self.windows = 0

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
        self.windows += 1
        weighted = equations.weighted(noise)
        if self._vote is Vote.INFORMATION:
            self._sum = weighted if self._sum is None else self._sum + weighted
            return solve_modules([self._sum], self._cfg, workspace=self._workspace)[0]
        (alone,) = solve_modules([weighted], self._cfg, workspace=self._workspace)
        if self._vote is Vote.MODE:
            ballot = np.sign(alone.q).astype(np.float64)
        else:
            ballot = alone.q.astype(np.float64) * float(np.trace(weighted.stencil))
        votes = ballot if self._votes is None else self._votes + ballot
        self._votes = votes
        strongest = float(np.abs(votes).max()) or 1.0
        return CodeEstimate((votes / strongest).astype(np.float32), alone.iterations)
