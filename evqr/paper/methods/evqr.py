"""evqr's solver as a row of the table: each window alone, several windows fused, with and without lags."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from evqr.config import ReadConfig
from evqr.events.window import Window
from evqr.fit.fusion import Tally
from evqr.paper.methods.method import Outcome, Watch, cut
from evqr.solver import Sighting, Solver
from evqr.symbol import qr
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded


class Own:
    """`evqr.Solver`, from cold; neither version nor motion is told.

    Parameters
    ----------
    windows   1: each window alone; more: one after another until the code is read
    lag       whether the pixels' lag is estimated and undone
    """

    takes: Literal["events"] = "events"
    matched = False

    def __init__(self, *, windows: int = 1, lag: bool = True) -> None:
        self.windows = windows
        self._solver = Solver(ReadConfig(lag_us=None if lag else (0.0, 0.0)))

    def read(self, seen: Window, watch: Watch) -> Outcome:
        """Look for the code in the first window, follow it in the others until their sum decodes."""
        solver = self._solver
        config, workspace = solver.config, solver.workspace
        sighting: Sighting | None = None
        tally = Tally(config.vote, config.stage_two, workspace=workspace)
        best, iterations = Outcome(converged=False), 0
        for index in range(self.windows):
            part = seen if self.windows == 1 else cut(seen, self.windows, index)
            sighting = self._look(part) if sighting is None else solver.follow(part, sighting)
            if sighting is None:
                tally = Tally(config.vote, config.stage_two, workspace=workspace)
                continue
            estimate = tally.add(sighting.equations, sighting.noise)
            iterations += estimate.iterations
            watch(iterations, estimate.q, False)
            decoded = decode_grid(estimate.q, qr.space(sighting.version), effort="full")
            read = isinstance(decoded, Decoded)
            best = Outcome(
                modules=estimate.q,
                pose=sighting.pose,
                time_us=sighting.time_us,
                text=decoded.text if read else None,
                confidence=decoded.confidence if read else None,
            )
            if read:
                return replace(best, windows=index + 1)
        return replace(best, windows=self.windows)

    def _look(self, window: Window) -> Sighting | None:
        motion = self._solver.motion_in(window)
        if motion is None:
            return None
        found = self._solver.look(window, motion)
        return found if isinstance(found, Sighting) else None
