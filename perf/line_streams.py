"""Streams of a production line for `line.py`: parts that pass, one after another, and noise.

Parts are simulated once and kept in a folder for temporary files.  A sensor's threshold is chosen so that a
part fires at least as much as is asked for; events beyond that are lost at random, as a full readout loses
them.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from evqr import EventArray
from evqr.simulate import PRESETS, CodePlacement, SceneConfig, SensorConfig, simulate_scene

WIDTH, HEIGHT = 640, 480
SPEED_PX_MS = 5.0
PASS_US = 150_000
"""A part is in view for so long, and then nothing is for as long."""

SENSORS = {
    2.0: replace(PRESETS["fast"], threshold=0.6, background_hz=0.5, hot_fraction=0.0),
    10.0: replace(PRESETS["fast"], threshold=0.3, background_hz=4.0, hot_fraction=0.0),
    30.0: replace(PRESETS["fast"], threshold=0.1, background_hz=8.0, hot_fraction=0.0),
}
"""Sensor for each rate [million events a second]."""

MODULES_PX = (4.5, 5.0, 6.0, 5.5)
ANGLES = (20.0, -35.0, 5.0, 45.0)


@dataclass(frozen=True)
class Pass:
    """A part's events, and the noise until the next one comes.

    Attributes
    ----------
    text : str
        That of its code; empty where it has none.
    events : EventArray
        From 0 to twice `PASS_US`.
    leaves_us : int [us]
        When its code is not wholly in view any more.
    """

    text: str
    events: EventArray
    leaves_us: int


def noise(mev_s: float, duration_us: int, seed: int = 0) -> EventArray:
    """Give events at any time and place, so many million a second."""
    rng, count = np.random.default_rng(seed), round(mev_s * duration_us)
    return EventArray(
        np.sort(rng.integers(0, duration_us, count)),
        rng.integers(0, WIDTH, count).astype(np.uint16),
        rng.integers(0, HEIGHT, count).astype(np.uint16),
        rng.choice(np.array([-1, 1], np.int8), count),
        WIDTH,
        HEIGHT,
    )


def joined(one: EventArray, other: EventArray) -> EventArray:
    """Put events one behind the other."""
    t, x, y, p = (np.concatenate([getattr(one, name), getattr(other, name)]) for name in "txyp")
    return EventArray(t, x, y, p, one.width, one.height)


def passes(mev_s: float, count: int) -> list[Pass]:
    """Give so many parts, every third without a code, at a rate of events."""
    return [_pass(mev_s, SENSORS[mev_s], k) for k in range(count)]


def _pass(mev_s: float, sensor: SensorConfig, number: int) -> Pass:
    coded = number % 3 != 2
    placed = CodePlacement(
        text=f"LOT-{number:05d}",
        module_px=MODULES_PX[number % len(MODULES_PX)],
        angle=ANGLES[number % len(ANGLES)],
    )
    scene = SceneConfig(
        codes=(placed,) if coded else (), speed_px_ms=SPEED_PX_MS, duration_us=PASS_US, seed=number
    )
    key = hashlib.sha256(repr((mev_s, sensor, scene)).encode()).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / "evqr-line" / f"{key}.npz"
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        made = _simulated(mev_s, sensor, scene, placed.text if coded else "")
        part = path.with_suffix(".part")
        with part.open("wb") as file:
            columns = {name: getattr(made.events, name) for name in "txyp"}
            np.savez(file, **columns, about=json.dumps({"text": made.text, "leaves_us": made.leaves_us}))
        part.rename(path)
    with np.load(path) as kept:
        events = EventArray(kept["t"], kept["x"], kept["y"], kept["p"], WIDTH, HEIGHT)
        return Pass(**json.loads(str(kept["about"])), events=events)


def _simulated(mev_s: float, sensor: SensorConfig, scene: SceneConfig, text: str) -> Pass:
    made = simulate_scene(scene, sensor)
    quiet = noise(sensor.background_hz * WIDTH * HEIGHT * 1e-6, PASS_US, scene.seed)
    most = round(2 * PASS_US * mev_s) - len(quiet)
    seen = made.events
    if len(seen) > most:
        kept = np.sort(np.random.default_rng(scene.seed).permutation(len(seen))[:most])
        seen = EventArray(seen.t[kept], seen.x[kept], seen.y[kept], seen.p[kept], WIDTH, HEIGHT)
    leaves_us = 0
    if text:
        truth = made.truth["truth"]
        leaves_us = int(truth["t_us"][np.flatnonzero(truth["in_view"])[-1]])
    return Pass(text, joined(seen, replace(quiet, t=quiet.t + PASS_US)), leaves_us)


def chunks(events: EventArray, chunk_us: int, start_us: int = 0) -> Iterator[tuple[int, EventArray]]:
    """Cut events into chunks of a length, as a camera gives them: the end of each, and its events."""
    t = events.t + start_us
    first = 0
    for end_us in range(start_us + chunk_us, int(t[-1]) + chunk_us + 1, chunk_us):
        last = int(np.searchsorted(t, end_us))
        yield (
            end_us,
            EventArray(
                t[first:last], events.x[first:last], events.y[first:last], events.p[first:last], WIDTH, HEIGHT
            ),
        )
        first = last
