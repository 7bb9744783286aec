"""The stages in order, for one window of events: from cold, or following a code that was seen before.

    window -> motion -> finder patterns -> stage one (pose, gain) -> lags -> stage two (normal equations)

A `Solver` owns the buffers of one thread; two threads need two solvers.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evqr.config import LookConfig, ReadConfig
from evqr.device import kernels_on
from evqr.events.buffer import EventBuffer
from evqr.events.window import Window
from evqr.fit.align import Alignment, escape_side_minimum
from evqr.fit.image import depositing
from evqr.fit.lag import estimate_lag
from evqr.fit.measure import measure
from evqr.fit.modules import NormalEquations
from evqr.fit.region import Region, region_around
from evqr.search.finder import find_hypotheses
from evqr.search.motion_estimate import Motion, estimate_motion, find_motion, window_length_us
from evqr.search.screen import Candidate, batches, screen
from evqr.symbol import qr
from evqr.workspace import Workspace

SURE_TRAVEL_PX = 0.6
"""Travel in a window below which the direction of the motion is not sure [px]."""

UNSURE_TURNS = (0.0, 0.25 * math.pi, -0.25 * math.pi, 0.5 * math.pi)
"""Directions tried where it is not sure, against the estimate [rad]; the opposite ones look like an inverted
code."""

SEARCH_MARGIN_PX = 4.0
"""How far the pose from the search may be off, for the size of the region [px]."""


class StageClock:
    """Milliseconds by stage."""

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time a stage; times of the same stage add up."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.ms[stage] = self.ms.get(stage, 0.0) + 1e3 * (time.perf_counter() - start)

    def total(self) -> dict[str, float]:
        """Give the stages and their sum, "total"."""
        return {**self.ms, "total": sum(self.ms.values())}


@dataclass(frozen=True, eq=False)
class Sighting:
    """One code in one window.

    Attributes
    ----------
    version              1 to 40
    pose : (3, 3)        code coordinates to px, at the middle of the window
    velocity : (2,)      [px/s]
    gain : (2,)          of stage one
    score                correlation with the known modules, 0 to 1
    noise                variance of a sample
    lag_us               time constants of the pixels for ON and OFF events [us]
    equations            of stage two
    time_us              middle of the window [us]
    iterations           of stage one
    """

    version: int
    pose: NDArray[np.float64]
    velocity: NDArray[np.float64]
    gain: NDArray[np.float64]
    score: float
    noise: float
    lag_us: tuple[float, float]
    equations: NormalEquations
    time_us: float
    iterations: int

    @property
    def size(self) -> int:
        """Modules a side."""
        return qr.size_of(self.version)

    @property
    def weighted(self) -> NormalEquations:
        """Stage two's equations, weighted by one over the noise."""
        return self.equations.weighted(self.noise)

    @property
    def centre(self) -> NDArray[np.float64]:
        """Centre of the code [px]."""
        x, y, z = self.pose @ (self.size / 2.0, self.size / 2.0, 1.0)
        return np.array([x / z, y / z])

    def pose_at(self, time_us: float) -> NDArray[np.float64]:
        """Give the pose at another time, with the velocity held."""
        ahead = np.eye(3)
        ahead[:2, 2] = self.velocity * (time_us - self.time_us) * 1e-6
        return ahead @ self.pose


@dataclass(frozen=True)
class Unseen:
    """Why a window shows no code.

    Attributes
    ----------
    reason    in words
    closest   correlation of the best candidate with the known modules; 0 without one
    """

    reason: str
    closest: float = 0.0


@dataclass(frozen=True, eq=False)
class _Closer:
    """A candidate, refined; ``equations`` are None where they are not of its pose.

    ``deposited``: whether its events still are on the device's cells.
    """

    version: int
    region: Region
    found: Alignment
    equations: NormalEquations | None
    deposited: bool = True
    iterations: int = 0

    @property
    def score(self) -> float:
        return float(self.found.score[0])


def _closeness(found: Sighting | Unseen) -> tuple[bool, float]:
    """Order what looks have found: a code before none, then by how well it agrees."""
    seen = isinstance(found, Sighting)
    return seen, found.score if seen else found.closest


def _turned(velocity: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]]) @ velocity


