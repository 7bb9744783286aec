"""The table of hard passes: what is varied, what passes at a value, and up to where it should be read.

A sweep is one entry of `SWEEPS`.  Scenes are made by `evqr.simulate`, or by `any_pass.py` where something
other than a flat object in still light moves straight on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from any_pass import Pass, hidden_leg, simulate_pass, stained, without_finder
from numpy.typing import NDArray

from evqr.events.array import EventArray
from evqr.simulate import CodePlacement, SensorConfig, simulate, simulate_scene
from evqr.simulate.config import SceneConfig
from evqr.symbology import Symbology

SMALL: dict[str, Any] = {"width": 320, "height": 240}
TEXT = "LOT 4711"
GOOD = SensorConfig(
    threshold_spread=0.03, tau_us=60.0, refractory_us=50.0, background_hz=3.0, drop_rate=0.05, jitter_us=10.0
)
"""Pixels of most sweeps: something of everything."""

Made = tuple[EventArray, frozenset[str]]


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """What makes a pass hard, and how hard.

    Attributes
    ----------
    name, parameter, unit : str
        What it is called, what is varied, and in which unit.
    values : tuple of float
        From easy to hard.
    make : callable
        Gives events and texts of a value and a seed.
    goal : float
        Value up to which it should be read.
    what : str
        "whole", "alone" or both: what the goal is about.
    share : float
        Of the windows alone that are to be read at the goal.
    options : mapping
        Fields of `ReadConfig` for both.
    """

    name: str
    parameter: str
    unit: str
    values: tuple[float, ...]
    make: Callable[[float, int], Made]
    goal: float
    what: str = "whole alone"
    share: float = 0.9
    options: Mapping[str, Any] = field(default_factory=dict)


# ---- what passes


def ways(seed: int) -> dict[str, float]:
    """Draw how a code lies and where it moves."""
    rng = np.random.default_rng([77, seed])
    return {"angle": float(rng.uniform(0.0, 360.0)), "direction": float(rng.uniform(0.0, 360.0))}


def straight(seed: int, *, travel_px: float = 20.0, speed_px_ms: float = 4.0, **more: Any) -> Made:
    """Let a QR code pass straight on."""
    text = more.pop("text", TEXT)
    given = {"ec": "M", "module_px": 5.0, "preset": GOOD, **ways(seed), **SMALL, **more}
    duration_us = round(1000.0 * travel_px / speed_px_ms)
    made = simulate(text, speed_px_ms=speed_px_ms, duration_us=duration_us, seed=seed, threads=1, **given)
    return made.events, frozenset([text])


def shown(seed: int, *, black: float = 0.10, white: float = 0.85, sensor: SensorConfig = GOOD) -> Made:
    """Let a QR code pass that is printed in other greys."""
    way = ways(seed)
    scene = SceneConfig(
        codes=(CodePlacement(text=TEXT, module_px=5.0, angle=way["angle"]),), direction=way["direction"],
        speed_px_ms=4.0, duration_us=5000, black=black, white=white, seed=seed, **SMALL,
    )  # fmt: skip
    return simulate_scene(scene, sensor, threads=1).events, frozenset([TEXT])


def anyhow(
    seed: int,
    *,
    path: Callable[[float], tuple[float, float, float]] | None = None,
    duration_us: int = 5000,
    sensor: SensorConfig = GOOD,
    scene: Mapping[str, Any] | None = None,
    **more: Any,
) -> Made:
    """Let a code pass that is damaged, bent, lit, or moves in any way; a QR code of 2-H by default."""
    placed = {"text": TEXT, "version": 2, "ec": "H", "module_px": 5.0, "angle": ways(seed)["angle"]}
    for name in [name for name in more if name in CodePlacement.__dataclass_fields__]:
        placed[name] = more.pop(name)
    if placed.get("symbology"):
        del placed["ec"]
    events = simulate_pass(
        Pass(
            codes=[CodePlacement(**placed)],
            path=path or moving(seed, 4.0, duration_us),
            duration_us=duration_us,
            sensor=sensor,
            scene={**SMALL, "seed": seed, **(scene or {})},
            **more,
        )
    )
    return events, frozenset([str(placed["text"])])


def moving(
    seed: int, speed_px_ms: float, duration_us: int, to: tuple[float, float] = (0.0, 0.0)
) -> Callable[[float], tuple[float, float, float]]:
    """Give a straight path, its middle at a place from the middle of the view [px]."""
    way = math.radians(ways(seed)["direction"])

    def path(t_us: float) -> tuple[float, float, float]:
        s = 1e-3 * speed_px_ms * (t_us - 0.5 * duration_us)
        return to[0] + s * math.cos(way), to[1] + s * math.sin(way), 0.0

    return path


def missing_finder(which: float, seed: int) -> Made:
    """Leave one finder pattern out."""
    return anyhow(seed, damage=without_finder(round(which)))


def cut_corner(share: float, seed: int) -> Made:
    """Let a code lie across a corner of the view, so that so much of its area is out of view."""
    side = 25 * 5.0
    # a code on its tip before an edge of the view: a corner of depth d has the area d^2
    depth = side * math.sqrt(share)
    to = (-0.5 * SMALL["width"] + side / math.sqrt(2.0) - depth + 10.0, 0.0)
    which = seed % 4
    return anyhow(seed, angle=45.0 + 90.0 * which, path=_along_the_edge(to))


def _along_the_edge(to: tuple[float, float]) -> Callable[[float], tuple[float, float, float]]:
    return lambda t_us: (to[0] - 10.0 + 0.0, to[1] + 4e-3 * (t_us - 2500.0), 0.0)


def hidden(share: float, seed: int) -> Made:
    """Hide part of a Data Matrix' L."""
    return anyhow(
        seed, symbology=Symbology.DATA_MATRIX, version="18x18", module_px=6.0, damage=hidden_leg(share)
    )


