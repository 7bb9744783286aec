"""Finder patterns in the motion-compensated events, and the codes that three of them could belong to.

The paper's 1:1:3:1:1 kernel on rows and columns finds nothing at 45 degrees: a code's axes are not the
image's.  Here a bank of signed two-dimensional matched filters, ``-(grad of the finder pattern) . m / |m|``
at eight angles, runs over a pyramid on which a module always has the same size.  Coarse steps are enough:
stage one refines.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from evqr.config import FinderConfig, SearchPass
from evqr.events.window import Window
from evqr.fit.image import Deposit, Sharpen
from evqr.fit.model import profiles
from evqr.fit.region import Region
from evqr.motion import Motion
from evqr.symbol import qr
from evqr.symbol.space import CodeSpace
from evqr.workspace import EventSlots, Images, Mirror, Step, Workspace

ANGLES = 8
"""Templates, over a right angle: a finder pattern looks alike turned by one."""

TERMS = 5
"""Templates that the others are mixed from, to 0.4 %."""

BLUR_CELLS = 0.55
"""Blur of the finest image beyond that of the deposit [cells]."""

_Affine: TypeAlias = list[tuple[float, float, float]]


@dataclass(frozen=True, eq=False)
class Peaks:
    """Places that look like a finder pattern.

    Attributes
    ----------
    table : (N, 5) float32   a row each, best first: response, x, y, size of a module, angle
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


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A code that three finder patterns could belong to.

    Attributes
    ----------
    space : CodeSpace
        Kind and size of the code.
    pose : (3, 3) float64
        Code coordinates to px.
    response : float
        Sum of the responses of its finder patterns.
    inverted : bool
        Light modules on dark.
    triple : int
        Which patterns: hypotheses from the same ones differ in the size of the code.
    """

    space: CodeSpace
    pose: NDArray[np.float64]
    response: float
    inverted: bool
    triple: int = 0


@functools.cache
def _template_gradients(cells_a_module: float, half: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give the gradient of a finder pattern in the image, (2, n, n, ANGLES), and its disc (n, n)."""
    steps = np.arange(-half, half + 1) / cells_a_module
    x, y = np.meshgrid(steps, steps)
    disc = (x * x + y * y <= min(5.2, half / cells_a_module + 0.3) ** 2).astype(np.float64)
    sigma = 0.8 / cells_a_module * 0.8
    gradients = np.empty((2, *x.shape, ANGLES))
    for a in range(ANGLES):
        cos, sin = math.cos(a * math.pi / 2 / ANGLES), math.sin(a * math.pi / 2 / ANGLES)
        u, v = cos * x + sin * y, -sin * x + cos * y
        along_u, along_v = np.zeros_like(u), np.zeros_like(u)
        for size, sign in ((7, -1.0), (5, 1.0), (3, -1.0)):
            # a square of `size` modules is a module's profile, stretched
            fu, du, _ = profiles((u + size / 2) / size, sigma / size)
            fv, dv, _ = profiles((v + size / 2) / size, sigma / size)
            along_u += sign * du / size * fv
            along_v += sign * fu * dv / size
        gradients[0, :, :, a] = (cos * along_u - sin * along_v) * disc
        gradients[1, :, :, a] = (sin * along_u + cos * along_v) * disc
    return gradients, disc


@functools.cache
def _spans(cfg: FinderConfig) -> NDArray[np.int32]:
    """First row of the disc in each column of a template, and the one behind its last, (n, 2)."""
    _, disc = _template_gradients(cfg.cells_a_module, cfg.half)
    return np.array([(c.argmax(), len(c) - c[::-1].argmax()) for c in disc.T > 0.0], np.int32)


@functools.lru_cache(maxsize=361)
def _bank(degrees: int, cfg: FinderConfig) -> tuple[NDArray[np.float64], ...]:
    """Give the templates for a direction of motion as a basis (n, n, TERMS) and a mixture (ANGLES, TERMS)."""
    gradients, _ = _template_gradients(cfg.cells_a_module, cfg.half)
    along = np.deg2rad(degrees)
    bank = -(np.cos(along) * gradients[0] + np.sin(along) * gradients[1])
    bank /= np.sqrt(np.square(bank).sum(axis=(0, 1)))
    # the space that the templates span, from their correlations with each other
    flat = bank.reshape(-1, ANGLES)
    strengths, mixtures = np.linalg.eigh(flat.T @ flat)
    mix, length = mixtures[:, -TERMS:], np.sqrt(strengths[-TERMS:])
    return (flat @ (mix / length)).reshape(*bank.shape[:2], TERMS), mix * length


def _module_sizes(search_pass: SearchPass, ratio: float) -> list[float]:
    """Sizes from the smallest on; each answers for half a step on either side."""
    smallest, largest = search_pass.smallest_module_px, search_pass.largest_module_px
    count = 1 + round(math.log(largest / smallest) / math.log(ratio))
    return [smallest * ratio**k for k in range(count)]


