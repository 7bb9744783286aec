"""Finder patterns in the motion-compensated events, and triples of them that could be corners of a code.

The paper's 1:1:3:1:1 kernel on rows and columns finds nothing at 45 degrees: a code's axes are not the
image's.  Here a bank of signed two-dimensional matched filters (`evqr.search.templates`) runs over a pyramid
on which a module always has the same size.  Coarse steps are enough: `align` refines.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from evqr.config import FinderConfig
from evqr.events.batch import EventBatch
from evqr.events.window import Window
from evqr.fit.image import count_for
from evqr.fit.region import Region
from evqr.motion import Motion
from evqr.search.busy import busy_region
from evqr.search.pyramid import Pyramid, levels_of
from evqr.search.templates import ANGLES, TERMS, bank_along, spans
from evqr.search.triples import leg_tolerances
from evqr.workspace import EventRoom, Keeper, Staging, Workspace

BYTES_A_CELL = 300
"""Bytes of all arrays of a search, a cell of the finest level of a window. Measured."""


@dataclass(frozen=True, eq=False)
class Peaks:
    """Places that look like a finder pattern.

    Attributes
    ----------
    table : (N, 5) float32
        A row each, best first: response, x, y, size of a module, angle.
    """

    table: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.table)

    @property
    def response(self) -> NDArray[np.float32]:
        """Normalised (N,), -1 to 1; negative where the code is inverted (or the motion backwards)."""
        return self.table[:, 0]

    @property
    def position(self) -> NDArray[np.float32]:
        """Centres (N, 2) [px]."""
        return self.table[:, 1:3]

    @property
    def module_px(self) -> NDArray[np.float32]:
        """Size of a module (N,) [px]."""
        return self.table[:, 3]

    @property
    def angle(self) -> NDArray[np.float32]:
        """Of the pattern's axes (N,), 0 to pi / 2 [rad]."""
        return self.table[:, 4]


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found in a window.

    Attributes
    ----------
    peaks : Peaks
        What looks like a finder pattern.
    triples : (N, 5) float32
        Three of them that could be corners of a code, best first: sum of their responses' magnitudes, index
        of the peak at the corner, along u and along v, and logarithm of the modules between them.
    """

    peaks: Peaks
    triples: NDArray[np.float32]


class Finder(Keeper):
    """The search in windows whose regions fit into one size."""

    def __init__(
        self,
        events: EventRoom,
        count: int,
        rows: int,
        columns: int,
        cfg: FinderConfig,
        workspace: Workspace,
    ) -> None:
        self._backend, self._cfg = workspace.backend, cfg
        self._staging = staging = Staging(workspace, events)
        self.pyramid = Pyramid(events, count, rows, columns, cfg, workspace, staging)
        side = 2 * cfg.half + 1
        self._basis = staging.input((count, side, side, TERMS))
        self._mix = staging.input((count, ANGLES, TERMS))
        self._degrees: list[int | None] = [None] * count
        layout = self.pyramid.layout
        self._rows, self._sizes = workspace.put(layout.rows), workspace.put(layout.sizes)
        self._disc = workspace.put(spans(cfg))
        # as large a part of each level is busy as of the finest
        shares = cfg.scale_ratio ** (2.0 * np.arange(len(self.pyramid.levels)))
        self._quiet = [workspace.put((each.floor * shares).astype(np.float32)) for each in cfg.passes]
        self._extent = staging.input((count, len(self.pyramid.levels), 2), np.int32)
        self._origin = staging.input((count, 2))
        self._tolerances = [workspace.put(leg_tolerances(cfg, each.slack)) for each in cfg.passes]
        self._peaks = staging.output((count, cfg.peaks, 5))
        self._triples = staging.output((count, cfg.peaks, cfg.triples_a_corner, 4))
        _, tall, wide = self.pyramid.images.device.shape
        high, across = tall - 2 * cfg.half, wide - 2 * cfg.half
        self._response = workspace.empty(count, high, across)
        self._angle = workspace.empty(count, high, across, dtype=np.int32)
        sizes = {"B": count, "N": side, "K": len(self.pyramid.levels), "Y": tall, "X": wide}
        self._correlating = workspace.scratch("correlate_templates", **sizes)
        self._maxima = workspace.empty(count, high, cfg.peaks_a_row, 5)
        self._merging = workspace.scratch("merge_maxima", B=count, N=high * cfg.peaks_a_row)
        self._matching = workspace.scratch("match_corners", B=count, P=cfg.peaks)

    def write(
        self,
        batch: EventBatch,
        motions: Sequence[Motion],
        regions: Sequence[Region],
        lags_px: Sequence[tuple[float, float] | None],
    ) -> None:
        """Say where is searched, and along which motions; there may be fewer windows than there is room."""
        self.pyramid.write(batch, motions, regions, lags_px)
        self._turn_to(motions)
        for k, region in enumerate(regions):
            self._origin.host[k] = region.x, region.y

    def _turn_to(self, motions: Sequence[Motion]) -> None:
        """Set the templates for the directions of motion."""
        for k, motion in enumerate(motions):
            v_x, v_y = motion.velocity.tolist()
            degrees = round(math.degrees(math.atan2(v_y, v_x)))  # as good as it is known
            if degrees != self._degrees[k]:
                self._basis.host[k], self._mix.host[k] = bank_along(degrees, self._cfg)
                self._degrees[k] = degrees

    def find(self, which: int, windows: Collection[int], *, first: bool) -> list[Found]:
        """Run a pass over some of the windows and give what it found in each; nothing in the others.

        The first since something was written makes the images, which those after it look at.
        """
        cfg, regions = self._cfg, self.pyramid.regions
        self._extent.host[:] = 0
        for k in windows:
            for n, level in enumerate(levels_of(regions[k].height, regions[k].width, cfg)):
                if level.module_px >= cfg.passes[which].least_module_px:
                    self._extent.host[k, n] = level.rows, level.columns
        launch = functools.partial(self._launch_pass, which, first=first)
        self.once((which, first), lambda: self._staging.sequence(launch))()
        peaks, triples = self._peaks.read()[: len(regions)], self._triples.read()[: len(regions)]
        counts = np.count_nonzero(peaks[:, :, 0], axis=1).tolist()
        return [
            Found(Peaks(peaks[k, :count].copy()), some)
            for k, (count, some) in enumerate(zip(counts, in_order(triples), strict=True))
        ]

    def _launch_pass(self, which: int, *, first: bool) -> None:
        """Launch the kernels of a pass one by one; those of the pyramid before the first.

        A pass that differs from the one before in its slack alone takes the peaks of that.
        """
        backend, cfg, one = self._backend, self._cfg, self._cfg.passes[which]
        if first:
            self.pyramid.launch()
        if first or replace(one, slack=1.0) != replace(cfg.passes[which - 1], slack=1.0):
            backend.correlate_templates(
                self.pyramid.images.device, self.pyramid.busy, self._basis.device, self._mix.device,
                self._disc, self._rows, self._extent.device, self._quiet[which], one.min_first,
                one.min_response, *self._correlating, self._response, self._angle,
            )  # fmt: skip
            backend.local_maxima(
                self._response, self._angle, self._rows, self._extent.device, self._sizes,
                self._origin.device, 0.0, math.pi / 2 / ANGLES, self._maxima,
            )  # fmt: skip
            count, high, a_row, _ = self._maxima.shape
            many = self._maxima.reshape((count, high * a_row, 5))
            apart = 2.0, 1.5 * math.log(cfg.scale_ratio)
            backend.merge_maxima(many, *apart, *self._merging, self._peaks.device)
        backend.match_corners(
            self._peaks.device, self._tolerances[which], *self._matching, self._triples.device
        )


def bytes_for(windows: Sequence[Window], cfg: FinderConfig) -> float:
    """Give the bytes that a search takes a window: as if something happened all over the largest."""
    cell = cfg.smallest_module_px / cfg.cells_a_module
    return BYTES_A_CELL * max(window.width * window.height for window in windows) / cell**2


def in_order(triples: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Give for each window the triples (N, 5) of all corners (B, P, most, 4), best first."""
    _, peaks, most, _ = triples.shape
    rows = triples.reshape(-1, 4)
    place = np.flatnonzero(rows[:, 0])
    found, corner = rows[place], place // most
    window = corner // peaks
    order = np.lexsort((-found[:, 0], window))
    ordered = np.empty((len(place), 5), np.float32)
    ordered[:, 0], ordered[:, 1], ordered[:, 2:] = found[:, 0], corner % peaks, found[:, 1:]
    ordered = ordered[order]
    ends = np.searchsorted(window, np.arange(len(triples)), side="right").tolist()
    return [ordered[first:end] for first, end in pairwise([0, *ends])]