def few_events(count: float, seed: int) -> Made:
    """Let pixels cause so many events an edge."""
    sensor = SensorConfig(threshold=math.log(0.85 / 0.10) / count, threshold_spread=0.03, background_hz=3.0)
    return straight(seed, preset=sensor, travel_px=24.0)


def flickering(depth: float, seed: int) -> Made:
    """Light a code by a lamp whose light goes to 1 - depth and back, 100 times a second."""
    return anyhow(
        seed,
        duration_us=20_000,
        light=lambda t: 1.0 - depth * (0.5 + 0.5 * math.sin(2e-4 * math.pi * t)),
        path=moving(seed, 3.0, 20_000),
    )


def contrasted(contrast: float, seed: int) -> Made:
    """Print a code in greys whose logarithms are so far apart."""
    return shown(seed, black=0.44 * math.exp(-0.5 * contrast), white=0.44 * math.exp(0.5 * contrast))


def glaring(strength: float, seed: int) -> Made:
    """Let light be reflected by a place that a code passes: so many times its white."""

    def veil(x: NDArray, y: NDArray) -> NDArray:
        return 0.85 * strength * np.exp(-0.5 * ((x - 15.0) ** 2 + (y + 10.0) ** 2) / 20.0**2)

    return anyhow(seed, veil=veil)


def labels(count: float, seed: int) -> Made:
    """Let so many codes pass side by side on one label."""
    side = math.ceil(math.sqrt(count))
    way, pitch = ways(seed), 108.0
    codes = []
    for k in range(round(count)):
        row, column = divmod(k, side)
        at = [pitch * (each - 0.5 * (side - 1)) for each in (column, row)]
        codes.append(
            CodePlacement(
                text=f"LABEL {k:02d}", version=1, module_px=3.6, angle=0.0, offset_px=(at[0], at[1])
            )
        )
    direction = 5.0 * way["direction"] / 360.0
    made = simulate(
        codes=[_turned(code, direction) for code in codes], preset=GOOD, direction=direction, speed_px_ms=4.0,
        duration_us=10_000, width=640, height=480, seed=seed, threads=1,
    )  # fmt: skip
    return made.events, frozenset(code.text for code in codes)


def _turned(code: CodePlacement, direction: float) -> CodePlacement:
    """Give a code that is turned with the label about its middle, against the direction of travel."""
    (x, y), turn = code.offset_px, math.radians(25.0)
    at = x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn)
    return replace(code, angle=direction + 25.0, offset_px=at)


def sized(width_px: float, seed: int) -> Made:
    """Let a Data Matrix symbol of 10 x 10 or, large, a QR code of version 5 pass, so many px wide."""
    if width_px < 300:
        return straight(
            seed, text="4711", symbology=Symbology.DATA_MATRIX, version="10x10", module_px=width_px / 10.0
        )
    way = {"angle": 1.0 + 90.0 * (seed % 4), "direction": 8.0 - 180.0 * (seed % 2)}  # or it is not in view
    return straight(seed, version=5, module_px=width_px / 37.0, width=1280, height=720, **way)


def faster(change: float, seed: int) -> Made:
    """Let the speed change by a share, from first to last, within 10 ms."""
    way = math.radians(ways(seed)["direction"])

    def path(t_us: float) -> tuple[float, float, float]:
        s = 4e-3 * (t_us - 5000.0) * (1.0 + 0.5 * change * t_us / 10_000.0)
        return s * math.cos(way), s * math.sin(way), 0.0

    return anyhow(seed, duration_us=10_000, path=path)