class _Search:
    """The search in windows of one size of image: its levels, and what runs over them."""

    def __init__(
        self, events: EventSlots, height: int, width: int, cfg: FinderConfig, search_pass: SearchPass,
        workspace: Workspace,
    ) -> None:  # fmt: skip
        backend, half = workspace.backend, cfg.half
        side = 2 * half + 1
        self._basis, self._mix = workspace.mirror((side, side, TERMS)), workspace.mirror((ANGLES, TERMS))
        self._peaks = workspace.mirror((1, search_pass.peaks, 5))
        self._match = Match(self._peaks, cfg, workspace)
        spans = workspace.put(_spans(cfg))
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
        self._cfg, self._most, self._run = cfg, search_pass.hypotheses, None
        self._degrees: int | None = None
        if not self.pyramid:
            return
        shapes = [level.image.device.shape[1:] for level in self.pyramid]
        cell, (rows, columns) = self.pyramid[0].cell, shapes[0]
        self._region = Region(-0.5, -0.5, cell, rows, columns)
        self._deposit = Deposit(events, rows, columns, workspace)
        self._sharpen = Sharpen(self._deposit.cells, 1, BLUR_CELLS, workspace)
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
                    padded[k], busy, self._basis.device, self._mix.device, spans,
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
            self._match.launch()

        self._run = backend.record(launch)

    def __call__(self, window: Window, motion: Motion, lag_px: tuple[float, float] | None) -> Found:
        """Find what is in a window."""
        if self._run is None:
            return Found([], Peaks(np.empty((0, 5), np.float32)), [])
        v_x, v_y = motion.velocity.tolist()
        degrees = round(math.degrees(math.atan2(v_y, v_x)))  # as good as it is known
        if degrees != self._degrees:
            basis, mix = _bank(degrees, self._cfg)
            self._basis.write(basis)
            self._mix.write(mix)
            self._degrees = degrees
        if lag_px is None:
            on, off = self._cfg.lag_cells
            lag_px = on * self._region.cell, off * self._region.cell
        self._deposit.write(window, motion, self._region)
        self._sharpen.write(motion, self._region, [lag_px])
        self._run()
        hypotheses = self._match.read(self._most)
        peaks = self._peaks.host[0]
        return Found(hypotheses, Peaks(peaks[: np.count_nonzero(peaks[:, 0])].copy()), self.pyramid)


class Match(Step):
    """Triples of peaks (1, N, 5) that make the corners of a code.

    Corner i sees its neighbours j (along u) and k (along v) at a right angle, with equal legs of 10 + 4
    version modules.
    """

    def __init__(self, peaks: Mirror, cfg: FinderConfig, workspace: Workspace) -> None:
        super().__init__(workspace.backend)
        room = peaks.host.shape[1]
        log_legs = np.log((10.0 + 4.0 * qr.MIN_VERSION, 10.0 + 4.0 * qr.MAX_VERSION))
        tolerances = (cfg.leg_tolerance, cfg.scale_tolerance, cfg.angle_tolerance, *log_legs)
        self._peaks, self._cfg = peaks, cfg
        self._tolerances = workspace.put(np.array(tolerances, np.float32))
        self._scratch = workspace.scratch("match_corners", B=1, P=room)
        self._triples = workspace.mirror((1, room, cfg.triples_a_corner, 4))

    def launch(self) -> None:
        """Launch the kernels one by one."""
        self._backend.match_corners(
            self._peaks.device, self._tolerances, *self._scratch, self._triples.device
        )

    def read(self, most: int) -> list[Hypothesis]:
        """Wait for the device and give so many hypotheses, or a few more, best first."""
        peaks = self._peaks.read()[0]
        triples = self._triples.read().reshape(-1, 4)
        places = peaks[:, 1:3].tolist()
        found: list[tuple[CodeSpace, float, bool, int]] = []
        poses: list[_Affine] = []
        for triple, index in enumerate(np.argsort(-triples[:, 0], kind="stable").tolist()):
            response, j, k, log_modules = triples[index].tolist()
            if not response or len(found) >= most:
                break
            i = index // self._cfg.triples_a_corner
            inverted = bool(peaks[i, 0] < 0.0)
            for version in _versions(log_modules, self._cfg.scale_tolerance):
                found.append((qr.space(version), response, inverted, triple))
                poses.append(_pose(places[i], places[int(j)], places[int(k)], version))
        return [
            Hypothesis(space, pose, response, inverted, triple)
            for pose, (space, response, inverted, triple) in zip(np.array(poses), found, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found.

    Attributes
    ----------
    hypotheses   codes that might be there, best first
    peaks        that they were made of, and others
    pyramid      the images that were searched, finest first
    """

    hypotheses: list[Hypothesis]
    peaks: Peaks
    pyramid: list[PyramidLevel]


def find_hypotheses(
    window: Window,
    motion: Motion,
    cfg: FinderConfig,
    *,
    workspace: Workspace,
    search_pass: SearchPass | None = None,
    lag_px: tuple[float, float] | None = None,
) -> Found:
    """Find finder patterns in a window, and the codes that three of them could belong to.

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
    events = workspace.events(window)
    search = workspace.once(
        ("search", events.capacity, window.height, window.width, cfg, search_pass),
        lambda: _Search(events, window.height, window.width, cfg, search_pass, workspace),
    )
    return search(window, motion, lag_px)


def _versions(log_modules: float, tolerance: float) -> list[int]:
    """Versions whose finder patterns are so many modules apart, to a tolerance, best first."""
    least, most = (0.25 * (math.exp(log_modules + end) - 10.0) for end in (-tolerance, tolerance))
    fits = range(max(math.ceil(least), qr.MIN_VERSION), min(math.floor(most), qr.MAX_VERSION) + 1)
    return sorted(fits, key=lambda version: abs(math.log(10.0 + 4.0 * version) - log_modules))


def _pose(corner: list[float], along: list[float], down: list[float], version: int) -> _Affine:
    """Affine pose from the centres (x, y) of the finder patterns: top left, top right and bottom left."""
    legs = 10 + 4 * version  # modules between two centres
    rows: _Affine = []
    for at, u, v in zip(corner, along, down, strict=True):
        per_u, per_v = (u - at) / legs, (v - at) / legs
        rows.append((per_u, per_v, at - 3.5 * (per_u + per_v)))
    return [*rows, (0.0, 0.0, 1.0)]