def _lag_px(lag_us: tuple[float, float] | None, velocity: NDArray[np.float64]) -> tuple[float, float]:
    """Lags along the motion for time constants [px]."""
    if lag_us is None:
        return 0.0, 0.0
    per_us = float(np.hypot(*velocity)) * 1e-6
    return lag_us[0] * per_us, lag_us[1] * per_us


class Solver:
    """Runs the stages on windows of events.

    Parameters
    ----------
    config    what to do; default `ReadConfig()`
    backend   "auto", "warp", "numpy", or a registered name
    device    "cpu", "cuda:0", ...

    Raises
    ------
    BackendError   the backend or the device is not there
    """

    def __init__(
        self, config: ReadConfig | None = None, *, backend: str = "auto", device: str = "cpu"
    ) -> None:
        self.config = config or ReadConfig()
        self.workspace = Workspace(kernels_on(backend, device), device)
        self.workspace.backend.load(device)
        self.clock = StageClock()

    def motion_at(self, events: EventBuffer, start_us: int, *, speed: float | None = None) -> Motion | None:
        """Estimate the motion at a time of a stream from cold; ``speed`` is a guess [px/s]."""
        with self.clock("motion"):
            asking = find_motion(start_us, self.config.motion, workspace=self.workspace, speed=speed)
            return events.answer(asking)

    def motion_in(self, window: Window) -> Motion | None:
        """Estimate the motion from one window's events alone."""
        with self.clock("motion"):
            return estimate_motion(window, self.config.motion, workspace=self.workspace)

    def window_us(self, speed: float) -> int:
        """Give the length of windows for a speed [px/s]: fixed, or as their travel asks for [us]."""
        if self.config.window_us is not None:
            return self.config.window_us
        return window_length_us(speed, self.config.travel_px, self.config.motion)

    def look(
        self, window: Window, motion: Motion, *, lag_us: tuple[float, float] | None = None
    ) -> Sighting | Unseen:
        """Find a code in a window from cold.

        Parameters
        ----------
        lag_us   time constants known from earlier windows; None: estimated, if not configured

        Returns
        -------
        Sighting, or why there is none
        """
        lag_us = self.config.lag_us or lag_us
        if motion.speed <= 0.0:
            return Unseen("nothing moves")
        sure = motion.speed * window.seconds >= SURE_TRAVEL_PX
        best: Sighting | Unseen = Unseen("")
        looks = self.config.finder.looks
        tries = [(0.0, look) for look in looks] if sure else [(turn, looks[-1]) for turn in UNSURE_TURNS]
        for turn, look in tries:
            found = self._look_along(window, _turned(motion.velocity, turn), lag_us, look)
            if _closeness(found) >= _closeness(best):
                best = found
            if isinstance(best, Sighting) and best.score >= self.config.stage_one.good_score:
                break
        return best

    def _look_along(
        self,
        window: Window,
        velocity: NDArray[np.float64],
        lag_us: tuple[float, float] | None,
        look: LookConfig,
    ) -> Sighting | Unseen:
        """Find a code that moves with a velocity."""
        cfg, clock, workspace = self.config, self.clock, self.workspace
        with clock("finder"):
            lag_px = (0.0, 0.0) if lag_us == (0.0, 0.0) else None
            found = find_hypotheses(
                window, velocity, cfg.finder, workspace=workspace, look=look, lag_px=lag_px
            )
        hypotheses = found.hypotheses
        if not hypotheses:
            return Unseen(f"no three finder patterns that fit together among {len(found.peaks)} candidates")
        best: Sighting | None = None
        closest = 0.0
        iterations = 0
        for batch in batches(hypotheses, cfg.finder.first_hypotheses):
            with clock("pose"):
                candidates, steps = screen(batch, found.pyramid, cfg.stage_one, workspace=workspace)
            candidates = [c for c in candidates if c.score >= look.min_score]
            if not candidates:
                continue
            with clock("stage_one"):
                closer = self._look_closer(window, velocity, candidates[: cfg.stage_one.closer_looks], lag_us)
            iterations += steps + closer.iterations
            closest = max(closest, closer.score)
            if closer.score < cfg.stage_one.min_score:
                continue
            sighting = self._settle(window, closer, velocity, lag_us, iterations)
            if best is None or sighting.score > best.score:
                best = sighting
            if best.score >= self.config.stage_one.good_score:
                break
        return best or Unseen(
            f"the best of {len(hypotheses)} candidates agrees too little with a code: {closest:.2f}", closest
        )

    def _look_closer(
        self,
        window: Window,
        velocity: NDArray[np.float64],
        candidates: list[Candidate],
        lag_us: tuple[float, float] | None,
    ) -> _Closer:
        """Refine candidates, each on an image of its own, and return the best."""
        cfg = self.config.stage_one
        looks: list[_Closer] = []
        for candidate in candidates:
            version = candidate.version
            region = region_around(candidate.pose, qr.size_of(version), cfg, margin_px=SEARCH_MARGIN_PX)
            seen = measure(
                window, velocity, region, region.from_px @ candidate.pose, version, _lag_px(lag_us, velocity),
                self.config, workspace=self.workspace,
            )  # fmt: skip
            found = escape_side_minimum(seen.image, seen.found, version, cfg, workspace=self.workspace)
            equations = seen.equations if found is seen.found else None
            looks.append(_Closer(version, region, found, equations))
            if looks[-1].score >= cfg.good_score:
                break
        best = max(looks, key=lambda look: look.score)
        iterations = sum(look.found.iterations for look in looks)
        return replace(best, deposited=best is looks[-1], iterations=iterations)

    def _settle(
        self,
        window: Window,
        closer: _Closer,
        velocity: NDArray[np.float64],
        lag_us: tuple[float, float] | None,
        iterations: int,
    ) -> Sighting:
        """Estimate what is still unknown of a code that was found, and measure it."""
        region, version, pose = closer.region, closer.version, closer.found.pose[0]
        if lag_us is None and closer.score >= self.config.stage_one.sharp_score:
            lag_us = (0.0, 0.0)
        if lag_us is not None and closer.equations is not None:
            return _sighting(
                window, closer.found, closer.equations, velocity, region, version, lag_us, iterations
            )
        deposited = closer.deposited
        if lag_us is None:
            with self.clock("lag"):
                step = depositing(window, velocity, region, workspace=self.workspace)
                if not deposited:
                    step.run()
                    deposited = True
                lag_px, found = estimate_lag(
                    step.cells, velocity, region, pose, version, self.config.stage_one,
                    workspace=self.workspace,
                )  # fmt: skip
            per_us = float(np.hypot(*velocity)) * 1e-6
            lag_us = (lag_px[0] / per_us, lag_px[1] / per_us)
            pose = found.pose[0]
        return self._measure(
            window, velocity, region, pose, version, lag_us, iterations, from_events=not deposited
        )

    def follow(self, window: Window, seen: Sighting) -> Sighting | None:
        """Find a code again that an earlier window saw; None when it is lost."""
        pose = seen.pose_at(window.middle_us)
        region = region_around(pose, seen.size, self.config.stage_one)
        found = self._measure(
            window, seen.velocity, region, region.from_px @ pose, seen.version, seen.lag_us, 0
        )
        return found if found.score >= self.config.stage_one.min_score else None

    def _measure(
        self,
        window: Window,
        velocity: NDArray[np.float64],
        region: Region,
        pose: NDArray[np.float64],
        version: int,
        lag_us: tuple[float, float],
        iterations: int,
        *,
        from_events: bool = True,
    ) -> Sighting:
        """Measure a code whose pose is nearly known, with the lags undone."""
        with self.clock("stage_one"):
            seen = measure(
                window, velocity, region, pose, version, _lag_px(lag_us, velocity), self.config,
                workspace=self.workspace, from_events=from_events,
            )  # fmt: skip
        iterations += seen.found.iterations
        return _sighting(window, seen.found, seen.equations, velocity, region, version, lag_us, iterations)


def _sighting(
    window: Window,
    found: Alignment,
    equations: NormalEquations,
    velocity: NDArray[np.float64],
    region: Region,
    version: int,
    lag_us: tuple[float, float],
    iterations: int,
) -> Sighting:
    """Give what was measured on a region in px of the sensor."""
    pose = region.to_px @ found.pose[0]
    return Sighting(
        version=version,
        pose=pose / pose[2, 2],
        velocity=velocity,
        gain=found.gain[0],
        score=float(found.score[0]),
        noise=float(found.noise[0]),
        lag_us=lag_us,
        equations=equations,
        time_us=window.middle_us,
        iterations=iterations,
    )
