"""The strongest simple rival: an image by integrating events along their motion, then an ordinary decoder.

    events -> motion -> motion-compensated image E -> luminance by line integrals of E -> 8 bits -> zxing-cpp

Compensated events are the negative slope of the luminance along the motion (the linearised event generation
model that the paper's equation 1 is built on), so ``L(x) = -integral of E along the motion``.  A plain
integral drifts: thresholds differ between pixels and between ON and OFF events.  The integral here forgets,
and runs in both directions:

    L(s) = -1/2 integral of sign(s - r) exp(-|s - r| / memory) E(r) dr

which is the minimum of ``|dL/ds + E|^2 + |L / memory|^2``, the least-squares inverse with the mildest pull
towards grey.  Events are accumulated in a frame turned so that they move down the rows: a line integral is
then one recursion over rows, with no interpolation, and a decoder of QR codes does not mind the turn.  They
are counted in cells that are then blurred: Gaussian splats read no more, and take three times as long.

The defaults are the best of those tried on the project's simulator, over the presets ``clean``, ``slow`` and
``fast``: 96 % of the windows of 2 to 4 px of travel are read.  Pixels that lag by a module are beyond it.

Motion compensation follows Gallego, Rebecq, Scaramuzza, "A Unifying Contrast Maximization Framework for Event
Cameras" (CVPR 2018).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from evqr.clock import StageClock
from evqr.config import MotionConfig
from evqr.events.window import Window
from evqr.launched import LAUNCHED
from evqr.motion import Motion
from evqr.paper.methods.method import Outcome, Watch
from evqr.search.motion_estimate import MotionEstimate, estimate_motion
from evqr.workspace import Workspace
from evqr_kernels.registry import get_backend


@dataclass(frozen=True, kw_only=True)
class IntegrateConfig:
    """Settings of the rival.

    Attributes
    ----------
    cell_px : float [px]
        Size of a cell of the image.
    memory_px : float [px]
        Distance over which an integral forgets.
    contrast : float
        Standard deviations of the luminance from mid grey to black or white.
    """

    cell_px: float = 1.1
    memory_px: float = 15.0
    contrast: float = 2.4


@dataclass(frozen=True, eq=False)
class IntegrateReading:
    """What one window gave.

    Attributes
    ----------
    text : str, optional
        None when nothing was read.
    image : (Y, X) uint8, optional
        What the decoder saw: the motion is down its rows; None without motion.
    compute_ms : mapping of str to float [ms]
        By stage, and "total".
    """

    text: str | None
    image: NDArray[np.uint8] | None
    compute_ms: Mapping[str, float]


class Integrate:
    """Row 6a: compensated events (Gallego et al. 2018), integrated along the motion, zxing-cpp."""

    takes: Literal["events"] = "events"
    windows = 1
    matched = False

    def __init__(self) -> None:
        backend = get_backend("auto")
        backend.load("cpu", LAUNCHED)
        self._workspace = Workspace(backend, "cpu")

    def read(self, seen: Window, watch: Watch) -> Outcome:
        """Read one window."""
        reading = read_window(seen, workspace=self._workspace)
        return Outcome(image=reading.image, text=reading.text, converged=reading.image is not None)


def read_window(
    window: Window,
    *,
    workspace: Workspace,
    motion: Motion | None = None,
    cfg: IntegrateConfig | None = None,
    motion_cfg: MotionConfig | None = None,
) -> IntegrateReading:
    """Read a code from one window of events.

    Parameters
    ----------
    window : Window
        Events of one window.
    workspace : Workspace
        Whose buffers are used.
    motion : Motion, optional
        Of the window; None: estimated from its events, in the stage "motion".
    cfg : IntegrateConfig, optional
        Default `IntegrateConfig()`.
    motion_cfg : MotionConfig, optional
        Default `MotionConfig()`.
    """
    cfg, clock = cfg or IntegrateConfig(), StageClock()
    if motion is None:
        with clock("motion"):
            found = estimate_motion(window, motion_cfg or MotionConfig(), workspace=workspace)
            motion = found.motion if isinstance(found, MotionEstimate) else None
    if motion is None or motion.speed <= 0.0:
        return IntegrateReading(None, None, clock.total())
    with clock("accumulate"):
        slope = accumulate(window, motion, cfg, workspace=workspace)
    with clock("integrate"):
        luminance = integrate(slope, cfg.memory_px / cfg.cell_px)
    with clock("stretch"):
        image = stretch(luminance, cfg.contrast)
    with clock("decode"):
        text = decode(image)
    return IntegrateReading(text, image, clock.total())


def accumulate(
    window: Window, motion: Motion, cfg: IntegrateConfig, *, workspace: Workspace
) -> NDArray[np.float32]:
    """Motion-compensated image (Y, X) of a window, turned so that the motion is down the rows."""
    dx, dy = motion.direction.astype(np.float32)
    turn = np.array([[dy, -dx], [dx, dy]])
    corners = turn @ np.array([[0, window.width, 0, window.width], [0, 0, window.height, window.height]])
    left, top = corners.min(axis=1).astype(np.float32)
    width, height = np.ceil(np.ptp(corners, axis=1) / cfg.cell_px).astype(int)
    x = dy * window.x
    x -= dx * window.y
    x -= left
    y = dx * window.x
    y += dy * window.y
    y -= np.float32(motion.speed) * window.t
    y -= top
    # less their mean: as many ON as OFF, because the scene did not become brighter
    weight = window.p - window.p.mean(dtype=np.float32) if len(window) else window.p
    image = workspace.buffer("integrate slope", (1, height, width))
    cells = workspace.get(image)[0]
    cells.fill(0.0)
    workspace.backend.bin_events(
        workspace.put(x),
        workspace.put(y),
        workspace.put(weight),
        workspace.put(np.array([0, len(window)], np.int32)),
        cfg.cell_px,
        image,
    )
    workspace.backend.synchronize(workspace.device)
    return _smooth(cells)


def _smooth(cells: NDArray[np.float32]) -> NDArray[np.float32]:
    """Blur by 0.7 cells down the rows, where detail is lost for good, and by 1 cell across."""
    smooth = np.zeros_like(cells)
    inner = smooth[1:-1, 2:-2]
    np.add(cells[:-2, 2:-2], cells[2:, 2:-2], out=inner)
    inner += 2.0 * cells[1:-1, 2:-2]
    for _ in range(2):
        smooth[:, 1:-1] = smooth[:, :-2] + 2.0 * smooth[:, 1:-1] + smooth[:, 2:]
    return smooth


def integrate(slope: NDArray[np.float32], memory: float) -> NDArray[np.float32]:
    """Integrate ``-slope`` (Y, X) down the rows, from both ends, forgetting over ``memory`` rows.

    Row k of the result lies half a row behind row k of the slope: between rows an integral keeps the
    finest details that a difference of rows can show.
    """
    keep = np.float32(math.exp(-1.0 / memory))
    luminance = np.empty_like(slope)
    passed = np.zeros(slope.shape[1], np.float32)
    for row, out in zip(slope, luminance, strict=True):
        passed *= keep
        passed -= row
        out[:] = passed
    passed.fill(0.0)
    for row, out in zip(slope[::-1], luminance[::-1], strict=True):
        out += passed
        passed += row
        passed *= keep
    luminance *= np.float32(0.5)
    return luminance


def stretch(luminance: NDArray[np.float32], contrast: float) -> NDArray[np.uint8]:
    """8 bits, with ``contrast`` standard deviations on either side of the mean; quiet places do not count."""
    sample = luminance[::3, ::3]
    strength = np.abs(sample)
    sample = sample[strength > 0.05 * strength.max(initial=0.0)]
    if not len(sample):
        return np.full(luminance.shape, 128, np.uint8)
    scale = 127.5 / (contrast * max(float(sample.std()), 1e-12))
    image = luminance * np.float32(scale)
    image += np.float32(127.5 - scale * float(sample.mean()))
    return np.clip(image, 0.0, 255.0, out=image).astype(np.uint8)


@functools.cache
def _qr_code() -> Any:
    import zxingcpp

    return zxingcpp.barcode_formats_from_str("QRCode")


def decode(image: NDArray[np.uint8]) -> str | None:
    """Text of a code in an image, dark on light or light on dark; None without one."""
    import zxingcpp

    for barcode in zxingcpp.read_barcodes(image, formats=_qr_code(), try_rotate=False, try_invert=True):
        if barcode.valid and barcode.text:
            return barcode.text
    return None
