"""A code whose pose is nearly known: from a window's events to its pose and equations in one sequence.

This is what following a code costs a window, and the last step of finding one.  The device does all of it
without the host: events to cells, cells to the image, stage one at its finest level, and with the pose and
gain that it ends with stage two's right-hand side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.events.window import Window
from evqr.fit.align import Align, Alignment, fine_levels, judged
from evqr.fit.detection import NO_TIMINGS, Detection, Target
from evqr.fit.image import Deposit, Sharpen, depositing
from evqr.fit.modules import Equations, NormalEquations
from evqr.fit.region import Region
from evqr.geometry import compose
from evqr.symbol.space import CodeSpace
from evqr.workspace import Step, Workspace


@dataclass(frozen=True, eq=False)
class Measurement:
    """What a window says of a code, on a region of it.

    Attributes
    ----------
    alignment : Alignment
        Pose in cells of the region, gain, score and noise.
    equations : NormalEquations
        Of the modules, for that pose and gain.
    """

    alignment: Alignment
    equations: NormalEquations

    def detection(
        self, target: Target, region: Region, iterations: int, timings_ms: Mapping[str, float] = NO_TIMINGS
    ) -> Detection:
        """Give what was measured in px of the sensor, after so many iterations in all."""
        found = self.alignment
        pose = compose(region.to_px, found.pose[0])
        return Detection(
            target=Target(target.space, pose / pose[2, 2], target.motion, target.tau_us),
            gain=found.gain[0],
            score=float(found.score[0]),
            noise=float(found.noise[0]),
            equations=self.equations,
            iterations=iterations,
            timings_ms=timings_ms,
        )


class Measure(Step):
    """The sequence for one size of region; with ``from_events``, or from the cells that are there."""

    def __init__(
        self, deposit: Deposit, from_events: bool, space: CodeSpace, cfg: ReadConfig, workspace: Workspace
    ) -> None:
        super().__init__(workspace.backend)
        one = cfg.align
        self._space, self._cfg, self._workspace = space, one, workspace
        self.sharpen = Sharpen(deposit.cells, 1, one.blur_cells, workspace)
        self.images = self.sharpen.images
        self.align = Align(self.images, 1, space, fine_levels(one), one.max_iterations, one, workspace)
        self.equations = Equations(
            self.images, self.align.pose, self.align.gain, space, one.sigma, cfg.modules, workspace
        )
        self._steps = [*([deposit] if from_events else []), self.sharpen, self.align, self.equations]

    def write(self, target: Target, region: Region) -> None:
        """Say what is looked for and where the region lies."""
        self.sharpen.write(target.motion, region, [target.lag_px])
        self.align.write(compose(region.from_px, target.pose)[None], 0)

    def launch(self) -> None:
        """Launch the kernels one by one."""
        for step in self._steps:
            step.launch()

    def read(self) -> Measurement:
        """Wait for the device and give what came out."""
        (level,) = fine_levels(self._cfg)
        found = self.align.read()
        alignment = judged(self.images, found, self._space, level, self._cfg, workspace=self._workspace)
        return Measurement(alignment, self.equations.read(alignment.gain[0]))


def measuring(
    window: Window,
    target: Target,
    region: Region,
    cfg: ReadConfig,
    *,
    workspace: Workspace,
) -> Measure:
    """Make ready to measure a code in a window: over the last measurement on a region of this size.

    Parameters
    ----------
    window : Window
        What is measured.
    target : Target
        What is looked for, at the middle of the window.
    region : Region
        Around it.
    cfg : ReadConfig
        Settings.
    workspace : Workspace
        Buffers.

    Returns
    -------
    step : Measure
        To be run and read, before it is made ready for another window.
    """
    alone = EventBatch.of([window])
    deposit, from_events = depositing(alone, [target.motion], [region], workspace=workspace)
    step = deposit.once(
        ("measure", from_events, target.space, cfg.align, cfg.modules),
        lambda: Measure(deposit, from_events, target.space, cfg, workspace),
    )
    step.write(target, region)
    return step


def measure(
    window: Window,
    target: Target,
    region: Region,
    cfg: ReadConfig,
    *,
    workspace: Workspace,
) -> Measurement:
    """Refine the pose of a code in a window and build its equations; parameters as of `measuring`."""
    step = measuring(window, target, region, cfg, workspace=workspace)
    step.run()
    return step.read()
