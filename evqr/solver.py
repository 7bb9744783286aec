"""The stages in order, for one window of events: a code from cold, or one that was seen before.

    window -> motion -> finder patterns -> align (pose, gain) -> lags -> equations -> modules

A `Solver` owns the buffers of one thread; two threads need two solvers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from evqr.clock import StageClock
from evqr.config import ReadConfig
from evqr.device import kernels_on, load
from evqr.events.batch import EventBatch
from evqr.events.buffer import Asking
from evqr.events.window import Window
from evqr.fit.detection import Detection, NotFound
from evqr.fit.measure import measure
from evqr.fit.modules import CodeEstimate, NormalEquations, solve_modules, weight_of
from evqr.fit.targets import Targets
from evqr.fit.turning import fit_turning
from evqr.launched import LAUNCHED
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.search.codes import find_codes
from evqr.search.confirm import are_read
from evqr.search.finder import bytes_for
from evqr.search.headings import headings
from evqr.search.motion_estimate import (
    MotionEstimate,
    QuietSpells,
    estimate_motions,
    find_motion,
)
from evqr.search.quarters import turns
from evqr.search.searched import apart
from evqr.search.smaller import smaller
from evqr.symbology import Symbology
from evqr.values import FrozenDict
from evqr.workspace import Workspace

TURNS = 0.6, -0.6
"""Directions in which a window is searched where its parts move in several, against that of most [rad]."""

MOST_TURNING = 2
"""Codes that are fitted as ones that turn, of each search."""

SURELY_TURNS = 0.95
"""Correlation of such a code with which no other directions are tried.  Measured: 0.95 to 0.99, and 0.92 for
one that is a module off."""


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
    TypeError
        The configuration is none.
    """

    def __init__(
        self, config: ReadConfig | None = None, *, backend: str = "auto", device: str = "cpu"
    ) -> None:
        self.config = ReadConfig.of(config)
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
        return timed(found, clock)

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
        return self.motions([window])[0]

    def motions(
        self, windows: Sequence[Window], *, reduction: int | None = None, thorough: bool = True
    ) -> list[MotionEstimate | NotFound]:
        """Estimate the motion of windows, each from its events alone.

        Parameters
        ----------
        windows : sequence of Window
            Of one stream or of many.
        reduction : int [px]
            Binning, where the lengths of the windows were chosen to tell the speed; None: they were given.
        thorough : bool
            Whether to look for larger displacements even where the halves of a window do not agree clearly.

        Returns
        -------
        found : list of MotionEstimate or NotFound
            At the middle of each window, with its share of the timings.  None depends on the others.
        """
        clock, cfg = StageClock(), self.config.motion
        with clock("motion"):
            if reduction is None:
                # less than a pixel is told by more of the peak
                cfg = replace(cfg, blur_px=2.0 * cfg.blur_px)
            found = estimate_motions(
                windows, cfg, workspace=self.workspace, reduction=reduction or 1, thorough=thorough
            )
        shares = StageClock()
        shares.add({stage: ms / len(windows) for stage, ms in clock.ms.items()})
        return [timed(one, shares) for one in found]

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
        batch: EventBatch,
        motions: Sequence[Motion],
        *,
        tau_us: Sequence[tuple[float, float] | None] | None = None,
        symbologies: tuple[Symbology, ...] | None = None,
        thorough: bool = True,
    ) -> list[tuple[Detection, ...] | NotFound]:
        """Find all codes of windows from cold.

        Parameters
        ----------
        batch : EventBatch
            B windows, of one stream or of many.
        motions : sequence of Motion
            Of the codes in each; it is taken to hold at the middle of the window.
        tau_us : sequence of (float, float) or None [us]
            Time constants of the pixels, a window, known from earlier ones; None: estimated, if not
            configured.
        symbologies : tuple of Symbology, optional
            Kinds that are searched for; None: those configured.
        thorough : bool
            Whether tilted codes, those with a hidden finder pattern and smaller modules are searched for
            where nothing is found; where what is found is not sure they are in any case.

        Returns
        -------
        found : list of tuple of Detection, or NotFound
            For each window its codes, best first, or why there is none; with the window's share of the
            timings, the first of its codes all of it.  It does not depend on the other windows.
        """
        cfg, clock = self.config, StageClock()
        if symbologies is not None and symbologies != cfg.symbologies:
            cfg = replace(cfg, symbologies=symbologies)
        known = [cfg.lag_us or tau for tau in tau_us or [None] * len(batch)]
        tried = [headings(*each, cfg.finder) for each in zip(batch.windows, motions, strict=True)]
        best: list[tuple[Detection, ...] | NotFound] = [NotFound(Reason.NOTHING_MOVES)] * len(batch)
        together = self.workspace.windows_at_once(bytes_for(batch.windows, cfg.finder)) if tried else 1
        for turn in range(max(map(len, tried), default=0)):
            open_ = [k for k, each in enumerate(tried) if turn < len(each) and not _sure(best[k], cfg)]
            for first in range(0, len(open_), together):
                rows = open_[first : first + together]
                found = find_codes(
                    batch.pick(rows), [tried[k][turn] for k in rows], [known[k] for k in rows], cfg,
                    workspace=self.workspace, clock=clock, thorough=thorough,
                )  # fmt: skip
                for k, one in zip(rows, found, strict=True):
                    best[k] = max(one, best[k], key=_closeness)
        self._find_smaller(batch, tried, known, best, cfg, clock, thorough=thorough)
        timings_ms = FrozenDict({stage: ms / len(batch) for stage, ms in clock.ms.items()})
        return [
            one.altered(timings_ms=timings_ms)
            if isinstance(one, NotFound)
            else (one[0].altered(timings_ms=timings_ms), *one[1:])
            for one in best
        ]

    def _find_smaller(
        self,
        batch: EventBatch,
        tried: Sequence[Sequence[Motion]],
        known: Sequence[tuple[float, float] | None],
        best: list[tuple[Detection, ...] | NotFound],
        cfg: ReadConfig,
        clock: StageClock,
        *,
        thorough: bool,
    ) -> None:
        """Search for smaller modules where there is no code, or none that is sure or can be read."""
        below = smaller(cfg)
        if below is None:
            return
        open_ = []
        for k, found in enumerate(best):
            if isinstance(found, NotFound):
                if thorough and tried[k]:
                    open_.append(k)
            elif _sure(found, cfg) and len(found[0].space.anchors) > 1:
                continue  # a single pattern is soon found in noise
            elif not any(are_read(found, cfg, self.workspace, clock)):
                open_.append(k)
        together = self.workspace.windows_at_once(bytes_for(batch.windows, below.finder)) if open_ else 1
        for first in range(0, len(open_), together):
            rows = open_[first : first + together]
            found = find_codes(
                batch.pick(rows), [tried[k][0] for k in rows], [known[k] for k in rows], below,
                workspace=self.workspace, clock=clock, thorough=False,
            )  # fmt: skip
            for k, one in zip(rows, found, strict=True):
                if isinstance(best[k], NotFound) or _sure(one, cfg):
                    best[k] = max(one, best[k], key=_closeness)

    def follow(
        self,
        batch: EventBatch,
        detections: Sequence[Detection],
        before: Sequence[NormalEquations | None] = (),
    ) -> list[Detection | NotFound]:
        """Find codes again that earlier windows showed.

        Parameters
        ----------
        batch : EventBatch
            B later windows, of one stream or of many; where one shows several codes, it is there several
            times.
        detections : sequence of Detection
            Of the code in each; its motion is taken to hold until the middle of the window.
        before : sequence of NormalEquations or None
            What earlier windows say of each, in units of their noise: its modules are solved for with what
            the window adds to that, as `Detection.fused`.  `NormalEquations.nothing` of the first window;
            None of a code whose modules are not asked.  Default: of none.

        Returns
        -------
        found : list of Detection or NotFound
            One a window, at its middle, with its share of the timings.  It does not depend on the others.
        """
        if not all(detection.motion.uniform for detection in detections):
            return [
                self.follow(batch.pick([k]), [each], before[k : k + 1])[0]
                if each.motion.uniform
                else self._follow_turning(batch.windows[k], each)
                for k, each in enumerate(detections)
            ]
        if not detections:
            return []
        clock, one = StageClock(), self.config.align
        with clock("stage_one"):
            times_us = [window.middle_us for window in batch.windows]
            targets = Targets([detection.target for detection in detections], times_us)
            regions = targets.regions(one)
            measured = measure(
                batch, targets, regions, self.config, workspace=self.workspace, before=before
            )  # fmt: skip
        timings_ms = FrozenDict({stage: ms / len(targets) for stage, ms in clock.ms.items()})
        found: list[Detection | NotFound] = []
        for detection in measured.detections(targets, regions, timings_ms=timings_ms):
            if detection.score < one.min_score:
                detail = f"{detection.score:.2f}, where the code should be"
                found.append(
                    NotFound(Reason.DISAGREES, detail, detection.score, detection.target, timings_ms)
                )
            else:
                found.append(detection)
        return found

    def _follow_turning(self, window: Window, detection: Detection) -> Detection | NotFound:
        """Find a code that turns again."""
        clock = StageClock()
        with clock("stage_one"):
            found = fit_turning(window, detection.target, self.config, lags=False)
        if found is None or found.score < self.config.align.min_score:
            closest = 0.0 if found is None else found.score
            return NotFound(
                Reason.DISAGREES, f"{closest:.2f}, where the code should be", closest, detection.target,
                clock.ms,
            )  # fmt: skip
        return found.altered(timings_ms=FrozenDict(clock.ms))

    def find_turning(
        self, window: Window, motion: Motion, found: Sequence[Detection] = ()
    ) -> tuple[Detection, ...]:
        """Find codes of a window that turn, where none was found or can be read as if it did not.

        Parameters
        ----------
        window : Window
            Of a stream.
        motion : Motion
            Of most of what moves in it.
        found : sequence of Detection
            What was found, and not read.

        Returns
        -------
        codes : tuple of Detection
            Those that turn, best first, with motions of 6 parameters; none where all of the window moves in
            one direction.  The first has the timings.
        """
        clock, cfg, codes = StageClock(), self.config, []
        with clock("motion"):
            if not turns(window, cfg.motion, workspace=self.workspace):
                return ()
        for angle in (0.0, *TURNS):
            if angle:
                (more,) = self.find(EventBatch.of([window]), [motion.turned(angle)], thorough=False)
                clock.add(more.timings_ms if isinstance(more, NotFound) else more[0].timings_ms)
                found = () if isinstance(more, NotFound) else more
            with clock("stage_one"):
                fits = (fit_turning(window, each.target, cfg) for each in found[:MOST_TURNING])
                codes += [fit for fit in fits if fit is not None and fit.score >= cfg.align.good_score]
            if any(code.score >= SURELY_TURNS for code in codes):
                break
        best = apart(codes)
        return best and (best[0].altered(timings_ms=FrozenDict(clock.ms)), *best[1:])

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


def timed(found: MotionEstimate | Reason, clock: StageClock) -> MotionEstimate | NotFound:
    """Give what was found with what it took, by stage."""
    if isinstance(found, Reason):
        return NotFound(found, timings_ms=clock.ms)
    return replace(found, timings_ms=clock.ms)


def _sure(found: tuple[Detection, ...] | NotFound, cfg: ReadConfig) -> bool:
    """Whether there is a code that agrees well."""
    return not isinstance(found, NotFound) and found[0].score >= cfg.align.good_score


def _closeness(found: tuple[Detection, ...] | NotFound) -> tuple[bool, float]:
    """Order what searches have found: codes before none, then by how well the best agrees."""
    if isinstance(found, NotFound):
        return False, found.closest
    return True, found[0].score