def shaken(amplitude_px: float, seed: int) -> Made:
    """Shake a code across its way, 200 times a second."""
    way = math.radians(ways(seed)["direction"])

    def path(t_us: float) -> tuple[float, float, float]:
        s, off = 4e-3 * (t_us - 5000.0), amplitude_px * math.sin(4e-4 * math.pi * t_us)
        return s * math.cos(way) - off * math.sin(way), s * math.sin(way) + off * math.cos(way), 0.0

    return anyhow(seed, duration_us=10_000, path=path)


def turning(radius_px: float, degrees_ms: float, seed: int) -> Made:
    """Turn a code with a table, about a point so far away."""
    first = ways(seed)["direction"]

    def path(t_us: float) -> tuple[float, float, float]:
        turn = first + 1e-3 * degrees_ms * (t_us - 3000.0)
        at, middle = math.radians(turn), math.radians(first)
        x, y = (radius_px * (f(at) - f(middle)) for f in (math.cos, math.sin))
        return x, y, turn

    return anyhow(seed, duration_us=6000, path=path, module_px=4.0, scene={"width": 400, "height": 320})


def tilted(degrees: float, seed: int) -> Made:
    """Tilt a code."""
    return straight(seed, version=2, ec="H", tilt=degrees)


def curved(radius_over_width: float, seed: int) -> Made:
    """Print a code on a cylinder that passes, whose axis lies in the plane of the image."""
    radius, axis = (
        np.float32(radius_over_width * 25 * 4.0),
        np.float32(math.radians(ways(seed)["angle"] + 20)),
    )

    def bend(u: NDArray, v: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        cos, sin = np.cos(axis), np.sin(axis)
        along, across = cos * u + sin * v, cos * v - sin * u
        flat = radius * np.arcsin(np.clip(across / radius, -0.98, 0.98))
        return cos * along - sin * flat, sin * along + cos * flat, np.abs(across) < 0.98 * radius

    return anyhow(seed, module_px=4.0, bend=bend)


def small(module_px: float, seed: int) -> Made:
    """Print a code in small modules."""
    return straight(seed, version=2, ec="H", module_px=module_px)


def slow_pixels(bandwidth_hz: float, seed: int, *, follows: bool = False) -> Made:
    """See a code of 310 modules a second by pixels of a bandwidth, in full light or in any."""
    sensor = SensorConfig(
        threshold_spread=0.03, tau_us=1e6 / (2.0 * math.pi * bandwidth_hz), tau_follows_light=follows,
        background_hz=1.0,
    )  # fmt: skip
    return straight(seed, version=2, ec="H", preset=sensor, speed_px_ms=1.55, travel_px=60.0)


def fast(
    bandwidth_hz: float, readout_meps: float, modules_per_s: float, seed: int, *, follows: bool = False
) -> Made:
    """Let a code pass fast, before pixels of a bandwidth, in full light or in any."""
    sensor = SensorConfig(
        threshold_spread=0.03, tau_us=1e6 / (2.0 * math.pi * bandwidth_hz), tau_follows_light=follows,
        background_hz=5.0, readout_meps=readout_meps,
    )  # fmt: skip
    return straight(seed, version=2, ec="H", preset=sensor, speed_px_ms=5e-3 * modules_per_s, travel_px=60.0)


WINDOW_20 = {"window_us": 12_900}
_SPEEDS = (10_000.0, 20_000.0, 30_000.0, 50_000.0, 70_000.0, 100_000.0, 140_000.0)
_ROWS = (
    Sweep(
        name="missing-finder", parameter="finder pattern left out", unit="0 none, 1 corner, 2, 3 far ends",
        values=(0, 1, 2, 3), make=missing_finder, goal=3,
    ),
    Sweep(
        name="stain", parameter="area under a stain", unit="share", goal=0.3,
        values=(0.0, 0.1, 0.2, 0.25, 0.3, 0.35), make=lambda v, seed: anyhow(seed, damage=stained(v)),
    ),
    Sweep(
        name="cut", parameter="area out of view", unit="share", goal=0.3,
        values=(0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3), make=cut_corner,
    ),
    Sweep(
        name="data-matrix-leg", parameter="hidden part of a leg of the L", unit="share", goal=0.5,
        values=(0.0, 0.25, 0.5, 0.75), make=hidden,
    ),
    Sweep(
        name="few-events", parameter="events an edge", unit="events", goal=2.0, share=0.5,
        values=(5.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.1), make=few_events,
    ),
    Sweep(
        name="flicker", parameter="depth at 100 Hz", unit="share", goal=0.9,
        values=(0.0, 0.3, 0.5, 0.7, 0.9), make=flickering,
    ),
    Sweep(
        name="contrast", parameter="contrast", unit="log(white / black)", goal=0.45,
        values=(1.6, 1.0, 0.7, 0.55, 0.45, 0.35), make=contrasted,
    ),
    Sweep(
        name="glare", parameter="reflected light", unit="of white", goal=4.0,
        values=(0.0, 1.0, 2.0, 4.0, 8.0), make=glaring,
    ),
    Sweep(
        name="labels", parameter="codes on a label", unit="codes", goal=16, what="whole",
        values=(1, 4, 9, 16), make=labels,
    ),
    Sweep(
        name="small-codes", parameter="width of the code", unit="px", goal=45.0,
        values=(80.0, 60.0, 50.0, 45.0, 40.0, 36.0), make=sized,
    ),
    Sweep(
        name="large-codes", parameter="width of the code", unit="px", goal=700.0,
        values=(400.0, 550.0, 700.0), make=sized,
    ),
    Sweep(
        name="speed-change", parameter="change of speed in 10 ms", unit="share", goal=0.5,
        values=(0.0, 0.25, 0.5, 0.75, 1.0), make=faster,
    ),
    Sweep(
        name="shake", parameter="amplitude at 200 Hz", unit="px", goal=4.0,
        values=(0.0, 1.0, 2.0, 4.0, 6.0), make=shaken,
    ),
    Sweep(
        name="turning-60", parameter="turns about a point 60 px away", unit="degrees/ms", goal=6.0,
        values=(1.0, 2.0, 3.0, 4.0, 6.0, 8.0), make=partial(turning, 60.0),
    ),
    Sweep(
        name="turning-120", parameter="turns about a point 120 px away", unit="degrees/ms", goal=3.0,
        values=(0.5, 1.0, 1.5, 2.0, 3.0, 4.0), make=partial(turning, 120.0),
    ),
    Sweep(
        name="tilt", parameter="tilt", unit="degrees", goal=45.0,
        values=(0.0, 20.0, 35.0, 40.0, 45.0, 50.0), make=tilted,
    ),
    Sweep(
        name="cylinder", parameter="radius over code width", unit="", goal=0.5,
        values=(1.0, 0.7, 0.62, 0.56, 0.5, 0.45), make=curved,
    ),
    Sweep(
        name="small-modules", parameter="module", unit="px", goal=2.5,
        values=(4.0, 3.2, 3.0, 2.7, 2.5, 2.2, 2.0), make=small,
    ),
    Sweep(
        name="slow-pixels", parameter="bandwidth at 310 modules/s", unit="Hz", goal=30.0, share=0.6,
        values=(300.0, 150.0, 100.0, 60.0, 40.0, 30.0, 20.0), make=slow_pixels, options=WINDOW_20,
    ),
    Sweep(
        name="speed-15khz", parameter="speed, pixels of 15 kHz", unit="modules/s", goal=100_000.0,
        values=_SPEEDS, make=partial(fast, 15_000.0, 0.0),
    ),
    Sweep(
        name="speed-readout", parameter="speed, 15 kHz and 300 million events/s", unit="modules/s",
        goal=100_000.0, values=_SPEEDS, make=partial(fast, 15_000.0, 300.0),
    ),
    Sweep(
        name="speed-5khz", parameter="speed, pixels of 5 kHz", unit="modules/s", goal=30_000.0,
        values=(5_000.0, 10_000.0, 17_000.0, 24_000.0, 30_000.0, 40_000.0), make=partial(fast, 5_000.0, 0.0),
    ),
    Sweep(
        name="speed-2.5khz", parameter="speed, pixels of 2.5 kHz", unit="modules/s", goal=20_000.0,
        values=(2_500.0, 5_000.0, 10_000.0, 14_000.0, 20_000.0, 28_000.0), make=partial(fast, 2_500.0, 0.0),
    ),
    # pixels as slow as that in full light, and slower by as much as it is darker
    Sweep(
        name="slow-pixels-by-light", parameter="bandwidth in full light at 310 modules/s", unit="Hz",
        goal=30.0, share=0.6, options=WINDOW_20, values=(300.0, 150.0, 100.0, 60.0, 40.0, 30.0),
        make=partial(slow_pixels, follows=True),
    ),
    Sweep(
        name="speed-15khz-by-light", parameter="speed, 15 kHz in full light", unit="modules/s",
        goal=100_000.0, values=_SPEEDS[2:6], make=partial(fast, 15_000.0, 0.0, follows=True),
    ),
    Sweep(
        name="speed-5khz-by-light", parameter="speed, 5 kHz in full light", unit="modules/s", goal=30_000.0,
        values=(10_000.0, 17_000.0, 24_000.0, 30_000.0), make=partial(fast, 5_000.0, 0.0, follows=True),
    ),
    Sweep(
        name="speed-2.5khz-by-light", parameter="speed, 2.5 kHz in full light", unit="modules/s",
        goal=20_000.0, values=(5_000.0, 10_000.0, 14_000.0, 20_000.0),
        make=partial(fast, 2_500.0, 0.0, follows=True),
    ),
)  # fmt: skip
SWEEPS: Mapping[str, Sweep] = {sweep.name: sweep for sweep in _ROWS}
