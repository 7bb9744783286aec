"""What moves in a stream at a time: asked of short windows first, and in events that are here.

Long windows are needed for what is slow, but things may pass one behind the other in them, which then look
like one that hardly moves.  Where the busiest moment of a long window shows clearly faster motion, that of
the window is none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from evqr.events.buffer import EventBuffer
from evqr.events.window import Window
from evqr.fit.detection import NotFound
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.search.motion_estimate import LEAST_TRAVEL_PX, MotionEstimate, Probe, QuietSpells
from evqr.search.noise import NoiseCounts
from evqr.solver import Solver
from evqr.work import Activity, Estimate, moving_at

CLEARLY_FASTER = 2.0
"""What moves so many times as fast as something else is something else."""

NOTHING_MOVES = NotFound(Reason.NOTHING_MOVES)
"""What a motion is where events are noise, or of several things."""


class Moving:
    """What moves in a stream beside the codes that are followed.

    Parameters
    ----------
    events : EventBuffer
        The stream.
    width, height : int [px]
        Of the sensor.
    solver : Solver
        Whose settings count.
    outside : callable
        Gives a window without the events of codes that are followed; None where none is.

    Attributes
    ----------
    quiet : QuietSpells
        Where windows showed nothing.
    newest_us : int [us]
        Time of the newest search.
    patient : bool
        Whether all windows begin where they are asked for, and are waited for.
    """

    def __init__(
        self, events: EventBuffer, width: int, height: int, solver: Solver,
        outside: Callable[[], Callable[[Window], Window] | None],
    ) -> None:  # fmt: skip
        self._events, self._solver, self._outside = events, solver, outside
        self._cfg = solver.config.motion
        self._noise = NoiseCounts(events, width, height, self._cfg)
        self.quiet = QuietSpells()
        self.newest_us, self.patient = 0, False

    def at(
        self, at_us: int, guess: Motion | None, *, ahead: bool = False
    ) -> Activity[tuple[MotionEstimate | NotFound, int, int]]:
        """Estimate a motion.

        Parameters
        ----------
        at_us : int [us]
            Where the shortest window begins.
        guess : Motion, optional
            From an earlier window.
        ahead : bool
            On another thread: what was seen is neither asked nor kept in mind.

        Returns
        -------
        found : MotionEstimate or NotFound
            With its timings.
        start_us, end_us : int [us]
            The window that told.
        """
        since_us = max(self._events.first_us or 0, self.newest_us - self._cfg.longest_us)
        asking = moving_at(
            at_us, self._solver, guess=guess, quiet=None if ahead else self.quiet,
            since_us=None if self.patient else since_us,
        )  # fmt: skip
        answer: Any = None
        start_us = end_us = at_us
        while True:
            try:
                asked = asking.send(answer)
            except StopIteration as end:
                return end.value, start_us, end_us
            if not isinstance(asked, list):
                answer = yield asked
                start_us, end_us = answer.start_us, answer.end_us
                answer = self._shown(answer)
                continue
            (one,) = asked
            assert isinstance(one, Estimate)
            probe = None if ahead else one.probe
            if probe is not None and self._is_noise(probe):
                answer = [NOTHING_MOVES]
                continue
            answer = yield asked
            if probe is not None and (yield from self._are_several(probe, answer[0])):
                answer = [NOTHING_MOVES]

    def faster(self, motion: Motion, from_us: int, due_us: int, step_us: int) -> Activity[int]:
        """Look again and again whether something comes that is clearly faster than what is slow.

        Parameters
        ----------
        motion : Motion
            What was seen.
        from_us, due_us : int [us]
            When, and until when.
        step_us : int [us]
            Time between two looks.

        Returns
        -------
        time_us : int [us]
            When it came; ``due_us`` where nothing did.
        """
        if motion.travel_px(self._cfg.probe_us) >= LEAST_TRAVEL_PX:
            return due_us  # the shortest windows showed it: something else would not stand out
        for at_us in range(from_us + step_us, due_us, step_us):
            if self._outside() is not None:
                break  # what is followed is in view
            probe = self._shortest(at_us)
            window = yield probe.start_us, probe.end_us
            if not self._is_noise(probe):
                (found,) = yield [Estimate(window, probe)]
                if self._is_faster(found, motion):
                    return at_us
        return due_us

    def _shortest(self, at_us: int) -> Probe:
        return Probe(at_us, at_us + self._cfg.probe_us, self._cfg.reduction, False)

    def _shown(self, window: Window) -> Window:
        """Give a window without what is followed, and without more events than are looked at."""
        outside = self._outside()
        if outside is None:
            return window
        enough = 2 * self._cfg.most_events
        return outside(window.thinned(max(1, len(window) // enough)))

    def _is_noise(self, probe: Probe) -> bool:
        """Whether a window is known to be noise, and nothing else."""
        coarse = probe.reduction == self._cfg.reduction
        return coarse and self._outside() is None and self._noise.are_noise(probe.start_us, probe.end_us)

    def _are_several(self, probe: Probe, found: MotionEstimate | NotFound) -> Activity[bool]:
        """Whether a long window shows several things that are faster than what it seems to show."""
        length_us = probe.end_us - probe.start_us
        if probe.reduction != self._cfg.reduction or length_us <= self._cfg.probe_us:
            return False
        if isinstance(found, NotFound) or found.motion.travel_px(length_us) < LEAST_TRAVEL_PX:
            return False
        busiest = self._shortest(self._busiest_us(probe))
        window = self._shown(self._events.window(busiest.start_us, busiest.end_us))
        (short,) = yield [Estimate(window, busiest)]
        return self._is_faster(short, found.motion)

    def _busiest_us(self, probe: Probe) -> int:
        """Give when in a window the shortest one has most events."""
        step_us = self._cfg.probe_us
        times = range(probe.start_us, probe.end_us - step_us + 1, step_us)
        places = [self._events.count_before(time_us) for time_us in (*times, times[-1] + step_us)]
        return times[max(range(len(times)), key=lambda k: places[k + 1] - places[k])]

    def _is_faster(self, found: MotionEstimate | NotFound, motion: Motion) -> bool:
        """Whether the shortest window shows something else than what is slow."""
        if isinstance(found, NotFound) or found.motion.travel_px(self._cfg.probe_us) < LEAST_TRAVEL_PX:
            return False
        return found.motion.speed > CLEARLY_FASTER * motion.speed
