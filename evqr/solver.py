"""The stages in order, for one window of events: from cold, or following a code that was seen before.

    window -> motion -> finder patterns -> stage one (pose, gain) -> lags -> stage two (normal equations)

A `Solver` owns the buffers of one thread; two threads need two solvers.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.codespace import size_of
from evqr.config import ReadConfig
from evqr.initial.finder import find_hypotheses, find_peaks
from evqr.initial.motion import Motion, estimate_motion, find_motion, window_length_us
from evqr.initial.pose import Candidate, screen
from evqr.lag import estimate_lag
from evqr.region import Region, events_near, region_around, splat_region
from evqr.stage_one import Alignment, align, fine_levels, refine_from_cold
from evqr.stage_two import NormalEquations, normal_equations
from evqr.windows import EventBuffer, Window
from evqr.workspace import Workspace
from evqr_kernels.backend import get_backend

GOOD_SCORE = 0.7
"""Correlation with the known modules that ends the search among hypotheses: one module off scores 0.56 to 0.67."""

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
        """The stages and their sum, "total"."""
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
        return size_of(self.version)

    @property
    def centre(self) -> NDArray[np.float64]:
        """Centre of the code [px]."""
        x, y, z = self.pose @ (self.size / 2.0, self.size / 2.0, 1.0)
        return np.array([x / z, y / z])

    def pose_at(self, time_us: float) -> NDArray[np.float64]:
        """The pose at another time, with the velocity held."""
        ahead = np.eye(3)
        ahead[:2, 2] = self.velocity * (time_us - self.time_us) * 1e-6
        return ahead @ self.pose


@dataclass(frozen=True, eq=False)
class _Closer:
    """A candidate, refined: its region, the events near it, and the alignment."""

    version: int
    region: Region
    events: Window
    found: Alignment

    @property
    def score(self) -> float:
        return float(self.found.score[0])


class Solver:
    """Runs the stages on windows of events.

    Parameters
    ----------
    config    what to do; default `ReadConfig()`
    backend   "auto", "warp", "numpy", or a registered name
    device    "cpu", "cuda:0", ...

    Raises
    ------
    BackendUnavailable   the backend or the device is not there
    """

    def __init__(
        self, config: ReadConfig | None = None, *, backend: str = "auto", device: str = "cpu"
    ) -> None:
        self.config = config or ReadConfig()
        self.workspace = Workspace(get_backend(backend), device)
        self.workspace.backend.load(device)
        self.clock = StageClock()

    def motion_at(self, events: EventBuffer, start_us: int, *, speed: float | None = None) -> Motion | None:
        """Motion from cold at a time of a stream, over a stretch that suits the speed [px/s] if that is known."""
        with self.clock("motion"):
            return find_motion(events, start_us, self.config.motion, workspace=self.workspace, speed=speed)

    def motion_in(self, window: Window) -> Motion | None:
        """Motion from one window's events alone."""
        with self.clock("motion"):
            return estimate_motion(window, self.config.motion, workspace=self.workspace)

    def window_us(self, speed: float) -> int:
        """Length of the windows for a speed [px/s]: fixed by the configuration, or by the travel that it asks for [us]."""
        return self.config.window_us or window_length_us(speed, self.config.travel_px, self.config.motion)

    def look(
        self, window: Window, motion: Motion, *, lag_us: tuple[float, float] | None = None
    ) -> Sighting | str:
        """Find a code in a window from cold.

        Parameters
        ----------
        lag_us   time constants known from earlier windows; None: estimated here, unless the configuration sets them

        Returns
        -------
        Sighting, or the reason in words why there is none
        """
        cfg, clock, workspace = self.config, self.clock, self.workspace
        lag_us = cfg.lag_us or lag_us
        velocity, per_us = motion.velocity, motion.speed * 1e-6
        if motion.speed <= 0.0:
            return "nothing moves"
        with clock("finder"):
            peaks, pyramid = find_peaks(window, velocity, cfg.finder, workspace=workspace)
            hypotheses = find_hypotheses(peaks, cfg.finder)
        if not hypotheses:
            return f"no three finder patterns that fit together among {len(peaks.response)} candidates"
        best: _Closer | None = None
        iterations = 0
        for batch in (hypotheses[: cfg.finder.first_hypotheses], hypotheses[cfg.finder.first_hypotheses :]):
            with clock("pose"):
                candidates, steps = screen(batch, pyramid, cfg.stage_one, workspace=workspace)
            iterations += steps
            with clock("stage_one"):
                for candidate in candidates[: cfg.stage_one.closer_looks]:
                    closer = self._look_closer(window, velocity, candidate)
                    iterations += closer.found.iterations
                    if best is None or closer.score > best.score:
                        best = closer
                    if best.score >= GOOD_SCORE:
                        break
            if best is not None and best.score >= GOOD_SCORE:
                break
        assert best is not None
        if best.score < cfg.stage_one.min_score:
            return f"the best of {len(hypotheses)} candidates agrees too little with a code: {best.score:.2f}"
        pose = best.found.pose[0]
        if lag_us is None:
            with clock("lag"):
                lag_px, found = estimate_lag(
                    best.events, velocity, best.region, pose, best.version, cfg.stage_one, workspace=workspace
                )
            lag_us, pose = (lag_px[0] / per_us, lag_px[1] / per_us), found.pose[0]
        return self._measure(best.events, velocity, best.region, pose, best.version, lag_us, iterations)

    def _look_closer(self, window: Window, velocity: NDArray[np.float64], candidate: Candidate) -> _Closer:
        """Refine a candidate on an image of its own."""
        cfg = self.config.stage_one
        region = region_around(
            candidate.pose, size_of(candidate.version), cfg, margin_px=SEARCH_MARGIN_PX
        )
        near = events_near(window, velocity, region)
        image = splat_region(near, velocity, region, cfg, workspace=self.workspace)
        found = refine_from_cold(
            image, region.from_px @ candidate.pose, candidate.version, cfg, workspace=self.workspace
        )
        return _Closer(candidate.version, region, near, found)

    def follow(self, window: Window, seen: Sighting) -> Sighting | None:
        """Find a code again that an earlier window saw; None when it is lost."""
        with self.clock("stage_one"):
            pose = seen.pose_at(window.middle_us)
            region = region_around(pose, seen.size, self.config.stage_one)
            near = events_near(window, seen.velocity, region)
        found = self._measure(
            near, seen.velocity, region, region.from_px @ pose, seen.version, seen.lag_us, 0
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
    ) -> Sighting:
        """Stage one at its finest level with the lags undone, then stage two's equations."""
        cfg, workspace = self.config, self.workspace
        per_us = float(np.hypot(*velocity)) * 1e-6
        with self.clock("stage_one"):
            image = splat_region(
                window,
                velocity,
                region,
                cfg.stage_one,
                workspace=workspace,
                lag_px=(lag_us[0] * per_us, lag_us[1] * per_us),
            )
            found = align(
                image, pose[None], version, fine_levels(cfg.stage_one), cfg.stage_one, workspace=workspace
            )
        with self.clock("stage_two"):
            equations = normal_equations(
                image, found.pose[0], found.gain[0], version, cfg.stage_one.sigma, cfg.stage_two,
                workspace=workspace,
            )  # fmt: skip
        pose_px = np.linalg.inv(region.from_px) @ found.pose[0]
        return Sighting(
            version=version,
            pose=pose_px / pose_px[2, 2],
            velocity=velocity,
            gain=found.gain[0],
            score=float(found.score[0]),
            noise=float(found.noise[0]),
            lag_us=lag_us,
            equations=equations,
            time_us=window.middle_us,
            iterations=iterations + found.iterations,
        )
