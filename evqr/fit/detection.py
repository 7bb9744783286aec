"""What is looked for in a window, and what came of it: a code, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from evqr.fit.modules import Fused, NormalEquations
from evqr.geometry import at_centre, outline
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.symbol.space import CodeSpace, closed
from evqr.values import FrozenDict, Value, read_only

NO_LAG = (0.0, 0.0)
"""Time constants of pixels that do not lag [us]."""

NO_TIMINGS: Mapping[str, float] = FrozenDict()
"""Of what was not timed."""


@dataclass(frozen=True, eq=False)
class Target(Value):
    """A code in the image: which kind, where, how it moves, and how the pixels that see it lag.

    Attributes
    ----------
    space : CodeSpace
        Kind and size of the code.
    pose : (3, 3) float64
        Code coordinates to px at ``time_us``.
    motion : Motion
        How it moves; the pose is of its reference time.
    tau_us : (float, float) [us]
        Time constants of the pixels for ON and OFF events.
    """

    space: CodeSpace
    pose: NDArray[np.float64]
    motion: Motion
    tau_us: tuple[float, float] = NO_LAG

    def __post_init__(self) -> None:
        pose = read_only(self.pose)
        if pose.shape != (3, 3):
            raise ValueError(f"pose must have shape (3, 3), got {pose.shape}")
        object.__setattr__(self, "pose", pose)

    @property
    def time_us(self) -> float:
        """Time that the pose is of [us]."""
        return self.motion.time_us

    @property
    def lag_px(self) -> tuple[float, float]:
        """How far the pixels lag along the motion, for ON and OFF events [px]."""
        return self.motion.lag_px(self.tau_us)

    @property
    def centre(self) -> NDArray[np.float64]:
        """Centre of the code (2,) [px]."""
        return np.array(at_centre(self.pose, self.space.shape)[0])

    def outline(self, margin: float = 0.0) -> NDArray[np.float64]:
        """Give the corners of the code.

        Parameters
        ----------
        margin : float [modules]
            Around it.

        Returns
        -------
        corners : (4, 2) float64 [px]
            Top-left, top-right, bottom-right, bottom-left.
        """
        return outline(self.pose, self.space.shape, margin)

    def at(self, time_us: float) -> Target:
        """Give where the code is at another time, its motion held.

        Parameters
        ----------
        time_us : float [us]
            When.

        Returns
        -------
        target : Target
            With the pose of then.
        """
        if time_us == self.time_us:
            return self
        motion = self.motion
        pose = closed(motion.advance(self.pose, time_us))
        return self.altered(pose=pose, motion=motion.at(time_us))


@dataclass(frozen=True, eq=False)
class Detection(Value):
    """One code in one window.

    Attributes
    ----------
    target : Target
        What was found, where, at the middle of the window.
    gain : (2,) float64
        Motion in modules times contrast over threshold, of `evqr.fit.align`.
    score : float
        Correlation with the known modules, 0 to 1.
    noise : float
        Variance of a sample.
    equations : NormalEquations
        What the window says of the modules.
    iterations : int
        Gauss-Newton steps that it took.
    timings_ms : mapping of str to float [ms]
        By stage; does not count in comparisons.
    fused : Fused or None
        What the window says together with earlier ones; None where that was not asked.
    """

    target: Target
    gain: NDArray[np.float64]
    score: float
    noise: float
    equations: NormalEquations = field(repr=False)
    iterations: int
    timings_ms: Mapping[str, float] = field(default=NO_TIMINGS, compare=False)
    fused: Fused | None = field(default=None, repr=False)

    @property
    def space(self) -> CodeSpace:
        """Kind and size of the code."""
        return self.target.space

    @property
    def pose(self) -> NDArray[np.float64]:
        """Code coordinates to px (3, 3), at ``time_us``."""
        return self.target.pose

    @property
    def motion(self) -> Motion:
        """How the code moves."""
        return self.target.motion

    @property
    def tau_us(self) -> tuple[float, float]:
        """Time constants of the pixels for ON and OFF events [us]."""
        return self.target.tau_us

    @property
    def time_us(self) -> float:
        """Middle of the window [us]."""
        return self.target.time_us

    @property
    def centre(self) -> NDArray[np.float64]:
        """Centre of the code (2,) [px]."""
        return self.target.centre

    @property
    def weighted(self) -> NormalEquations:
        """The equations, weighted by one over the noise."""
        return self.equations.weighted(self.noise)

    def at(self, time_us: float) -> Target:
        """Give where the code is at another time, its motion held.

        Parameters
        ----------
        time_us : float [us]
            When.

        Returns
        -------
        target : Target
            With the pose of then.
        """
        return self.target.at(time_us)

    def moving(self, motion: Motion) -> Detection:
        """Give the same detection with a motion that is known better.

        Parameters
        ----------
        motion : Motion
            It is taken to hold at the time of the detection.

        Returns
        -------
        detection : Detection
            That differs in its motion only.
        """
        return self.altered(target=self.target.altered(motion=motion.at(self.time_us)))


@dataclass(frozen=True, eq=False)
class NotFound(Value):
    """Why a window shows no code.

    Attributes
    ----------
    reason : Reason
        Why.
    detail : str
        What it was in this case; empty where the reason says it all.
    closest : float
        Correlation of the best candidate with the known modules; 0 without one.
    nearest : Target or None
        That candidate, as far as it was refined.
    timings_ms : mapping of str to float [ms]
        By stage; does not count in comparisons.
    """

    reason: Reason
    detail: str = ""
    closest: float = 0.0
    nearest: Target | None = field(default=None, repr=False)
    timings_ms: Mapping[str, float] = field(default=NO_TIMINGS, compare=False)

    def __str__(self) -> str:
        return self.reason.explained(self.detail)
