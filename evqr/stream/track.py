"""One code followed from window to window until it is read, and on until it is gone."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from evqr.events.buffer import EventBuffer
from evqr.fit.fusion import Tally
from evqr.geometry import outline
from evqr.results import CodeReading
from evqr.search.motion_estimate import travel_time_us
from evqr.solver import Sighting, Solver, StageClock
from evqr.symbol import qr
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
    seen              newest sighting
    first_us          start of the first window that showed the code [us]
    last_us           end of the last one [us]
    reading           once it is read
    why_not           why it is not read yet
    """

    def __init__(
        self, sighting: Sighting, start_us: int, end_us: int, solver: Solver, clock: StageClock
    ) -> None:
        cfg = solver.config
        self.seen = sighting
        self.first_us = start_us
        self.last_us = end_us
        self.reading: CodeReading | None = None
        self.why_not = ""
        self.clock = clock
        self._good_score = cfg.stage_one.good_score
        self._misses = 0
        self._tally = Tally(cfg.vote, cfg.stage_two, workspace=solver.workspace)
        self._path = deque([(sighting.time_us, sighting.centre)], maxlen=BASELINE)
        self._decode(solver)

    @property
    def gone(self) -> bool:
        """Whether the code is out of sight, or was none."""
        unread = (
            self.reading is None and self._tally.windows >= PATIENCE and self.seen.score < self._good_score
        )
        return unread or self._misses >= MOST_MISSES

    def next_window(self, solver: Solver) -> tuple[int, int]:
        """Bounds of the next window to follow the code in [us]."""
        speed = float(np.hypot(*self.seen.velocity))
        length = solver.window_us(speed)
        step = length
        if self.reading is not None:
            step = max(length, round(travel_time_us(speed, solver.config.follow_px)))
        elif self._misses:
            step = 2 * length
        middle = self.seen.time_us + step * (1 + self._misses)
        start = round(middle - length / 2)
        return start, start + length

    def follow(self, events: EventBuffer, start_us: int, end_us: int, solver: Solver) -> None:
        """Look for the code in its next window."""
        solver.clock = self.clock if self.reading is None else StageClock()
        window = events.window(start_us, end_us)
        found = None
        if _in_view(self.seen, window.middle_us, window.width, window.height):
            found = solver.follow(window, self.seen)
        if found is None:
            self._misses += 1
            return
        self._misses = 0
        self._path.append((found.time_us, found.centre))
        (t0, c0), (t1, c1) = self._path[0], self._path[-1]
        self.seen = replace(found, velocity=(c1 - c0) / ((t1 - t0) * 1e-6))
        self.last_us = end_us
        if self.reading is None:
            self._decode(solver)

    def _decode(self, solver: Solver) -> None:
        with self.clock("stage_two"):
            estimate = self._tally.add(self.seen.equations, self.seen.noise)
        with self.clock("decode"):
            thorough = self._tally.windows % FULL_EFFORT_EVERY == 0
            outcome = decode_grid(
                estimate.q, qr.space(self.seen.version), effort="full" if thorough else "quick"
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
            windows=self._tally.windows,
            corners_px=outline(seen.pose_at(self.last_us), seen.size),
            motion_px_per_s=seen.velocity,
            confidence=decoded.confidence,
            errors_corrected=decoded.errors_corrected,
            modules=decoded.modules,
            estimate=q.copy(),
            compute_ms=self.clock.total(),
        )


def _in_view(seen: Sighting, time_us: float, width: int, height: int) -> bool:
    """Whether the whole code is in the image at a time."""
    corners = outline(seen.pose_at(time_us), seen.size)
    return bool((corners > -0.5).all() and (corners < (width - 0.5, height - 0.5)).all())
