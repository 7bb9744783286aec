"""A scene and a sensor in, events and truth out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from evqr.events.array import EventArray
from evqr.simulate.config import (
    PRESET_SPEEDS_PX_MS,
    CodePlacement,
    EcLevel,
    SceneConfig,
    SensorConfig,
    sensor_of,
)
from evqr.simulate.geometry import in_a_row, plan_motion
from evqr.simulate.printed import make_symbol, parts_of_a_message
from evqr.simulate.sensor import add_noise, draw_pixels, read_out, run_pixels
from evqr.simulate.texture import draw_background, draw_object
from evqr.simulate.truth import truth_of
from evqr.simulate.turntable import on_turntable
from evqr.symbol.space import Version
from evqr.symbology import Symbology


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulation:
    """A simulated recording.

    Attributes
    ----------
    events : EventArray
        Times from 0 to below the duration.
    truth : mapping of str to mapping
        "truth", "truth2", ..., one a code, to its fields (`truth_of`); empty without codes.
    scene : SceneConfig
        The scene that was simulated.
    sensor : SensorConfig
        The pixels that saw it.
    """

    events: EventArray
    truth: Mapping[str, Mapping[str, Any]]
    scene: SceneConfig
    sensor: SensorConfig


def simulate(
    text: str | Sequence[str] = "EVQR",
    *,
    symbology: Symbology | str = Symbology.QR_CODE,
    version: Version | None = None,
    ec: EcLevel = "M",
    mask: int | None = None,
    angle: float = 30.0,
    direction: float = 0.0,
    speed_px_ms: float | None = None,
    module_px: float = 6.0,
    preset: str | SensorConfig = "clean",
    turn_radius_px: float | None = None,
    tilt: float = 0.0,
    invert: bool = False,
    gs1: bool = False,
    eci: int | None = None,
    charset: str | None = None,
    append: bool = False,
    application: str | None = None,
    code: bool = True,
    codes: Sequence[CodePlacement] | None = None,
    duration_us: int | None = None,
    start: tuple[float, float] | None = None,
    width: int = 640,
    height: int = 480,
    seed: int = 0,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Simulation:
    """Simulate a printed code that passes an event camera.

    Parameters
    ----------
    text : str or sequence of str
        What the code says; several make as many codes, one behind the other.
    symbology, version, ec, mask, angle, module_px, invert, gs1, eci, charset : as in `CodePlacement`
        Of the codes.
    append : bool
        The codes are the parts of one message (structured append).
    application : as in `CodePlacement`
        Of the codes.
    direction, turn_radius_px, tilt, duration_us, start, width, height, seed : as in `SceneConfig`
        Of the scene.
    speed_px_ms : float [px/ms], optional
        Speed in the image; None: the preset's, of `PRESET_SPEEDS_PX_MS`, that of "clean" for a sensor of your
        own.
    preset : str or SensorConfig
        A name in `PRESETS`, or a sensor.
    code : bool
        False: no code, but things that look a little like one.
    codes : sequence of CodePlacement, optional
        Codes on the object, in place of those that the arguments above describe.
    threads : int, optional
        Number of threads; None: one a core, at most 8.  The result does not depend on it.
    progress : callable, optional
        Called with the parts of the image that are done, and how many there are.

    Returns
    -------
    simulation : Simulation
        Events and truth.

    Raises
    ------
    UsageError
        For values out of range, a text that its version cannot hold, a code larger than the view, codes that
        overlap.
    """
    sensor = sensor_of(preset)
    if speed_px_ms is None:
        speed_px_ms = PRESET_SPEEDS_PX_MS[preset] if isinstance(preset, str) else PRESET_SPEEDS_PX_MS["clean"]
    if codes is None:
        texts = [text] if isinstance(text, str) else text
        alike = CodePlacement(
            text="-",
            symbology=symbology,
            version=version,
            ec=ec,
            mask=mask,
            module_px=module_px,
            angle=angle,
            invert=invert,
            gs1=gs1,
            eci=eci,
            charset=charset,
            application=application,
        )
        placements = [replace(alike, text=each) for each in texts] if code else []
        codes = in_a_row(parts_of_a_message(placements) if append else placements, direction)
    scene = SceneConfig(
        codes=tuple(codes),
        width=width,
        height=height,
        direction=direction,
        speed_px_ms=speed_px_ms,
        start=start,
        duration_us=duration_us,
        turn_radius_px=turn_radius_px,
        tilt=tilt,
        seed=seed,
    )
    return simulate_scene(scene, sensor, threads=threads, progress=progress)


def simulate_scene(
    scene: SceneConfig,
    sensor: SensorConfig,
    *,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Simulation:
    """Simulate a scene in front of a sensor.

    Parameters
    ----------
    scene : SceneConfig
        The object, its codes and how it moves.
    sensor : SensorConfig
        The pixels that see it.
    threads : int, optional
        Number of threads; None: one a core, at most 8.  The result does not depend on it.
    progress : callable, optional
        Called with the parts of the image that are done, and how many there are.

    Returns
    -------
    simulation : Simulation
        Events and truth.
    """
    symbols = [make_symbol(placement) for placement in scene.codes]
    motion = plan_motion(scene, symbols)
    # Streams of their own, so that a change of the sensor leaves the scene as it is.
    scene_rng, sensor_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(scene.seed).spawn(2))
    texture = draw_object(scene, symbols, scene_rng)
    if motion.turns:
        texture = on_turntable(texture, motion, scene_rng)
    background = draw_background(scene, scene_rng)
    pixel = draw_pixels(scene, sensor, sensor_rng)
    raw = run_pixels(scene, sensor, motion, texture, background, pixel, threads, progress)
    noisy = add_noise(raw, scene, sensor, motion, sensor_rng)
    events = read_out(noisy, scene, sensor, motion, sensor_rng)
    return Simulation(events=events, truth=truth_of(scene, motion, symbols), scene=scene, sensor=sensor)
