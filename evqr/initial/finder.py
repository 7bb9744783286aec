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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.codespace import MAX_VERSION, MIN_VERSION
from evqr.config import FinderConfig
from evqr.model import profiles
from evqr.region import Region, deposit, sharpen
from evqr.windows import Window
from evqr.workspace import Workspace

ANGLES = 8
FEWEST_CELLS = 24
"""Width of the smallest level [cells]: kernels take blocks of them."""

CLIP_RMS = 2.5
"""Cells are clipped at so many times the rms of the cells that have events: a hot pixel is no edge."""


@dataclass(frozen=True, eq=False)
class Peaks:
    """Places that look like a finder pattern, best first.

    Attributes
    ----------
    response : (N,)    normalised, -1 to 1; negative where the code is inverted (or the motion backwards)
    position : (N, 2)  [px]
    module_px : (N,)   size of a module [px]
    angle : (N,)       of the pattern's axes, 0 to pi / 2 [rad]
    """

    response: NDArray[np.float64]
    position: NDArray[np.float64]
    module_px: NDArray[np.float64]
    angle: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PyramidLevel:
    """The motion-compensated events on cells of one size.

    Attributes
    ----------
    cell                        size of a cell [px]
    image : (1, Y, X) float32   on the device, until the next search
    """

    cell: float
    image: Any

    @property
    def from_px(self) -> NDArray[np.float64]:
        """(3, 3) map of px to cells, integers at cell centres."""
        s, shift = 1.0 / self.cell, 0.5 / self.cell - 0.5
        return np.array([[s, 0.0, shift], [0.0, s, shift], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A code that three finder patterns could belong to.

    Attributes
    ----------
    version           1 to 40
    pose : (3, 3)     code coordinates to px
    response          sum of the three responses
    inverted          light modules on dark
    """

    version: int
    pose: NDArray[np.float64]
    response: float
    inverted: bool


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


def _bank(
    direction: NDArray[np.float64], cfg: FinderConfig
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    gradients, disc = _template_gradients(cfg.cells_a_module, cfg.half)
    bank = -(direction[0] * gradients[0] + direction[1] * gradients[1])
    bank /= np.sqrt(np.square(bank).sum(axis=(0, 1)))
    return np.ascontiguousarray(bank, dtype=np.float32), disc.astype(np.float32)


def _module_sizes(smallest: float, largest: float, ratio: float) -> list[float]:
    count = math.ceil(math.log(largest / smallest) / math.log(ratio)) + 1
    return [smallest * ratio**k for k in range(count)]


def _four(count: int) -> int:
    return -(-count // 4) * 4


def find_peaks(
    window: Window,
    velocity: NDArray[np.float64],
    cfg: FinderConfig,
    *,
    workspace: Workspace,
    lag_px: tuple[float, float] = (0.0, 0.0),
    quick: bool = False,
) -> tuple[Peaks, list[PyramidLevel]]:
    """Find what looks like a finder pattern in a window.

    Parameters
    ----------
    velocity : (2,) [px/s]
    lag_px          lag of the pixels for ON and OFF events along the motion [px]
    quick           only the module sizes of ``cfg.quick_module_px``, and only places with much energy:
                    most codes at a third of the cost

    Returns
    -------
    peaks     best first
    pyramid   the images that were searched, finest first
    """
    backend, device = workspace.backend, workspace.device
    bank, disc = _bank(velocity / float(np.hypot(*velocity)), cfg)
    bank_dev, disc_dev = workspace.put(bank), workspace.table(("finder disc", cfg), disc)
    found: list[NDArray[np.float64]] = []
    pyramid: list[PyramidLevel] = []
    busy = 0.0
    sizes = cfg.quick_module_px if quick else (cfg.smallest_module_px, cfg.largest_module_px)
    quiet, keep = (cfg.quick_floor, cfg.quick_peaks) if quick else (cfg.floor, cfg.max_peaks)
    for module_px in _module_sizes(*sizes, cfg.scale_ratio):
        cell = module_px / cfg.cells_a_module
        height, width = math.ceil(window.height / cell), _four(math.ceil(window.width / cell))
        if height < 2 * cfg.half + 1 or width < FEWEST_CELLS:
            break
        padded, image = _level_buffers(height, width, cfg.half, workspace)
        cells = workspace.get(image)
        if pyramid:
            fine = pyramid[-1].image
            rows = workspace.buffer("finder rows", (1, height, fine.shape[2]))
            backend.reduce_image(fine, cfg.scale_ratio, rows, image)
            backend.synchronize(device)
        else:
            cells[:] = _finest(window, velocity, cell, height, width, lag_px, workspace)
            busy = np.count_nonzero(cells) / cells.size
        pyramid.append(PyramidLevel(cell, image))
        flat = workspace.get(padded).ravel()
        mean_square = float(np.dot(flat, flat)) / max(busy * cells.size, 1.0)
        floor = np.array([quiet * mean_square * float(disc.sum())], np.float32)
        response = workspace.buffer("finder response", (1, height, width))
        angle = workspace.buffer("finder angle", (1, height, width), np.int32)
        backend.correlate_templates(padded, bank_dev, disc_dev, workspace.put(floor), response, angle)
        backend.synchronize(device)
        found.append(
            _local_peaks(workspace.get(response)[0], workspace.get(angle)[0], module_px, cell, keep, cfg)
        )
    return _merge(np.concatenate([np.empty((0, 5)), *found]), keep, cfg), pyramid


def _level_buffers(height: int, width: int, pad: int, workspace: Workspace) -> tuple[Any, Any]:
    """Make a level with a border of zeros that templates may hang over, and the level inside it."""

    def make() -> tuple[Any, Any]:
        padded = workspace.backend.empty((1, height + 2 * pad, width + 2 * pad), np.float32, workspace.device)
        workspace.clear(padded)
        return padded, padded[:, pad : pad + height, pad : pad + width]

    return workspace.once(("finder level", height, width, pad), make)


def _finest(
    window: Window,
    velocity: NDArray[np.float64],
    cell: float,
    height: int,
    width: int,
    lag_px: tuple[float, float],
    workspace: Workspace,
) -> NDArray[np.float32]:
    """Make the finest level from the events, (1, height, width); what falls on no cell is exactly 0."""
    region = Region(-0.5, -0.5, cell, height, width)
    events = deposit(window, velocity, region, workspace=workspace)
    image = sharpen(events, velocity, region, [lag_px], workspace=workspace)
    workspace.backend.synchronize(workspace.device)
    cells = workspace.get(image)
    flat = cells.ravel()
    rms = math.sqrt(float(np.dot(flat, flat)) / max(np.count_nonzero(flat), 1))
    return np.clip(cells, -CLIP_RMS * rms, CLIP_RMS * rms)


def _local_peaks(
    response: NDArray[np.float32],
    angle: NDArray[np.int32],
    module_px: float,
    cell: float,
    keep: int,
    cfg: FinderConfig,
) -> NDArray[np.float64]:
    """Local maxima of |response| on one level: rows of (response, x, y, module, angle)."""
    height, width = response.shape
    flat = response.ravel()
    at = np.flatnonzero(np.square(flat) > cfg.min_response**2)
    rows, columns = np.divmod(at, width)
    inside = (rows > 0) & (columns > 0) & (rows < height - 1) & (columns < width - 1)
    at, rows, columns = at[inside], rows[inside], columns[inside]
    value = np.abs(flat[at])
    for step in (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1):
        top = value >= np.abs(flat[at + step])
        at, rows, columns, value = at[top], rows[top], columns[top], value[top]
    if len(at) > keep:
        best = np.argpartition(-value, keep)[:keep]
        at, rows, columns, value = at[best], rows[best], columns[best], value[best]

    def offset(step: int) -> NDArray[np.float64]:
        before, after = np.abs(flat[at - step]), np.abs(flat[at + step])
        return np.clip(0.5 * (after - before) / np.maximum(2.0 * value - before - after, 1e-9), -0.5, 0.5)

    x, y = columns + offset(1), rows + offset(width)
    return np.stack(
        [
            flat[at].astype(np.float64),
            (x + 0.5) * cell - 0.5,
            (y + 0.5) * cell - 0.5,
            np.full(len(at), module_px),
            angle.ravel()[at] * (math.pi / 2 / ANGLES),
        ],
        axis=1,
    )


def _merge(found: NDArray[np.float64], keep: int, cfg: FinderConfig) -> Peaks:
    """Keep the best peaks; a place seen again on a neighbouring level is the same peak."""
    found = found[np.argsort(-np.abs(found[:, 0]), kind="stable")][: 2 * keep]
    x, y, size = found[:, 1], found[:, 2], np.log(np.maximum(found[:, 3], 1e-9))
    same = np.hypot(x[:, None] - x, y[:, None] - y) < 2.0 * found[:, 3][:, None]
    same &= np.abs(size[:, None] - size) < 1.5 * math.log(cfg.scale_ratio)
    same &= np.sign(found[:, 0])[:, None] == np.sign(found[:, 0])
    kept: list[int] = []
    left = np.ones(len(found), bool)
    for k in range(len(found)):
        if left[k]:
            left &= ~same[k]
            kept.append(k)
            if len(kept) == keep:
                break
    table = found[kept]
    return Peaks(table[:, 0], table[:, 1:3], table[:, 3], table[:, 4])


def find_hypotheses(peaks: Peaks, cfg: FinderConfig) -> list[Hypothesis]:
    """Triples of peaks that make the corners of a code, best first.

    Corner i sees its neighbours j (along u) and k (along v) at a right angle, with equal legs of 10 + 4
    version modules.
    """
    n = len(peaks.response)
    if n < 3:
        return []
    to = peaks.position[None, :, :] - peaks.position[:, None, :]
    leg = np.hypot(to[..., 0], to[..., 1])
    direction = np.arctan2(to[..., 1], to[..., 0])
    size = np.log(peaks.module_px)
    log_leg = np.log(np.maximum(leg, 1e-9))

    def turn(a: NDArray[np.float64], period: float) -> NDArray[np.float64]:
        return np.abs((a + period / 2) % period - period / 2)

    along_axes = turn(direction - peaks.angle[:, None], math.pi / 2) < cfg.angle_tolerance
    along_axes &= turn(direction - peaks.angle[None, :], math.pi / 2) < cfg.angle_tolerance
    pair = along_axes & (peaks.response[:, None] * peaks.response[None, :] > 0.0)
    pair &= np.abs(size[:, None] - size[None, :]) < 2.0 * cfg.scale_tolerance
    pair &= log_leg > np.minimum(size[:, None], size[None, :]) + math.log(14.0) - 2.0 * cfg.scale_tolerance

    # legs that leave the same corner, two by two
    corner, end = np.nonzero(pair)
    first, second = np.nonzero(corner[:, None] == corner[None, :])
    i, j, k = corner[first], end[first], end[second]
    fits = turn(direction[i, k] - direction[i, j] - math.pi / 2, 2.0 * math.pi) < cfg.angle_tolerance
    fits &= np.abs(log_leg[i, j] - log_leg[i, k]) < cfg.leg_tolerance
    i, j, k = i[fits], j[fits], k[fits]
    response = np.abs(peaks.response[i]) + np.abs(peaks.response[j]) + np.abs(peaks.response[k])
    modules = 0.5 * (log_leg[i, j] + log_leg[i, k]) - (size[i] + size[j] + size[k]) / 3.0
    hypotheses: list[Hypothesis] = []
    for t in np.argsort(-response, kind="stable"):
        versions = np.arange(MIN_VERSION, MAX_VERSION + 1)
        misfit = np.abs(np.log(10.0 + 4.0 * versions) - modules[t])
        for v in np.argsort(misfit, kind="stable"):
            if misfit[v] > cfg.scale_tolerance:
                break
            hypotheses.append(
                Hypothesis(
                    int(versions[v]),
                    _pose(peaks.position[i[t]], to[i[t], j[t]], to[i[t], k[t]], int(versions[v])),
                    float(response[t]),
                    bool(peaks.response[i[t]] < 0.0),
                )
            )
        if len(hypotheses) >= cfg.max_hypotheses:
            break
    return hypotheses


def _pose(
    corner: NDArray[np.float64], leg_u: NDArray[np.float64], leg_v: NDArray[np.float64], version: int
) -> NDArray[np.float64]:
    """Affine pose from the centre of the top-left finder pattern and the two legs."""
    per_u, per_v = leg_u / (10 + 4 * version), leg_v / (10 + 4 * version)
    origin = corner - 3.5 * per_u - 3.5 * per_v
    return np.array([[per_u[0], per_v[0], origin[0]], [per_u[1], per_v[1], origin[1]], [0.0, 0.0, 1.0]])
