#!/usr/bin/env python3
"""Print the errors of the motion from cold on simulated scenes; exit 1 when speeds are biased.

usage: motion_errors.py [--scene NAME ...] [--windows 50]

A row a scene: of windows spread over a passage, how many give a motion, the median and the root mean square
of the error of the speed, signed along the true motion, and of what is across it, in per cent of the speed.
"beside" scenes have a second object that moves another way; the error is against the nearer of the two.

Required: on clean scenes with one object a motion in each window, and a median error of the speed of at most
1 %.
"""

from __future__ import annotations

import argparse
import math
import sys

import numpy as np

from evqr.config import MotionConfig
from evqr.events.array import EventArray
from evqr.events.buffer import EventBuffer
from evqr.launched import LAUNCHED
from evqr.search.motion_estimate import MotionEstimate, find_motion
from evqr.simulate import simulate
from evqr.workspace import Workspace
from evqr_kernels.registry import get_backend

REQUIRED_PERCENT = 1.0
TRAVEL_PX = 60.0
SIZE = {"width": 480, "height": 360}

#: Version, module [px], angle and direction [deg], speed [px/ms], preset.
SCENES = {
    "clean-2-30": (2, 6.0, 30.0, 10.0, 4.0, "clean"),
    "clean-2-45": (2, 6.0, 45.0, 320.0, 2.0, "clean"),
    "clean-2-0": (2, 6.0, 0.0, 0.0, 1.0, "clean"),
    "clean-4-63": (4, 4.5, 63.0, 200.0, 8.0, "clean"),
    "clean-6-17": (6, 4.0, 17.0, 110.0, 2.0, "clean"),
    "clean-1-20": (1, 8.0, 20.0, 20.0, 4.0, "clean"),
    "clean-2-75": (2, 5.0, 75.0, 135.0, 0.5, "clean"),
    "clean-3-10": (3, 3.5, 10.0, 250.0, 10.0, "clean"),
    "slow-2-0": (2, 6.0, 0.0, 0.0, 1.0, "slow"),
    "slow-6-17": (6, 4.0, 17.0, 110.0, 2.0, "slow"),
    "fast-2-30": (2, 6.0, 30.0, 10.0, 5.0, "fast"),
    "fast-4-63": (4, 4.5, 63.0, 200.0, 8.0, "fast"),
    "hard-2-40": (2, 5.0, 40.0, 70.0, 6.0, "hard"),
}

#: Direction and speed of a second object, by the scene it passes beside.
BESIDE = {"clean-2-30": (190.0, 2.0), "fast-2-30": (100.0, 5.0)}


def passage(name: str) -> tuple[EventArray, list[np.ndarray]]:
    """Simulate a scene; give its events and the velocities of what moves [px/s]."""
    scene, _, beside = name.partition(" ")
    version, module_px, angle, direction, speed, preset = SCENES[scene]
    duration_us = round(1000 * TRAVEL_PX / speed)
    made = simulate(
        "MOTION", version=version, ec="L", module_px=module_px, angle=angle, direction=direction,
        speed_px_ms=speed, preset=preset, duration_us=duration_us, seed=7, **SIZE,
    )  # fmt: skip
    events, velocities = made.events, [made.truth["truth"]["velocity"][0]]
    if beside:
        direction, speed = BESIDE[scene]
        other = simulate(
            code=False, direction=direction, speed_px_ms=speed, preset=preset, duration_us=duration_us,
            seed=8, start=(400.0, 80.0), **SIZE,
        )  # fmt: skip
        pair = events, other.events
        order = np.argsort(np.concatenate([one.t for one in pair]), kind="stable")
        names = "t", "x", "y", "p"
        columns = (np.concatenate([getattr(one, name) for one in pair])[order] for name in names)
        events = EventArray(*columns, events.width, events.height)
        turn = math.radians(direction)
        velocities.append(1000.0 * speed * np.array([math.cos(turn), math.sin(turn)]))
    return events, velocities


def errors(name: str, windows: int, workspace: Workspace) -> np.ndarray:
    """Give the errors (found, 2) along and across the motion, relative to the speed."""
    events, velocities = passage(name)
    buffer = EventBuffer.of(events)
    last_us = int(events.t[-1]) - 8e6 / np.hypot(*velocities[0])
    rows = []
    for start_us in np.linspace(0, last_us, windows).astype(int).tolist():
        found = buffer.answer(find_motion(start_us, MotionConfig(), workspace=workspace))
        if isinstance(found, MotionEstimate):
            velocity = found.motion.velocity
            true = min(velocities, key=lambda v: np.hypot(*(velocity - v)))
            off = velocity - true
            rows.append((true @ off, true[0] * off[1] - true[1] * off[0]) / (true @ true))
    return np.array(rows).reshape(-1, 2)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    every = (*SCENES, *(f"{name} beside" for name in BESIDE))
    parser.add_argument("--scene", nargs="+", choices=every, default=every, metavar="NAME")
    parser.add_argument("--windows", type=int, default=50)
    arguments = parser.parse_args()
    backend = get_backend("warp")
    backend.load("cpu", LAUNCHED)
    workspace, good = Workspace(backend, "cpu"), True
    print(f"{'scene':20} {'found':>7} {'speed, %':>9} {'rms':>6} {'across, %':>10} {'rms':>6}")
    for name in arguments.scene:
        off = 100.0 * errors(name, arguments.windows, workspace)
        middle, rms = np.median(off, axis=0), np.sqrt(np.mean(off**2, axis=0))
        print(
            f"{name:20} {len(off):3}/{arguments.windows} {middle[0]:+9.2f} {rms[0]:6.2f} "
            f"{middle[1]:+10.2f} {rms[1]:6.2f}",
            flush=True,
        )
        if name.startswith("clean") and not name.endswith("beside"):
            good &= len(off) == arguments.windows and abs(middle[0]) <= REQUIRED_PERCENT
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
