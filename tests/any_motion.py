"""A printed code that moves in any way: frame by frame, where `evqr.simulate` only knows straight lines.

Pixels are ideal ones: an event each time the logarithm of the light has changed by a threshold, at a time
interpolated between frames.
"""

import math

import numpy as np

from evqr.events.array import EventArray
from evqr.simulate.config import CodePlacement
from evqr.simulate.printed import make_symbol

FINE, QUIET, DARK, LIGHT = 12, 4, 0.12, 0.9
"""Texture samples a module, modules around the code that are light, and what is dark and light."""


def similarity(centre, size, module_px, angle=0.0):
    """Pose (3, 3) of a code of ``size`` modules with its centre at a place [px], turned by an angle [rad]."""
    c, s = module_px * math.cos(angle), module_px * math.sin(angle)
    h = size / 2.0
    return np.array([[c, -s, centre[0] - c * h + s * h], [s, c, centre[1] - s * h - c * h], [0.0, 0.0, 1.0]])


def tilted(pose, size, turn, axis, focal_modules=60.0):
    """A pose of a code that is tilted by an angle about an axis through its centre [rad]."""
    h = size / 2.0
    to_centre = np.array([[1.0, 0.0, -h], [0.0, 1.0, -h], [0.0, 0.0, 1.0]])
    c, s = math.cos(axis), math.sin(axis)
    along = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    lean = np.array([[1.0, 0, 0], [0, math.cos(turn), 0], [0, math.sin(turn) / focal_modules, 1.0]])
    return pose @ np.linalg.inv(to_centre) @ along.T @ lean @ along @ to_centre


def _texture(placement, blur_modules, damage):
    """Logarithms of light over the code and what is around it, blurred as by optics."""
    symbol = make_symbol(placement)
    modules = np.where(damage(symbol.modules) != 0, DARK, LIGHT)
    fine = np.kron(np.pad(modules, QUIET + 2, constant_values=LIGHT), np.ones((FINE, FINE)))
    reach = math.ceil(3 * blur_modules * FINE)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (blur_modules * FINE)) ** 2)
    kernel /= kernel.sum()
    for _ in range(2):
        fine = np.apply_along_axis(np.convolve, 1, fine, kernel, "same").T
    return np.log(np.maximum(fine, DARK)), len(modules)


def moving_code(
    pose, duration_us, *, text="EVQR-07", version=2, ec="M", width=220, height=180, frame_us=40.0,
    threshold=0.25, blur_modules=0.15, noise_hz=2.0, seed=0, start_us=0,
    damage=lambda modules: modules,
):  # fmt: skip
    """Events of a code whose pose is a function of time [us].

    The ground around the code is as light as its quiet zone, so that no edge but the code's is seen.
    ``damage`` gives the modules, 1 dark, that are printed in place of a symbol's.
    """
    rng = np.random.default_rng(seed)
    texture, _ = _texture(CodePlacement(text=text, version=version, ec=ec), blur_modules, damage)
    y, x = np.mgrid[:height, :width].reshape(2, -1).astype(np.float64)
    up, down = np.abs(rng.normal(threshold, 0.03 * threshold, (2, len(x))))
    rows, columns = texture.shape

    def light(t_us):
        u, v, w = (a * x + b * y + c for a, b, c in np.linalg.inv(pose(t_us)))
        u = np.clip((u / w + QUIET + 2) * FINE - 0.5, 0.0, columns - 1.001)
        v = np.clip((v / w + QUIET + 2) * FINE - 0.5, 0.0, rows - 1.001)
        i, j = u.astype(int), v.astype(int)
        a, b = u - i, v - j
        low = (1.0 - a) * texture[j, i] + a * texture[j, i + 1]
        high = (1.0 - a) * texture[j + 1, i] + a * texture[j + 1, i + 1]
        return (1.0 - b) * low + b * high

    times = np.arange(0.0, duration_us + frame_us, frame_us)
    before = light(times[0])
    level = before + rng.uniform(-0.5, 0.5, len(x)) * threshold
    found = []
    for t in times[1:]:
        now = light(t)
        change = np.where(np.abs(now - before) < 1e-9, 1e-9, now - before)
        moving = np.abs(now - level) > 0.5 * threshold
        while moving.any():
            at = np.flatnonzero(moving)
            rising = now[at] > level[at]
            target = level[at] + np.where(rising, up[at], -down[at])
            crossed = np.where(rising, target <= now[at], target >= now[at])
            at, target, rising = at[crossed], target[crossed], rising[crossed]
            if not len(at):
                break
            share = np.clip((target - before[at]) / change[at], 0.0, 1.0)
            found.append((t - frame_us + share * frame_us, at, np.where(rising, 1, -1)))
            level[at] = target
            moving = np.zeros(len(x), bool)
            moving[at] = True
        before = now
    n_noise = rng.poisson(noise_hz * 1e-6 * duration_us * len(x))
    found.append(
        (rng.uniform(0, duration_us, n_noise), rng.integers(0, len(x), n_noise), rng.choice([-1, 1], n_noise))
    )
    t, at, p = (np.concatenate(column) for column in zip(*found, strict=True))
    order = np.argsort(t, kind="stable")
    t, at, p = t[order].astype(np.int64) + start_us, at[order], p[order].astype(np.int8)
    return EventArray(t, (at % width).astype(np.uint16), (at // width).astype(np.uint16), p, width, height)
