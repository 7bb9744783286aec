"""evqr's solver as a row of the table: each window alone, several windows fused, with and without lags."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.events.window import Window
from evqr.fit.detection import Detection, NotFound
from evqr.fit.fusion import Fusion
from evqr.paper.methods.method import Outcome, Watch, cut
from evqr.solver import Solver
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded


class Own:
    """`evqr.Solver`, from cold; neither version nor motion is told.

    Parameters
    ----------
    windows : int
        1: each window alone; more: one after another until the code is read.
    lag : bool
        Whether the pixels' lag is estimated and undone.
    """

    takes: Literal["events"] = "events"
    matched = False

    def __init__(self, *, windows: int = 1, lag: bool = True) -> None:
        self.windows = windows
        self._solver = Solver(ReadConfig(lag_us=None if lag else (0.0, 0.0)))

    def read(self, seen: Window, watch: Watch) -> Outcome:
        """Search for the code in the first window, follow it in the others until their sum decodes."""
        solver = self._solver
        config, workspace = solver.config, solver.workspace
        found: Detection | NotFound | None = None
        fusion = Fusion(config.vote, config.modules, workspace=workspace)
        best, iterations = Outcome(converged=False), 0
        for index in range(self.windows):
            part = seen if self.windows == 1 else cut(seen, self.windows, index)
            if isinstance(found, Detection):
                (found,) = solver.follow(EventBatch.of([part]), [found])
            else:
                found = self._find(part)
            if isinstance(found, NotFound):
                fusion = Fusion(config.vote, config.modules, workspace=workspace)
                continue
            estimate = fusion.add(found.equations, found.noise)
            iterations += estimate.iterations
            watch(iterations, estimate.q, False)
            decoded = decode_grid(estimate.q, found.space, effort="full")
            read = isinstance(decoded, Decoded)
            best = Outcome(
                modules=estimate.q,
                pose=found.pose,
                time_us=found.time_us,
                text=decoded.text if read else None,
                confidence=decoded.confidence if read else None,
            )
            if read:
                return replace(best, windows=index + 1)
        return replace(best, windows=self.windows)

    def _find(self, window: Window) -> Detection | NotFound:
        moving = self._solver.motion_in(window)
        if isinstance(moving, NotFound):
            return moving
        (found,) = self._solver.find(EventBatch.of([window]), [moving.motion])
        return found if isinstance(found, NotFound) else found[0]
