"""Finder patterns in the motion-compensated events, and the codes that they could belong to.

The paper's 1:1:3:1:1 kernel on rows and columns finds nothing at 45 degrees: a code's axes are not the
image's.  Here a bank of signed two-dimensional matched filters (`evqr.search.templates`) runs over a pyramid
on which a module always has the same size.  Coarse steps are enough: `align` refines.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.config import FinderConfig, SearchPass
from evqr.events.batch import EventBatch
from evqr.events.window import Window
from evqr.fit.image import Deposit, Sharpen
from evqr.fit.region import Region
from evqr.motion import Motion
from evqr.search.hypothesis import Hypothesis, Layout, Matcher
from evqr.search.singles import Singles
from evqr.search.templates import ANGLES, TERMS, bank_along, spans
from evqr.search.triples import Triples
from evqr.workspace import EventRoom, Images, Workspace

BLUR_CELLS = 0.55
"""Blur of the finest image beyond that of the deposit [cells]."""


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
class PyramidLevel:
    """The motion-compensated events on cells of one size.

    Attributes
    ----------
    cell : float [px]
        Size of a cell.
    image : Images
        One image, until the next search with the same settings in a window of this size.
    """

    cell: float
    image: Images

    @cached_property
    def from_px(self) -> NDArray[np.float64]:
        """(3, 3) map of px to cells, integers at cell centres."""
        s, shift = 1.0 / self.cell, 0.5 / self.cell - 0.5
        return np.array([[s, 0.0, shift], [0.0, s, shift], [0.0, 0.0, 1.0]])

    @cached_property
    def to_px(self) -> NDArray[np.float64]:
        """(3, 3) map of cells to px."""
        s, shift = self.cell, 0.5 * self.cell - 0.5
        return np.array([[s, 0.0, shift], [0.0, s, shift], [0.0, 0.0, 1.0]])


def _module_sizes(search_pass: SearchPass, ratio: float) -> list[float]:
    """Sizes from the smallest on; each answers for half a step on either side."""
    smallest, largest = search_pass.smallest_module_px, search_pass.largest_module_px
    count = 1 + round(math.log(largest / smallest) / math.log(ratio))
    return [smallest * ratio**k for k in range(count)]


class _Search:
    """The search in windows of one size of image: its levels, and what runs over them."""

    def __init__(
        self, events: EventRoom, height: int, width: int, cfg: FinderConfig, search_pass: SearchPass,
        workspace: Workspace,
    ) -> None:  # fmt: skip
        backend, half = workspace.backend, cfg.half
        side = 2 * half + 1
        self._basis, self._mix = workspace.mirror((side, side, TERMS)), workspace.mirror((ANGLES, TERMS))
        self._peaks = workspace.mirror((1, search_pass.peaks, 5))
        self._matchers: dict[Layout, Matcher] = {
            Layout.THREE_CORNERS: Triples(self._peaks, search_pass.hypotheses, cfg, workspace),
            Layout.SINGLE: Singles(self._peaks, search_pass.single_patterns),
        }
        disc = workspace.put(spans(cfg))
        self.pyramid: list[PyramidLevel] = []
        padded: list[Any] = []
        modules: list[float] = []
        for module_px in _module_sizes(search_pass, cfg.scale_ratio):
            cell = module_px / cfg.cells_a_module
            rows, columns = math.ceil(height / cell), math.ceil(width / cell)
            if min(rows, columns) < side:
                break
            # a border of zeros, which templates may hang over
            padded.append(workspace.empty(1, rows + 2 * half, columns + 2 * half))
            backend.clear(padded[-1])
            inner = padded[-1][:, half : half + rows, half : half + columns]
            self.pyramid.append(PyramidLevel(cell, Images(inner)))
            modules.append(module_px)
        self._cfg, self._run = cfg, None
        self._degrees: int | None = None
        if not self.pyramid:
            return
        shapes = [level.image.device.shape[1:] for level in self.pyramid]
        cell, (rows, columns) = self.pyramid[0].cell, shapes[0]
        self._region = Region(-0.5, -0.5, cell, rows, columns)
        self._deposit = Deposit(events, 1, rows, columns, workspace)
        self._sharpen = Sharpen(self._deposit, BLUR_CELLS, workspace)
        slots = sum(rows for rows, _ in shapes)
        a_row = cfg.peaks_a_row
        maxima = workspace.empty(1, slots, a_row, 5)
        merging = workspace.scratch("merge_maxima", B=1, N=slots * a_row)
        busy = workspace.empty(1)

        def launch() -> None:
            first = 0
            for k, (level, (rows, columns)) in enumerate(zip(self.pyramid, shapes, strict=True)):
                if k == 0:
                    self._deposit.launch()
                    self._sharpen.launch()
                    scratch = workspace.scratch("clip_outliers", B=1, Y=rows)
                    images = self._sharpen.images.device
                    backend.clip_outliers(images, cfg.clip, *scratch, level.image.device, busy)
                else:
                    fine = self.pyramid[k - 1].image.device
                    sizes = {"Y": fine.shape[1], "X": fine.shape[2], "ratio": cfg.scale_ratio}
                    scratch = workspace.scratch("reduce_image", B=1, **sizes)
                    backend.reduce_image(fine, cfg.scale_ratio, *scratch, level.image.device)
                response = workspace.empty(1, rows, columns)
                angle = workspace.empty(1, rows, columns, dtype=np.int32)
                _, tall, wide = padded[k].shape
                scratch = workspace.scratch("correlate_templates", B=1, N=side, Y=tall, X=wide)
                # as large a part of each level is busy as of the finest
                share = math.prod(shapes[0]) / math.prod(shapes[k])
                backend.correlate_templates(
                    padded[k], busy, self._basis.device, self._mix.device, disc,
                    share * search_pass.floor, cfg.min_response, *scratch, response, angle,
                )  # fmt: skip
                backend.local_maxima(
                    response, angle, 0.0, level.cell, modules[k], math.pi / 2 / ANGLES,
                    maxima[:, first : first + rows],
                )  # fmt: skip
                first += rows
            backend.merge_maxima(
                maxima.reshape((1, slots * a_row, 5)), 2.0, 1.5 * math.log(cfg.scale_ratio), *merging,
                self._peaks.device,
            )  # fmt: skip
            for matcher in self._matchers.values():
                matcher.launch()

        self._run = backend.record(launch)

    def __call__(self, window: Window, motion: Motion, lag_px: tuple[float, float] | None) -> Found:
        """Find what is in a window."""
        if self._run is None:
            return Found({}, Peaks(np.empty((0, 5), np.float32)), [])
        v_x, v_y = motion.velocity.tolist()
        degrees = round(math.degrees(math.atan2(v_y, v_x)))  # as good as it is known
        if degrees != self._degrees:
            basis, mix = bank_along(degrees, self._cfg)
            self._basis.write(basis)
            self._mix.write(mix)
            self._degrees = degrees
        if lag_px is None:
            on, off = self._cfg.lag_cells
            lag_px = on * self._region.cell, off * self._region.cell
        self._deposit.write(EventBatch.of([window]), [motion], [self._region])
        self._sharpen.write([motion], [self._region], [[lag_px]])
        self._run()
        peaks = self._peaks.read()[0]
        return Found(self._matchers, Peaks(peaks[: np.count_nonzero(peaks[:, 0])].copy()), self.pyramid)


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found.

    Attributes
    ----------
    matchers : mapping of Layout to Matcher
        Who makes hypotheses of the peaks, until the next search.
    peaks : Peaks
        What looks like a finder pattern.
    pyramid : list of PyramidLevel
        The images that were searched, finest first; they last until the next search.
    """

    matchers: Mapping[Layout, Matcher]
    peaks: Peaks
    pyramid: list[PyramidLevel]

    def hypotheses(self, layout: Layout) -> list[Hypothesis]:
        """Give the codes with finder patterns laid out so that might be there, best first."""
        return self.matchers[layout].read() if self.matchers else []


def find_hypotheses(
    window: Window,
    motion: Motion,
    cfg: FinderConfig,
    *,
    workspace: Workspace,
    search_pass: SearchPass | None = None,
    lag_px: tuple[float, float] | None = None,
) -> Found:
    """Find finder patterns in a window: what the codes that they could belong to are made up from.

    Parameters
    ----------
    window : Window
        Where to search.
    motion : Motion
        Of the codes, at the middle of the window.
    cfg : FinderConfig
        Settings.
    workspace : Workspace
        Buffers.
    search_pass : SearchPass
        How thoroughly; default the configured last, most thorough one.
    lag_px : (float, float) [px]
        Lag of the pixels for ON and OFF events along the motion; default as configured.

    Returns
    -------
    found : Found
        Its images last until the next search.
    """
    search_pass = search_pass or cfg.passes[-1]
    events = workspace.events(EventBatch.of([window]))
    search = workspace.once(
        ("search", events.capacity, window.height, window.width, cfg, search_pass),
        lambda: _Search(events, window.height, window.width, cfg, search_pass, workspace),
    )
    return search(window, motion, lag_px)
