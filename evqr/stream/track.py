"""One code followed from window to window until it is read, and on until it is lost."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from evqr.clock import StageClock
from evqr.events.window import Window
from evqr.fit.certainty import dark, unclear
from evqr.fit.detection import Detection, NotFound
from evqr.fit.fusion import Fusion, Solving
from evqr.fit.modules import CodeEstimate, NormalEquations
from evqr.fit.outside import inside
from evqr.geometry import bounds, module_px
from evqr.grade import grade_reading
from evqr.motion import Motion
from evqr.results import CodeReading
from evqr.solver import Solver
from evqr.stream.records import CodeUnread
from evqr.symbol.decoded import Decoded, DecodeFailure
from evqr.symbol.space import Landmark
from evqr.symbology import BY_THREE_PATTERNS
from evqr.work import Decode, Find, FindTurning, Follow, Solve, Working, decoded

T = TypeVar("T")

GRIDS = 4
"""Grids that a window may be decoded from once there are several: the sum of all, that of those that agree,
its own, and that of the code found again."""

SAME_CENTRE = 0.25
"""How far from its centre a code that is followed may be found again, in its sizes."""

SCORES_ALIKE = 0.02
"""A code that was found again is taken though it agrees less well by so much: its pose may be right all the
same."""

FEW = 8
"""Windows after each of which decoding is tried; later once there are an eighth more."""

AROUND = 0.5
"""How far around it is searched for it beyond its quiet zone, in its sizes: it may be a larger one."""

BETTER = 0.05
"""A code that was found again and agrees better by so much was not right before: its windows do not count."""


class Track:
    """A code that is being followed.

    Parameters
    ----------
    detection : Detection
        The code as it was found.
    window : Window
        Where it was.
    solver : Solver
        What follows it.

    Attributes
    ----------
    detection : Detection
        The newest one.
    first_us, last_us : int [us]
        Start of the first window that showed the code, and end of the last one.
    windows : int
        Windows that were used to read it.
    reading : CodeReading, optional
        Once it is read.
    failure : DecodeFailure, optional
        Why the newest attempt to decode it failed.
    code : int, optional
        Its number in the stream, once it is read; the scheduler gives it.
    """

    def __init__(self, detection: Detection, window: Window, solver: Solver) -> None:
        cfg = solver.config
        self.detection = detection
        self.first_us = window.start_us
        self.last_us = window.end_us
        self.reading: CodeReading | None = None
        self.failure: DecodeFailure | None = None
        self.code: int | None = None
        self._solver = solver
        self._cfg = cfg.track
        self._misses = 0
        self._scores = 0.0
        self._fusion = self._new_fusion()
        self.windows = 0
        self._tries = 1
        self._attempts = self._attempted = 0
        self._path = deque([(detection.time_us, detection.centre)], maxlen=cfg.track.baseline)
        self._clock = StageClock()
        self._clock.add(detection.timings_ms)

    def begin(self) -> Working[None]:
        """Decode the window in which it was found."""
        yield from self._decode()

    def _new_fusion(self) -> Fusion:
        cfg = self._solver.config
        return Fusion(cfg.vote, cfg.modules, workspace=self._solver.workspace)

    @property
    def timings_ms(self) -> Mapping[str, float]:
        """What it took so far, by stage [ms]."""
        return self._clock.ms

    @property
    def unread(self) -> CodeUnread:
        """What is known of it while it is not read."""
        assert self.failure is not None
        found = self.detection
        travel_px = found.motion.travel_px(self._solver.window_us(found.motion))
        moved = max(travel_px / module_px(found.pose, found.space.shape), 1e-9)
        return CodeUnread(
            self.first_us,
            self.last_us,
            self.windows,
            found.score,
            self.failure,
            found.target,
            mean_score=self._scores / self.windows,
            clear_modules=1.0 - unclear(self._q, found.space),
            events_an_edge=float(np.hypot(*found.gain)) / moved,
        )

    @property
    def _length_us(self) -> int:
        """Length of the newest window [us]."""
        return self._solver.window_us(self.detection.motion)

    @property
    def lost(self) -> bool:
        """Whether the code is out of sight, or was none."""
        cfg, space = self._cfg, self.detection.space
        if self._misses >= cfg.max_misses or self.given_up:
            return True
        # straight edges, and one pattern, are soon found by chance
        by_chance = space.single_pattern or space.anchors[0].kind is Landmark.SOLID_CORNER
        return by_chance and self._in_vain(cfg.single_patience)

    @property
    def given_up(self) -> bool:
        """Whether it was there all the time, and cannot be read."""
        cfg = self._cfg
        return self._in_vain(cfg.patience) or (self.reading is None and self._tries >= cfg.good_patience)

    def _in_vain(self, patience: int) -> bool:
        """Whether it agrees badly after so many windows without a reading."""
        bad = self.detection.score < self._solver.config.align.good_score
        return bad and self.reading is None and self._tries >= patience

    def next_window(self) -> tuple[int, int]:
        """Give the bounds of the next window [us]; it begins after the middle of the last that showed it."""
        motion = self.detection.motion
        length = self._solver.window_us(motion)
        if self.reading is not None:
            step = max(length, round(motion.travel_time_us(self._solver.config.follow_px)))
        else:
            step = 2 * length if self._misses else length
        middle = self.detection.time_us + step * (1 + self._misses)
        start = round(middle - length / 2)
        return start, start + length

    def follow(self, window: Window) -> Working[Track]:
        """Look for the code in its next window.

        Parameters
        ----------
        window : Window
            With the bounds of `next_window`.

        Returns
        -------
        track : Track
            As it is then.  This one stays as it is, for those who ask about an earlier time, and is not
            followed any more.
        """
        track = object.__new__(type(self))
        vars(track).update(vars(self))
        yield from track._go_on(window)
        return track

    def _go_on(self, window: Window) -> Working[None]:
        if not _in_view(self.detection, window):
            self._misses += 1
            return
        (found,) = yield [Follow(window, self.detection, self._before)]
        self._clock.add(found.timings_ms)
        if isinstance(found, NotFound):
            self._misses += 1
            return
        self._misses = 0
        self._path.append((found.time_us, found.centre))
        (t0, c0), (t1, c1) = self._path[0], self._path[-1]
        if found.motion.uniform:
            found = found.moving(Motion((c1 - c0) / ((t1 - t0) * 1e-6), found.time_us))
        self.detection = found
        self.last_us = window.end_us
        if self.reading is None:
            self._tries += 1
            yield from self._decode()
        if self.reading is None and self._tries in self._due:
            yield from self._find_again(window)

    @property
    def _before(self) -> NormalEquations | None:
        """What earlier windows say, for as long as it is not read."""
        if self.reading is not None:
            return None
        before = self._fusion.before or NormalEquations.nothing(self.detection.space)
        return None if before.varies else before  # what turns is added up here

    @property
    def _due(self) -> tuple[int, ...]:
        """Windows after which it is searched for again."""
        return self._cfg.good_found_again if self._agrees_well else self._cfg.found_again

    @property
    def _agrees_well(self) -> bool:
        """Whether it agrees so well with its known modules that it is worth while to try hard.

        Only three finder patterns say so much: straight edges, or one pattern, are soon found by chance.
        """
        return self._is_by_three and self.detection.score >= self._solver.config.align.good_score

    @property
    def _is_by_three(self) -> bool:
        """Whether it was found by three finder patterns."""
        return len(self.detection.space.anchors) > 1

    def _decode(self) -> Working[None]:
        """Add the newest window, and decode the sum of all; else what agrees with it, and it alone."""
        found = self.detection
        adding = self._fusion.adding(found.equations, found.noise, found.fused)
        estimate = yield from self._solved(adding)
        self.windows = self._fusion.windows
        alone = self.windows == 1
        self._scores = self.detection.score + (0.0 if alone else self._scores)
        self._q = estimate.q
        if self._tries > FEW and FEW * (self._tries - self._attempted) < self._attempted:
            return  # a sum says hardly more than one of nearly as many windows
        self._attempts, self._attempted = self._attempts + 1, self._tries
        thorough = self._attempts % self._cfg.full_effort_every == 0
        yield from self._try(estimate, self.windows, full=thorough or (alone and self._agrees_well))
        if alone or self.reading is not None or self.detection.space.single_pattern:
            return
        others = yield from self._solved(self._fusion.grouping())
        for estimate, windows in others:
            if self.reading is None:
                yield from self._try(estimate, windows, full=windows == 1 and self._agrees_well)

    def _solved(self, solving: Solving[T]) -> Working[T]:
        """Have the equations solved that are asked for."""
        try:
            equations = next(solving)
            while True:
                equations = solving.send((yield [Solve(each, self._clock) for each in equations]))
        except StopIteration as end:
            return end.value

    def _try(self, estimate: CodeEstimate, windows: int, *, full: bool) -> Working[None]:
        """Decode what some windows say."""
        space = self.detection.space
        grids = 1 if self._tries == 1 or space.single_pattern else GRIDS
        config = self._solver.config.decode.among(grids)
        decode = Decode(estimate.q, space, config, "full" if full else "quick", self._clock)
        (outcome,) = yield from decoded([decode])
        if isinstance(outcome, Decoded):
            self.reading = self._reading(outcome, estimate, windows)
        elif self.failure is None or windows == self.windows:
            self.failure = outcome

    def _find_again(self, window: Window) -> Working[None]:
        """Search for the code from cold: what went wrong stays wrong while the code is followed.

        A code that turns was hardly found with a motion that is the same everywhere.
        """
        if not self.detection.motion.uniform:
            return
        (turning,) = yield [FindTurning(window, self.detection.motion, (self.detection,))]
        if turning:
            self._clock.add(turning[0].timings_ms)
            if self._is_here(turning[0]):
                self._begin_again(turning[0])
                yield from self._decode()
                return
        target, asked = self.detection.target, self._solver.config.symbologies
        margin = self._solver.config.scheduler.margin_modules + AROUND * target.space.size
        kinds = tuple(kind for kind in asked if not self._is_by_three or kind in BY_THREE_PATTERNS)
        (codes,) = yield [Find(inside(window, target, margin), target.motion, None, kinds)]
        if isinstance(codes, NotFound):
            self._clock.add(codes.timings_ms)
            return
        self._clock.add(codes[0].timings_ms)
        found = min(codes, key=self._apart)
        if found.score < self.detection.score - SCORES_ALIKE or not self._is_here(found):
            return
        better = found.score > self.detection.score + BETTER
        found = found.moving(self.detection.motion)
        if found.space != self.detection.space or better:
            self._begin_again(found)
            yield from self._decode()
            return
        self._moved(found)
        (alone,) = yield [Solve(found, self._clock)]
        yield from self._try(alone, 1, full=True)

    def _apart(self, found: Detection) -> float:
        """How far from here something was found [px]."""
        return float(np.hypot(*(found.centre - self.detection.centre)))

    def _is_here(self, found: Detection) -> bool:
        """Whether what was found may be this code."""
        space = self.detection.space
        return self._apart(found) <= SAME_CENTRE * space.size * module_px(self.detection.pose, space.shape)

    def _moved(self, found: Detection) -> None:
        """Go on from where it was found."""
        self.detection = found
        self._path.clear()
        self._path.append((found.time_us, found.centre))

    def _begin_again(self, found: Detection) -> None:
        """Go on from where it was found, without what earlier windows say."""
        self._moved(found)
        self._fusion, self._attempted = self._new_fusion(), 0

    def _reading(self, decoded: Decoded, estimate: CodeEstimate, windows: int) -> CodeReading:
        return CodeReading(
            **vars(decoded.payload),
            symbology=decoded.symbology.value,
            version=decoded.version,
            ec_level=decoded.ec_level,
            mask=decoded.mask,
            t_first_us=self.first_us,
            t_last_us=self.last_us,
            t_read_us=self.last_us,
            windows=windows,
            corners_px=self.detection.at(self.last_us).outline(),
            motion_px_per_s=self.detection.motion.velocity,
            confidence=decoded.confidence,
            log10_chance=decoded.log10_chance,
            errors_corrected=decoded.errors_corrected,
            unused_correction=decoded.unused_correction,
            grade=grade_reading(self.detection, self._length_us, estimate, decoded),
            modules=decoded.modules,
            estimate=estimate.q,
            dark=dark(estimate.q, decoded.space, estimate.information),
            compute_ms=self._clock.total(),
        )


def _in_view(detection: Detection, window: Window) -> bool:
    """Whether the whole code is in the image in the middle of a window."""
    target = detection.at(window.middle_us)
    left, top, right, bottom = bounds(target.pose, target.space.shape)
    return -0.5 < left and right < window.width - 0.5 and -0.5 < top and bottom < window.height - 0.5
