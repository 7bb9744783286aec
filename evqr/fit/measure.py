"""A code whose pose is nearly known: from a window's events to its pose and equations in one sequence.

This is what following a code costs a window, and the last step of finding one.  The device does all of it
without the host: events to cells, cells to the image, stage one at its finest level, and with the pose and
gain that it ends with stage two's right-hand side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.config import ReadConfig
from evqr.events.window import Window
from evqr.fit.align import Align, Alignment, fine_levels
from evqr.fit.image import Deposit, Sharpen, depositing
from evqr.fit.modules import Equations, NormalEquations
from evqr.fit.region import Region
from evqr.workspace import Step, Workspace


@dataclass(frozen=True, eq=False)
class Measurement:
    """What a window says of a code.

    Attributes
    ----------
    image : (1, height, width)   on the device, until the next measurement on a region of this size
    found                        of stage one, in cells of the region
    equations                    of stage two, for that pose and gain
    """

    image: Any
    found: Alignment
    equations: NormalEquations


class Measure(Step):
    """The sequence for one size of region; with ``from_events``, or from the cells that are there."""

    def __init__(
        self, deposit: Deposit, from_events: bool, version: int, cfg: ReadConfig, workspace: Workspace
    ) -> None:
        super().__init__(workspace.backend)
        one = cfg.stage_one
        self._deposit = deposit  # it is known by its id as long as this lives
        self.sharpen = Sharpen(deposit.cells, 1, workspace)
        image = self.sharpen.images
        self.align = Align(image, 1, version, fine_levels(one), one.max_iterations, one, workspace)
        self.equations = Equations(
            image, self.align.pose, self.align.gain, version, one.sigma, cfg.stage_two, workspace
        )
        self._steps = [*([deposit] if from_events else []), self.sharpen, self.align, self.equations]

    def launch(self) -> None:
        """Launch the kernels one by one."""
        for step in self._steps:
            step.launch()


def measure(
    window: Window,
    velocity: NDArray[np.float64],
    region: Region,
    pose: NDArray[np.float64],
    version: int,
    lag_px: tuple[float, float],
    cfg: ReadConfig,
    *,
    workspace: Workspace,
    from_events: bool = True,
) -> Measurement:
    """Refine the pose of a code in a window and build its equations.

    Parameters
    ----------
    velocity : (2,)   [px/s]
    pose : (3, 3)     code coordinates to cells of the region
    lag_px            of the pixels along the motion, for ON and OFF events [px]
    from_events       False: the last deposit on a region of this size is of this window and region
    """
    deposit = depositing(window, velocity, region, workspace=workspace)
    step = workspace.once(
        ("measure", id(deposit), from_events, version, cfg.stage_one, cfg.stage_two),
        lambda: Measure(deposit, from_events, version, cfg, workspace),
    )
    step.sharpen.write(velocity, region, [lag_px])
    step.align.write(pose[None], 0)
    step.run()
    found = step.align.read()
    return Measurement(step.sharpen.images, found, step.equations.read(found.gain[0]))
