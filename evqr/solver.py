"""The stages in order, for one window of events: a code from cold, or one that was seen before.

    window -> motion -> finder patterns -> align (pose, gain) -> lags -> equations -> modules

A `Solver` owns the buffers of one thread; two threads need two solvers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from evqr.clock import StageClock
from evqr.config import ReadConfig, SearchPass
from evqr.device import kernels_on, load
from evqr.events.batch import EventBatch
from evqr.events.buffer import Asking
from evqr.events.window import Window
from evqr.fit.detection import NO_LAG, Detection, NotFound
from evqr.fit.measure import measure
from evqr.fit.modules import CodeEstimate, NormalEquations, solve_modules, weight_of
from evqr.fit.refine import complete, refine
from evqr.fit.region import region_around
from evqr.launched import LAUNCHED
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.search.finder import Found, find_hypotheses
from evqr.search.hypothesis import Layout
from evqr.search.motion_estimate import MotionEstimate, QuietSpells, estimate_motion, find_motion
from evqr.search.passes import search_passes
from evqr.search.screen import batches, screen
from evqr.values import FrozenDict
from evqr.workspace import Workspace


class Solver:
    """Runs the stages on windows of events.

    Parameters
    ----------
    config : ReadConfig
        What to do; default `ReadConfig()`.
    backend : str
        "auto", "warp", "numpy", or a registered name.
    device : str
        "cpu", "cuda:0", ...

    Raises
    ------
    BackendError
        If the backend or the device is not there.
    """

    def __init__(
        self, config: ReadConfig | None = None, *, backend: str = "auto", device: str = "cpu"
    ) -> None:
        self.config = config or ReadConfig()
        self.workspace = Workspace(kernels_on(backend, device), device)
        load(self.workspace.backend, device, LAUNCHED)

    def motion_at(
        self, start_us: int, *, guess: Motion | None = None, quiet: QuietSpells | None = None
    ) -> Asking[MotionEstimate | NotFound]:
        """Estimate the motion at a time of a stream.

        It asks for the windows that it takes (`EventBuffer.answer` runs it where all events are there).

        Parameters
        ----------
        start_us : int [us]
            Where its windows begin.
        guess : Motion
            From an earlier window, for its speed; None: from cold.
        quiet : QuietSpells
            Of earlier searches in the same stream: long windows that would show the same again are left out.
            None: none are.

        Returns
        -------
        found : MotionEstimate or NotFound
            With its timings.
        """
        clock = StageClock()
        asking = find_motion(start_us, self.config.motion, workspace=self.workspace, guess=guess, quiet=quiet)
        found = yield from clock.pausing("motion", asking)
        return _timed(found, clock)

    def motion_in(self, window: Window) -> MotionEstimate | NotFound:
        """Estimate the motion from one window's events alone.

        Parameters
        ----------
        window : Window
            As long as about three pixels of travel take.

        Returns
        -------
        found : MotionEstimate or NotFound
            At the middle of the window, with its timings.
        """
        clock = StageClock()
        with clock("motion"):
            found = estimate_motion(window, self.config.motion, workspace=self.workspace)
        return _timed(found, clock)

    def window_us(self, motion: Motion) -> int:
        """Give the length of windows for a motion.

        Parameters
        ----------
        motion : Motion
            Of the code.

        Returns
        -------
        length : int [us]
            Fixed, or as the travel in a window asks for.
        """
        cfg = self.config
        return cfg.window_us or motion.window_us(cfg.travel_px, longest_us=cfg.motion.longest_us)

    def find(
        self,
        window: Window,
        motion: Motion,
        *,
        tau_us: tuple[float, float] | None = None,
        thorough: bool = True,
    ) -> Detection | NotFound:
        """Find a code in a window from cold.

        Parameters
        ----------
        window : Window
            Where to search.
        motion : Motion
            Of the code; it is taken to hold at the middle of the window.
        tau_us : (float, float) [us]
            Time constants of the pixels, known from earlier windows; None: estimated, if not configured.
        thorough : bool
            False: the motion is sure, and the last of the configured passes, which takes most of the time,
            is left out.

        Returns
        -------
        found : Detection or NotFound
            At the middle of the window, with its timings.
        """
        clock, finder = StageClock(), self.config.finder
        tau_us = self.config.lag_us or tau_us
        best: Detection | NotFound = NotFound(Reason.NOTHING_MOVES)
        for heading, search_pass in search_passes(window, motion, finder, thorough=thorough):
            with clock("finder"):
                found = find_hypotheses(
                    window, heading, finder, workspace=self.workspace, search_pass=search_pass,
                    lag_px=NO_LAG if tau_us == NO_LAG else None,
                )  # fmt: skip
            for layout in Layout:
                if isinstance(best, Detection) and best.score >= self.config.align.good_score:
                    break
                tried = self._find(window, heading, found, layout, search_pass, tau_us, clock)
                best = max(tried, best, key=_closeness)
            if isinstance(best, Detection) and best.score >= self.config.align.good_score:
                break
        return replace(best, timings_ms=clock.ms)

    def _find(
        self,
        window: Window,
        motion: Motion,
        found: Found,
        layout: Layout,
        search_pass: SearchPass,
        tau_us: tuple[float, float] | None,
        clock: StageClock,
    ) -> Detection | NotFound:
        """Find a code of one layout in what a search along one motion found."""
        cfg, one, workspace = self.config, self.config.align, self.workspace
        alone = EventBatch.of([window])
        hypotheses = found.hypotheses(layout)
        if not hypotheses:
            return NotFound(Reason.NO_FINDER_PATTERNS, f"{len(found.peaks)} candidates")
        best: Detection | None = None
        closest, iterations = 0.0, 0
        for batch in batches(hypotheses, cfg.finder.first_hypotheses):
            with clock("pose"):
                candidates, steps = screen(batch, found.pyramid, one, workspace=workspace)
            candidates = [candidate for candidate in candidates if candidate.score >= search_pass.min_score]
            if not candidates:
                continue
            chosen = candidates[: one.refined_candidates]
            with clock("stage_one"):
                (refined,) = refine(alone, [motion], [chosen], [tau_us], cfg, workspace=workspace)
            iterations += steps + refined.iterations
            closest = max(closest, refined.score)
            if refined.score < one.min_score:
                continue
            refined = replace(refined, iterations=iterations)
            (detection,) = complete(alone, [refined], [tau_us], cfg, workspace=workspace, clock=clock)
            if layout is Layout.SINGLE and detection.score < one.single_score:
                closest = max(closest, detection.score)
                continue
            if best is None or detection.score > best.score:
                best = detection
            if best.score >= one.good_score:
                break
        detail = f"{closest:.2f}, the best of {len(hypotheses)} candidates"
        return best or NotFound(Reason.DISAGREES, detail, closest)

    def follow(self, batch: EventBatch, detections: Sequence[Detection]) -> list[Detection | NotFound]:
        """Find codes again that earlier windows showed.

        Parameters
        ----------
        batch : EventBatch
            B later windows, of one stream or of many; where one shows several codes, it is there several
            times.
        detections : sequence of Detection
            Of the code in each; its motion is taken to hold until the middle of the window.

        Returns
        -------
        found : list of Detection or NotFound
            One a window, at its middle, with its share of the timings.  It does not depend on the others.
        """
        if not detections:
            return []
        clock, one = StageClock(), self.config.align
        with clock("stage_one"):
            targets = [
                detection.at(window.middle_us)
                for window, detection in zip(batch.windows, detections, strict=True)
            ]
            regions = [region_around(target.pose, target.space, one) for target in targets]
            measured = measure(batch, targets, regions, self.config, workspace=self.workspace)
        timings_ms = FrozenDict({stage: ms / len(targets) for stage, ms in clock.ms.items()})
        found: list[Detection | NotFound] = []
        for k, score in enumerate(measured.alignment.score.tolist()):
            if score < one.min_score:
                detail = f"{score:.2f}, where the code should be"
                found.append(NotFound(Reason.DISAGREES, detail, score, timings_ms))
            else:
                found.append(measured.detection(k, targets[k], regions[k], timings_ms=timings_ms))
        return found

    def solve(self, found: Sequence[Detection | NormalEquations]) -> list[CodeEstimate]:
        """Solve for the modules of codes, each from one window or from equations that were added up.

        Parameters
        ----------
        found : sequence of Detection or NormalEquations
            Codes in their windows; or equations in units of their noise, `NormalEquations.weighted`.

        Returns
        -------
        estimates : list of CodeEstimate
            Of all modules of each.  None depends on the others.
        """
        equations = [each.equations if isinstance(each, Detection) else each for each in found]
        weights = [weight_of(each.noise) if isinstance(each, Detection) else 1.0 for each in found]
        return solve_modules(equations, self.config.modules, workspace=self.workspace, weights=weights)


def _timed(found: MotionEstimate | Reason, clock: StageClock) -> MotionEstimate | NotFound:
    if isinstance(found, Reason):
        return NotFound(found, timings_ms=clock.ms)
    return replace(found, timings_ms=clock.ms)


def _closeness(found: Detection | NotFound) -> tuple[bool, float]:
    """Order what passes have found: a code before none, then by how well it agrees."""
    if isinstance(found, Detection):
        return True, found.score
    return False, found.closest
