"""Codes whose poses are nearly known: from windows' events to poses, equations and modules in one sequence.

This is what following codes costs, and the last step of finding them.  The device does all of it without the
host, for all windows side by side: events to cells, cells to images, stage one at its finest level, and with
the poses and gains that it ends with stage two's right-hand sides.  Where codes are followed these are added
to what earlier windows say, and the sums solved; windows that agree too little are left out of that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.fit.align import Align, Alignment, Beyond, fine_levels
from evqr.fit.detection import NO_TIMINGS, Detection
from evqr.fit.image import Cells, Deposit, Sharpen, cells_for
from evqr.fit.modules import Equations, Fused, NormalEquations, Solution
from evqr.fit.region import Regions, in_cells, in_px
from evqr.fit.tables import Codes, ModuleTables, PoseTables
from evqr.fit.targets import Targets
from evqr.symbol.space import closed
from evqr.workspace import EventRoom, Step, Workspace


@dataclass(frozen=True, eq=False)
class Measurements:
    """What windows say of a code each, on a region of theirs.

    Attributes
    ----------
    alignment : Alignment
        Poses in cells of the regions, gains, scores and noises.
    equations : list of NormalEquations
        Of the modules, for these poses and gains.
    fused : list of Fused or None
        What they say with earlier windows; None where that was not asked, or they agree too little.
    """

    alignment: Alignment
    equations: list[NormalEquations]
    fused: list[Fused | None]

    def detections(
        self,
        targets: Targets,
        regions: Regions,
        iterations: Sequence[int] | None = None,
        timings_ms: Mapping[str, float] = NO_TIMINGS,
    ) -> list[Detection]:
        """Give what the windows say in px of the sensor, after so many iterations before."""
        found = self.alignment
        gain, steps = closed(found.gain), found.iterations
        if iterations is not None:
            steps = steps + np.array(iterations)
        numbers = found.score.tolist(), found.noise.tolist(), steps.tolist()
        seen = targets.seen(closed(in_px(regions, found.pose)))
        return [
            Detection.trusted(
                target=target, gain=gain[k], score=score, noise=noise, equations=equations, iterations=taken,
                timings_ms=timings_ms, fused=fused,
            )
            for k, (target, equations, fused, score, noise, taken) in enumerate(
                zip(seen, self.equations, self.fused, *numbers, strict=True)
            )
        ]  # fmt: skip


class Measure(Step):
    """The sequence for windows on regions of some size, from events, or from the cells there are.

    ``beyond`` has the tables for codes with a single finder pattern where there are some; modules are solved
    for where that is asked.
    """

    def __init__(
        self, events: EventRoom | None, cells: Cells, poses: PoseTables, beyond: PoseTables | None,
        modules: ModuleTables, room: tuple[int, int], cfg: ReadConfig, workspace: Workspace, *, solved: bool,
    ) -> None:  # fmt: skip
        super().__init__(workspace, events=events)
        one, count, staging = cfg.align, cells.device.shape[0], self._staging
        self._least_score = one.min_score
        self._deposit = None if events is None else Deposit(events, cells, workspace, staging)
        self.sharpen = Sharpen(cells, one.blur_cells, workspace, staging)
        self.images = self.sharpen.images
        self.align = Align(self.images, count, [poses], one.max_iterations, workspace, staging)
        self._beyond = None
        if beyond is not None:
            self._beyond = Beyond(self.images, self.align, beyond, workspace, staging)
        self.equations = Equations(
            self.images, self.align, modules, room, one.sigma, cfg.modules, workspace, staging
        )
        self._solution = None
        if solved:
            self._solution = Solution(count, modules, room, cfg.modules, workspace, self.equations, staging)

    def write(
        self, batch: EventBatch, targets: Targets, regions: Regions, numbers: Sequence[int],
        before: Sequence[NormalEquations | None],
    ) -> None:  # fmt: skip
        """Say what is looked for, where the regions lie, and what earlier windows say."""
        if self._deposit is not None:
            self._deposit.write(batch, targets.motions, regions)
        self.sharpen.write(targets.motions, regions, targets.lag_px)
        self._spaces, self._before = targets.spaces, before
        which = np.arange(len(targets), dtype=np.int32)
        self.align.write(in_cells(regions, targets.pose), which, numbers)
        if self._beyond is not None:
            self._beyond.write(targets.single, numbers)
        if self._solution is not None:
            least = [self._least_score] * len(targets)
            for k in targets.single:  # the score alone does not tell
                least[k] = -np.inf
            self._solution.write(before, numbers, least=least)

    def launch(self) -> None:
        """Launch the kernels one by one."""
        for step in (
            self._deposit, self.sharpen, self.align, self._beyond, self.equations, self._solution
        ):  # fmt: skip
            if step is not None:
                step.launch()

    def read(self) -> Measurements:
        """Wait for the device and give what came out."""
        found, spaces = self.align.read(), self._spaces
        equations = self.equations.read(found.gain, spaces)
        fused: list[Fused | None] = [None] * len(spaces)
        if self._beyond is not None:
            found = self._beyond.judged(found)
        if self._solution is not None:
            enough = (found.score >= self._least_score).tolist()
            for k, each in enumerate(self._solution.fused(spaces)):
                if enough[k] and self._before[k] is not None:
                    fused[k] = each
        return Measurements(found, equations, fused)


def measuring(
    batch: EventBatch,
    targets: Targets,
    regions: Regions,
    cfg: ReadConfig,
    *,
    workspace: Workspace,
    before: Sequence[NormalEquations | None] = (),
) -> Measure:
    """Make ready to measure a code in each of some windows: over the last measurement on as large regions.

    Parameters
    ----------
    batch : EventBatch
        What is measured.
    targets : Targets
        What is looked for in each, at the middle of the window.
    regions : Regions
        Around them.
    cfg : ReadConfig
        Settings.
    workspace : Workspace
        Buffers.
    before : sequence of NormalEquations or None
        What earlier windows say of each code, in units of their noise, with which it is solved for; None:
        that is not asked.  Default: of none.

    Returns
    -------
    step : Measure
        To be run and read, before it is made ready for other windows.
    """
    events, cells = workspace.events(batch), cells_for(regions, workspace=workspace)
    from_events = cells.take(batch, targets.motions, regions)
    codes, (level,) = Codes.of(workspace), fine_levels(cfg.align)
    numbers = codes.numbers(targets.spaces)
    poses, modules = codes.poses(level, cfg.align, numbers), codes.modules(cfg.modules, numbers)
    beyond = None
    if targets.single:
        level = replace(level, beyond_patterns=True)
        beyond = codes.poses(level, cfg.align, [numbers[k] for k in targets.single])
    room, solved = codes.room(numbers), any(each is not None for each in before)
    tables = poses.version, beyond and beyond.version, modules.version
    step = cells.once(
        ("measure", from_events and events.size, room, *tables, solved, cfg.align, cfg.modules),
        lambda: Measure(
            events if from_events else None, cells, poses, beyond, modules, room, cfg, workspace,
            solved=solved,
        ),
    )  # fmt: skip
    step.write(batch, targets, regions, numbers, before or [None] * len(targets))
    return step


def measure(
    batch: EventBatch,
    targets: Targets,
    regions: Regions,
    cfg: ReadConfig,
    *,
    workspace: Workspace,
    before: Sequence[NormalEquations | None] = (),
) -> Measurements:
    """Refine the poses of codes in windows and build their equations; parameters as of `measuring`."""
    step = measuring(batch, targets, regions, cfg, workspace=workspace, before=before)
    step.run()
    return step.read()
