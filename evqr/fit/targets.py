"""Codes that are looked for side by side, in windows of a batch each: what stages take of them, in arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig
from evqr.fit.detection import Target
from evqr.fit.model import quiet_modules
from evqr.fit.region import Regions, region_around, regions_around, regions_of
from evqr.motion import Motions
from evqr.symbol.space import CodeSpace


class Targets:
    """Codes side by side.

    Parameters
    ----------
    targets : sequence of Target
        What was looked for before, at least one.
    time_us : sequence of float [us]
        When each is looked for, its motion held; default when it was seen.

    Attributes
    ----------
    targets : sequence of Target
        As they were given.
    spaces : list of CodeSpace
        Their kinds and sizes.
    motions : Motions
        How they move.
    pose : (N, 3, 3) float64
        Code coordinates to px at ``time_us``.
    time_us : list of float [us]
        When.
    single : list of int
        Which of them have a single finder pattern.

    Raises
    ------
    NotImplementedError
        If a motion is not the same everywhere.
    """

    def __init__(self, targets: Sequence[Target], time_us: Sequence[float] | None = None) -> None:
        self.targets = targets
        self.spaces: list[CodeSpace] = [target.space for target in targets]
        motions = [target.motion for target in targets]
        self.motions = Motions.of(motions)
        self.pose = np.concatenate([target.pose for target in targets]).reshape(-1, 3, 3)
        self.time_us = [motion.time_us for motion in motions]
        if time_us is not None:
            seconds = [(then - since) * 1e-6 for then, since in zip(time_us, self.time_us, strict=True)]
            way = self.motions.velocity * np.array(seconds)[:, None]
            self.pose[:, :2] += way[:, :, None] * self.pose[:, 2:]
            self.time_us = list(map(float, time_us))

        # rows, columns, modules of quiet zone, and whether there is a single pattern
        self._facts: list[tuple[int, int, int, bool]] = []
        last, facts = None, (0, 0, 0, False)
        for space in self.spaces:
            if space is not last:  # most often all are alike
                last, facts = space, (space.rows, space.columns, quiet_modules(space), space.single_pattern)
            self._facts.append(facts)
        self.single = [k for k, facts in enumerate(self._facts) if facts[3]]

    def __len__(self) -> int:
        return len(self.targets)

    @property
    def lag_px(self) -> NDArray[np.float64]:
        """How far the pixels lag along the motions, (N, 2), for ON and OFF events [px]."""
        tau_us = np.array([target.tau_us for target in self.targets])
        return tau_us * (self.motions.speed * 1e-6)[:, None]

    def regions(self, cfg: AlignConfig, *, margin_px: float = 0.0) -> Regions:
        """Give the regions around them; parameters as of `regions_around`."""
        if len(self) == 1:  # in Python: NumPy takes five times as long for one
            return regions_of([region_around(self.pose[0], self.spaces[0], cfg, margin_px=margin_px)])
        facts = np.array(self._facts)
        return regions_around(self.pose, facts[:, :2], facts[:, 2], cfg, margin_px=margin_px)

    def seen(self, pose: NDArray[np.float64]) -> list[Target]:
        """Give where they are, after all: at poses (N, 3, 3), closed for writing."""
        return [
            Target.trusted(
                space=target.space, pose=pose[k], motion=target.motion.at(time_us), tau_us=target.tau_us
            )
            for k, (target, time_us) in enumerate(zip(self.targets, self.time_us, strict=True))
        ]
