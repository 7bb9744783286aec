"""Recordings that show no code that evqr could read: what the simulator has no name for.

Labels on the simulator's object: blank, with squares of random light, or with a symbol of another kind that
zxing-cpp makes; and what a sensor tells of nothing at all.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray
from evqr.simulate.config import CodePlacement, SceneConfig, SensorConfig, sensor_of
from evqr.simulate.geometry import plan_motion
from evqr.simulate.printed import PrintedSymbol
from evqr.simulate.sensor import RawEvents, add_noise, draw_pixels, read_out, run_pixels
from evqr.simulate.texture import draw_background, draw_object
from evqr.symbol.space import CodeSpace, Symbology

NOISE = "noise"
"""No object either."""

SIDE = 29
"""Squares a side of a blank label and of a random one, as many as the modules of a QR code of version 3."""


def printed(kind: str, text: str, seed: int) -> NDArray[np.uint8]:
    """Give the squares (V, U) of a print, 1 dark: "box", "texture", or a symbol by zxing-cpp's name."""
    if kind == "box":
        return np.zeros((SIDE, SIDE), np.uint8)
    if kind == "texture":
        return np.random.default_rng(seed).integers(0, 2, (SIDE, SIDE), np.uint8)
    import zxingcpp

    barcode = zxingcpp.create_barcode(text, getattr(zxingcpp.BarcodeFormat, kind))
    image = np.array(zxingcpp.write_barcode_to_image(barcode, scale=1, add_quiet_zones=False))
    return (image == 0).astype(np.uint8)


def simulated(
    kind: str, *, text: str = "ANOTHER", angle: float = 0.0, module_px: float = 6.0, preset: str, **scene: Any
) -> EventArray:
    """Simulate a label with a print of a kind, or `NOISE`; further arguments as of `SceneConfig`."""
    squares = None if kind == NOISE else printed(kind, text, scene.get("seed", 0))
    return label(squares, angle=angle, module_px=module_px, preset=preset, **scene)


def label(
    squares: NDArray[np.uint8] | None,
    *,
    angle: float = 0.0,
    module_px: float = 6.0,
    quiet: int = 2,
    preset: str | SensorConfig,
    **scene: Any,
) -> EventArray:
    """Simulate a label with squares (V, U), 1 dark, and so many light ones around; None: no object."""
    sensor, view = sensor_of(preset), SceneConfig(**scene)
    random = [np.random.default_rng(s) for s in np.random.SeedSequence(view.seed).spawn(2)]
    if squares is None:
        raw, motion = RawEvents(t=np.empty(0), address=np.empty(0, np.int64)), plan_motion(view, [])
    else:
        symbol = _symbol(squares, angle, module_px, quiet)
        motion = plan_motion(view, [symbol])
        texture, background = draw_object(view, [symbol], random[0]), draw_background(view, random[0])
        raw = run_pixels(view, sensor, motion, texture, background, draw_pixels(view, sensor, random[1]))
    return read_out(add_noise(raw, view, sensor, motion, random[1]), view, sensor, motion, random[1])


def _symbol(modules: NDArray[np.uint8], angle: float, module_px: float, quiet: int) -> PrintedSymbol:
    nothing = np.zeros(modules.shape, np.int8)
    space = CodeSpace(
        symbology=Symbology.DATA_MATRIX,  # of no consequence
        version="",
        known=nothing.astype(bool),
        values=nothing,
        anchors=(),
        quiet_zone=quiet,
    )
    placement = CodePlacement(text="-", angle=angle, module_px=module_px)
    return PrintedSymbol(placement=placement, space=space, ec_level=None, mask=None, modules=modules)
