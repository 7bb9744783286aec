"""One code followed from window to window until it is read, and on until it is gone."""

from __future__ import annotations

from collections import deque

import numpy as np

from evqr.clock import StageClock
from evqr.events.buffer import EventBuffer
from evqr.fit.detection import Detection, NotFound
from evqr.fit.fusion import Fusion
from evqr.motion import Motion
from evqr.results import CodeReading
from evqr.solver import Solver
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded, DecodeFailure

BASELINE = 8
"""Windows over which the velocity is measured: long enough for precision, short enough for a speed that
changes."""

FULL_EFFORT_EVERY = 4
"""Windows between two attempts at decoding with many erasures; the others are quick."""

PATIENCE = 16
"""Windows without a reading after which a code that agrees badly with its known modules is given up."""

MOST_MISSES = 2
"""Windows in a row without the code after which it is gone."""


class Track:
    """A code that is being followed.

    Attributes
    ----------
    seen              newest detection
    first_us          start of the first window that showed the code [us]
    last_us           end of the last one [us]
    reading           once it is read
    why_not           why it is not read yet
    """

    def __init__(
        self, detection: Detection, start_us: int, end_us: int, solver: Solver, clock: StageClock
    ) -> None:
        cfg = solver.config
        self.seen = detection
        self.first_us = start_us
        self.last_us = end_us
        self.reading: CodeReading | None = None
        self.why_not = ""
        self.clock = clock
        self._good_score = cfg.align.good_score
        self._misses = 0
        self._fusion = Fusion(cfg.vote, cfg.modules, workspace=solver.workspace)
        self._path = deque([(detection.time_us, detection.centre)], maxlen=BASELINE)
        self._decode(solver)

    @property
    def gone(self) -> bool:
        """Whether the code is out of sight, or was none."""
        unread = (
            self.reading is None and self._fusion.windows >= PATIENCE and self.seen.score < self._good_score
        )
        return unread or self._misses >= MOST_MISSES

    def next_window(self, solver: Solver) -> tuple[int, int]:
        """Bounds of the next window to follow the code in [us]."""
        motion = self.seen.motion
        length = solver.window_us(motion)
        step = length
        if self.reading is not None:
            step = max(length, round(motion.travel_time_us(solver.config.follow_px)))
        elif self._misses:
            step = 2 * length
        middle = self.seen.time_us + step * (1 + self._misses)
        start = round(middle - length / 2)
        return start, start + length

    def follow(self, events: EventBuffer, start_us: int, end_us: int, solver: Solver) -> None:
        """Look for the code in its next window."""
        window = events.window(start_us, end_us)
        if not _in_view(self.seen, window.middle_us, window.width, window.height):
            self._misses += 1
            return
        found = solver.follow(window, self.seen)
        if self.reading is None:
            self.clock.add(found.timings_ms)
        if isinstance(found, NotFound):
            self._misses += 1
            return
        self._misses = 0
        self._path.append((found.time_us, found.centre))
        (t0, c0), (t1, c1) = self._path[0], self._path[-1]
        self.seen = found.moving(Motion((c1 - c0) / ((t1 - t0) * 1e-6), found.time_us))
        self.last_us = end_us
        if self.reading is None:
            self._decode(solver)

    def _decode(self, solver: Solver) -> None:
        with self.clock("stage_two"):
            estimate = self._fusion.add(self.seen.equations, self.seen.noise)
        with self.clock("decode"):
            thorough = self._fusion.windows % FULL_EFFORT_EVERY == 0
            outcome = decode_grid(
                estimate.q,
                self.seen.space,
                config=solver.config.decode,
                effort="full" if thorough else "quick",
            )
        if isinstance(outcome, DecodeFailure):
            self.why_not = str(outcome)
            return
        self.reading = self._reading(outcome, estimate.q)

    def _reading(self, decoded: Decoded, q: np.ndarray) -> CodeReading:
        seen = self.seen
        return CodeReading(
            text=decoded.text,
            data=decoded.data,
            symbology=decoded.symbology.value,
            version=decoded.version,
            ec_level=decoded.ec_level,
            mask=decoded.mask,
            t_first_us=self.first_us,
            t_last_us=self.last_us,
            t_read_us=self.last_us,
            windows=self._fusion.windows,
            corners_px=seen.at(self.last_us).outline(),
            motion_px_per_s=seen.motion.velocity,
            confidence=decoded.confidence,
            errors_corrected=decoded.errors_corrected,
            modules=decoded.modules,
            estimate=q.copy(),
            compute_ms=self.clock.total(),
        )


def _in_view(seen: Detection, time_us: float, width: int, height: int) -> bool:
    """Whether the whole code is in the image at a time."""
    corners = seen.at(time_us).outline()
    return bool((corners > -0.5).all() and (corners < (width - 0.5, height - 0.5)).all())
