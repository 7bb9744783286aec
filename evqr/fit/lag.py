"""How far the pixels lag: one time constant for ON and one for OFF events.

A photoreceptor is a first-order low-pass, tau dY/dt + Y = X.  Seen from the moving code that smears the
image along the motion over lag = |v| tau px, and one directional derivative undoes it (`evqr_kernels`,
lag_operator).  OFF events lag about twice as much as ON events: a darker pixel is slower.  One deposit of
the events gives the image for every pair of lags; the pair is taken whose image agrees best with the known
modules.

The image must be blurred by about a quarter of a module, as regions are, or the comparison favours small
lags: sharpening also sharpens noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.fit.align import Align, Alignment, fine_levels
from evqr.fit.image import Cells, Deposit, Sharpen, cells_for
from evqr.fit.region import Regions
from evqr.fit.tables import Codes, PoseTables
from evqr.fit.targets import Targets
from evqr.workspace import EventRoom, Images, Staging, Step, Workspace

CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
"""Lags [px] whose images those for all pairs are mixed from: the image is linear in the lags."""

LEAST_ON = 0.1
"""ON lag around which is tried where none is better than those that were tried first [modules]."""


def estimate_lags(
    batch: EventBatch,
    targets: Targets,
    regions: Regions,
    pose: NDArray[np.float64],
    cfg: ReadConfig,
    *,
    workspace: Workspace,
) -> tuple[NDArray[np.float64], Alignment]:
    """Estimate the lags at poses that stage one found without them, one a window.

    Parameters
    ----------
    batch : EventBatch
        The windows.
    targets : Targets
        The codes, and how they move.
    regions : Regions
        Around them.
    pose : (N, 3, 3) float64
        Code coordinates to cells of the regions.
    cfg : ReadConfig
        Settings.
    workspace : Workspace
        Buffers.

    Returns
    -------
    lag_px : (N, 2) float64 [px]
        Of ON and of OFF events.
    alignment : Alignment
        Of the poses with these lags.
    """
    lag, count = cfg.lag, len(targets)
    motions = targets.motions
    codes, (level,) = Codes.of(workspace), fine_levels(cfg.align)
    numbers = codes.numbers(targets.spaces)
    tables = codes.poses(level, cfg.align, numbers)
    events, cells = workspace.events(batch), cells_for(regions, workspace=workspace)
    from_events = cells.take(batch, motions, regions)
    step = cells.once(
        ("lag", from_events and events.size, tables.version, cfg.align, lag),
        lambda: _Lag(events if from_events else None, cells, tables, cfg, workspace),
    )
    cell = regions[:, 2]
    on = cell[:, None] * cfg.align.cells_a_module * np.array(lag.first_on)
    first = np.stack([on, lag.off_over_on * on], axis=2)
    # a lagging edge is seen behind the true one by the mean lag
    behind = 0.5 * first.sum(axis=2) / cell[:, None]
    start = pose[:, None].repeat(len(lag.first_on), axis=1)
    along = motions.direction
    start[:, :, :2] += (behind[:, :, None] * along[:, None])[..., None] * pose[:, None, 2:]
    if step.deposit is not None:
        step.deposit.write(batch, motions, regions)
    step.corners.write(motions, regions, [CORNERS] * count)
    step.first.write(first, start, numbers)
    step.run()
    rows = np.arange(count)
    tried = step.first.align.read()
    best = tried.score.reshape(count, -1).argmax(axis=1)
    from_pair = first[rows, best]
    least = cell * cfg.align.cells_a_module * LEAST_ON
    about = np.where(best[:, None] > 0, from_pair, least[:, None] * (1.0, lag.off_over_on))
    factors = [(f, g) for f in lag.factors for g in lag.factors if (f, g) != (1.0, 1.0)]
    second = np.concatenate([from_pair[:, None], about[:, None] * np.array(factors)], axis=1)
    start = tried.pose.reshape(count, -1, 3, 3)[rows, best][:, None].repeat(second.shape[1], axis=1)
    step.second.write(second, start, numbers)
    step.second.run()
    tried = step.second.align.read()
    best = tried.score.reshape(count, -1).argmax(axis=1)
    return second[rows, best], tried.pick(rows * second.shape[1] + best)


class _Lag(Step):
    """The images for the corners, and the pairs that are tried first; then the pairs around the best.

    From events, or from the cells there are.
    """

    def __init__(
        self, events: EventRoom | None, cells: Cells, tables: PoseTables, cfg: ReadConfig,
        workspace: Workspace,
    ) -> None:  # fmt: skip
        super().__init__(workspace, events=events)
        self.deposit = None if events is None else Deposit(events, cells, workspace, self._staging)
        blur, corners = cfg.align.blur_cells, len(CORNERS)
        self.corners = Sharpen(cells, blur, workspace, self._staging, each=corners)
        images = self.corners.images
        self.first = _Pairs(images, len(cfg.lag.first_on), tables, cfg, workspace, self._staging)
        self.second = _Pairs(images, len(cfg.lag.factors) ** 2, tables, cfg, workspace)

    def launch(self) -> None:
        """Launch the kernels one by one."""
        if self.deposit is not None:
            self.deposit.launch()
        self.corners.launch()
        self.first.launch()


class _Pairs(Step):
    """Images for some pairs of lags a window, mixed from those for `CORNERS`, and poses on them.

    A step or two settle which pair is best; what they leave of the pose the next alignment takes up.
    """

    def __init__(
        self, corners: Images, each: int, tables: PoseTables, cfg: ReadConfig, workspace: Workspace,
        staging: Staging | None = None,
    ) -> None:  # fmt: skip
        super().__init__(workspace, staging)
        count, height, width = corners.device.shape
        windows = count // len(CORNERS)
        self._corners = corners.device.reshape((windows, len(CORNERS), height, width))
        self._each, self._weight = each, self._staging.input((windows * each, len(CORNERS)))
        self._window = workspace.put(np.arange(windows, dtype=np.int32).repeat(each))
        self._images = Images(workspace.empty(windows * each, height, width))
        most = cfg.lag.max_iterations
        self.align = Align(self._images, windows * each, [tables], most, workspace, self._staging)

    def write(self, pairs: NDArray[np.float64], start: NDArray[np.float64], numbers: Sequence[int]) -> None:
        """Say which lags (N, each, 2) [px], the poses (N, each, 3, 3) to start from, and of which codes."""
        on, off = pairs.reshape(-1, 2).T
        self._weight.fill(np.stack([1.0 - on - off, on, off], axis=1))
        images = np.arange(len(on), dtype=np.int32)
        self.align.write(start, images, np.repeat(numbers, self._each).tolist())

    def launch(self) -> None:
        """Launch the kernels one by one."""
        self._backend.mix_images(self._corners, self._window, self._weight.device, self._images.device)
        self.align.launch()