def finding(
    batch: EventBatch,
    motions: Sequence[Motion],
    cfg: FinderConfig,
    *,
    workspace: Workspace,
    lags_px: Sequence[tuple[float, float] | None] | None = None,
) -> Finder:
    """Make ready to find finder patterns in windows: what codes that could be there are made up from.

    Parameters
    ----------
    batch : EventBatch
        B windows, at least one: where to search.
    motions : sequence of Motion
        Of the codes, at the middle of each window.
    cfg : FinderConfig
        Settings.
    workspace : Workspace
        Buffers.
    lags_px : sequence of (float, float) or None [px]
        Lag of the pixels for ON and OFF events along the motion, a window; None: as configured.

    Returns
    -------
    finder : Finder
        Whose passes are to be run in their order, before it is made ready for other windows.
    """
    events, count = workspace.events(batch), count_for(len(batch))
    regions = [busy_region(window, cfg) for window in batch.windows]
    rows, columns = (max(sides) for sides in zip(*((r.height, r.width) for r in regions), strict=True))
    finder = workspace.once(
        ("finder", events.size, count, rows, columns, cfg),
        lambda: Finder(events, count, rows, columns, cfg, workspace),
    )
    finder.write(batch, motions, regions, lags_px or [None] * len(batch))
    return finder


def find_patterns(
    batch: EventBatch,
    motions: Sequence[Motion],
    cfg: FinderConfig,
    *,
    workspace: Workspace,
    lags_px: Sequence[tuple[float, float] | None] | None = None,
) -> tuple[list[Found], Pyramid]:
    """Find finder patterns in windows with the last, most thorough pass.

    Parameters
    ----------
    batch, motions, cfg, workspace : as of `finding`
        The same.
    lags_px : sequence of (float, float) or None [px]
        As of `finding`.

    Returns
    -------
    found : list of Found
        One a window.
    pyramid : Pyramid
        What was searched; its images last until the next search.
    """
    alone = replace(cfg, passes=tuple(each for each in cfg.passes if each.slack <= 1.0)[-1:])
    finder = finding(batch, motions, alone, workspace=workspace, lags_px=lags_px)
    return finder.find(0, range(len(batch)), first=True), finder.pyramid
