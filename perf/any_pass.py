"""Prints that move, bend and are lit in any way: `evqr.simulate` only knows straight lines in still light.

The object's texture, the pixels' thresholds, their noise and the readout are the simulator's.  In between the
image is made frame by frame, so close that nothing moves further than a fraction of a pixel; the logarithm of
the light is linear between frames, and the photoreceptor a low-pass of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray
from evqr.simulate.config import CodePlacement, SceneConfig, SensorConfig
from evqr.simulate.geometry import Motion, similarity
from evqr.simulate.printed import PrintedSymbol, make_symbol
from evqr.simulate.sensor import RUN_IN_PX, RawEvents, add_noise, draw_pixels, read_out
from evqr.simulate.texture import TEXELS, Texture, draw_background, draw_object

RUN_IN_US = 2000.0
"""Time before the recording starts, in which the pixels forget their initial state."""

STEP_PX = 0.2
"""How far anything moves between frames, at most."""

Place = tuple[float, float, float]
Damage = Callable[[PrintedSymbol, np.random.Generator], PrintedSymbol]


@dataclass(frozen=True, kw_only=True)
class Pass:
    """A pass of an object, seen by a camera.

    Attributes
    ----------
    codes : sequence of CodePlacement
        Printed on the object.
    path : callable
        Of a time [us], gives where the object's centre is, x and y from the middle of the view [px], and how
        far the object is turned [deg].
    duration_us : int [us]
        Length of the recording.
    damage : callable, optional
        Gives a symbol as it is printed in the end.
    bend : callable, optional
        Of places from the object's centre, along its axes, as they are seen [px], gives those on its flat
        print, and whether there is any.
    light : callable, optional
        Of a time [us], the light that falls on everything, in full light.
    veil : callable, optional
        Of places (x, y) from the middle of the view [px], the light that a reflection adds there.
    sensor : SensorConfig
        The pixels.
    scene : mapping
        Further fields of `SceneConfig`: width, height, white, black, psf_px, seed.
    """

    codes: Sequence[CodePlacement]
    path: Callable[[float], Place]
    duration_us: int
    damage: Damage | None = None
    bend: Callable[[NDArray, NDArray], tuple[NDArray, NDArray, NDArray]] | None = None
    light: Callable[[float], float] | None = None
    veil: Callable[[NDArray, NDArray], NDArray] | None = None
    sensor: SensorConfig
    scene: dict[str, Any]


def simulate_pass(one: Pass) -> EventArray:
    """Simulate a pass."""
    scene = SceneConfig(codes=tuple(one.codes), direction=0.0, duration_us=one.duration_us, **one.scene)
    random = [np.random.default_rng(s) for s in np.random.SeedSequence(scene.seed).spawn(3)]
    symbols = [make_symbol(placement) for placement in scene.codes]
    if one.damage is not None:
        symbols = [one.damage(symbol, random[2]) for symbol in symbols]
    texture, ground = draw_object(scene, symbols, random[0]), draw_background(scene, random[0])
    thresholds = draw_pixels(scene, one.sensor, random[1]).reshape(-1, 3)
    raw = _pixels(one, _Seen(one, scene, texture, ground), thresholds)
    # of the motion noise and readout ask no more than when the recording begins and how long it is
    clock = Motion(
        plane_to_image=np.eye(3), direction=0.0, start=np.zeros(2), speed=RUN_IN_PX / RUN_IN_US,
        duration_us=one.duration_us,
    )  # fmt: skip
    return read_out(add_noise(raw, scene, one.sensor, clock, random[1]), scene, one.sensor, clock, random[1])


class _Seen:
    """What falls on the pixels at any time."""

    def __init__(self, one: Pass, scene: SceneConfig, texture: Texture, ground: NDArray) -> None:
        self._pass, self._texture, self._ground = one, texture, ground.ravel()
        y, x = np.indices(ground.shape, np.float32).reshape(2, -1)
        self.x, self.y = x - (scene.width - 1) / 2, y - (scene.height - 1) / 2
        self._veil = 0.0 if one.veil is None else one.veil(self.x, self.y).astype(np.float32)
        self._reach = np.abs(np.array(texture.origin) / TEXELS)

    def at(self, t_us: float) -> NDArray[np.float32]:
        """Give the light at a time."""
        one, texture = self._pass, self._texture
        x, y, turn = one.path(t_us)
        a, b = np.linalg.inv(similarity(turn, 1.0, np.array([x, y])))[:2].astype(np.float32)
        u, v = a[0] * self.x + a[1] * self.y + a[2], b[0] * self.x + b[1] * self.y + b[2]
        there: Any = True
        if one.bend is not None:
            u, v, there = one.bend(u, v)
        on = np.flatnonzero(there & (np.abs(u) < self._reach[0] - 1) & (np.abs(v) < self._reach[1] - 1))
        column = u[on] * np.float32(TEXELS[0]) + np.float32(texture.origin[0])
        row = v[on] * np.float32(TEXELS[1]) + np.float32(texture.origin[1])
        i, j = column.astype(np.int32), row.astype(np.int32)
        du, dv, flat = column - i, row - j, texture.light.ravel()
        at = j * texture.light.shape[1] + i
        top = flat[at] + du * (flat[at + 1] - flat[at])
        below = at + texture.light.shape[1]
        bottom = flat[below] + du * (flat[below + 1] - flat[below])
        cover = texture.cover_along[i] * texture.cover_across[j]
        light = self._ground.copy()
        light[on] = top + dv * (bottom - top) + (1.0 - cover) * light[on]
        light = light + self._veil
        return light if one.light is None else light * np.float32(max(one.light(t_us), 1e-3))


def _frames(one: Pass, half: float) -> NDArray[np.float64]:
    """Give the times of frames, close enough for what is so far from the object's centre."""
    fine = np.arange(-RUN_IN_US, one.duration_us + 10.0, 10.0)
    x, y, turn = np.array([one.path(t) for t in fine]).T
    moved = np.hypot(np.diff(x), np.diff(y)) + half * np.abs(np.deg2rad(np.diff(turn)))
    if one.light is not None:
        moved = np.maximum(moved, STEP_PX / 5)  # every 50 us
    way = np.concatenate([[0.0], np.cumsum(moved)])
    count = max(2, int(np.ceil(way[-1] / STEP_PX)))
    return np.interp(np.linspace(0.0, way[-1], count + 1), way, fine)


def _pixels(one: Pass, seen: _Seen, thresholds: NDArray[np.float32]) -> RawEvents:
    """Let the pixels look on, and give their events."""
    sensor, (up, down, level) = one.sensor, thresholds.T.copy()
    sizes = [float(np.hypot(*each.offset_px)) for each in one.codes]
    times = _frames(one, max(sizes, default=0.0) + 60.0)
    before_t, light = times[0], seen.at(times[0])
    before = np.log(light)
    filtered = before.copy()  # what the photoreceptor says
    base = filtered - level  # the reference of the last event
    free = np.full(len(base), -np.inf)
    found_t, found_address = [], []
    for t in times[1:]:
        passed = t - before_t
        now_light = seen.at(t)
        now = np.log(now_light)
        signal = now
        if sensor.tau_us > 0.0:
            rate = passed / sensor.tau_us * (0.5 * (light + now_light) if sensor.tau_follows_light else 1.0)
            decay = np.exp(-rate).astype(np.float32)
            ramp = (now - before) / rate
            signal = now - ramp + (filtered - before + ramp) * decay
        signal = signal.astype(np.float32)
        drift = np.float32(sensor.leak_hz * 1e-6 * passed) * up
        base -= drift
        change = signal - filtered
        waking = np.flatnonzero((free > before_t) & (free <= t))
        base[waking] = filtered[waking] + change[waking] * ((free[waking] - before_t) / passed)
        above = signal - base
        at = np.flatnonzero(((above >= up) | (above <= -down)) & (free <= t))
        while len(at):
            rising = signal[at] > base[at]
            target = base[at] + np.where(rising, up[at], -down[at])
            steep = np.where(np.abs(change[at]) < 1e-9, 1e-9, change[at])
            least = np.clip((free[at] - before_t) / passed, 0.0, 1.0)
            when = before_t + passed * np.clip((target - filtered[at]) / steep, least, 1.0)
            found_t.append(when)
            found_address.append(2 * at + rising)
            free[at] = when + sensor.refractory_us
            awake = free[at] <= t
            share = np.clip((free[at] - before_t) / passed, 0.0, 1.0).astype(np.float32)
            reset = filtered[at] + change[at] * share if sensor.refractory_us > 0.0 else target
            base[at] = np.where(awake, reset, signal[at])
            at = at[awake]
            above = signal[at] - base[at]
            at = at[(above >= up[at]) | (above <= -down[at])]
        before_t, before, light, filtered = t, now, now_light, signal
    return RawEvents(t=np.concatenate(found_t), address=np.concatenate(found_address).astype(np.int64))


# ---- damages


def painted(symbol: PrintedSymbol, where: NDArray[np.bool_], dark: bool) -> PrintedSymbol:
    """Paint modules over."""
    return replace(symbol, modules=np.where(where, np.uint8(dark), symbol.modules).astype(np.uint8))


def without_finder(which: int) -> Damage:
    """Leave out a finder pattern and its separator: 1 at the corner, 2 along u, 3 along v; 0: none."""

    def damage(symbol: PrintedSymbol, _: np.random.Generator) -> PrintedSymbol:
        where = np.zeros(symbol.modules.shape, bool)
        if which:
            anchor = symbol.space.anchors[which - 1]
            v, u = np.indices(where.shape) + 0.5
            where = (np.abs(u - anchor.u) < 4.2) & (np.abs(v - anchor.v) < 4.2)
        return painted(symbol, where, dark=False)

    return damage


def stained(share: float) -> Damage:
    """Cover a share of the symbol by a round stain, dark or light, anywhere."""

    def damage(symbol: PrintedSymbol, rng: np.random.Generator) -> PrintedSymbol:
        rows, columns = symbol.modules.shape
        v, u = np.indices((rows, columns)) + 0.5
        away = np.hypot(u - rng.uniform(0, columns), v - rng.uniform(0, rows))
        order = np.argsort(away, axis=None)[: round(share * away.size)]
        where = np.zeros(away.size, bool)
        where[order] = True
        return painted(symbol, where.reshape(rows, columns), dark=bool(rng.integers(2)))

    return damage


def hidden_leg(share: float) -> Damage:
    """Cover a share of the left side of a Data Matrix symbol, from one of its ends, three modules deep."""

    def damage(symbol: PrintedSymbol, rng: np.random.Generator) -> PrintedSymbol:
        rows, _ = symbol.modules.shape
        v, u = np.indices(symbol.modules.shape) + 0.5
        from_end = v if rng.integers(2) else rows - v
        return painted(symbol, (u < 2.0) & (from_end < share * rows), dark=False)

    return damage
