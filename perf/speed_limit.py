#!/usr/bin/env python3
"""How fast a code may pass: shares of simulated passages that are read, by speed and by lag in modules.

usage: speed_limit.py [--preset fast hard ...] [--speeds 5000 ...] [--module-px 4] [--passes 3]

Speeds are in modules a second.  The lag is speed times the photoreceptor's time constant in the light of a
code's light modules; in its dark ones pixels are slower.  One small QR code, at random angles and directions;
a passage is as long as it takes to move by 60 px.
"""

from __future__ import annotations

import argparse

import numpy as np

from evqr import read_codes
from evqr.simulate import PRESETS, simulate

TRAVEL_PX = 60.0
WIDTH, HEIGHT = 320, 240
TEXT = "LOT 4711"


def share_read(preset: str, modules_per_s: float, module_px: float, passes: int) -> float:
    """Read some passages; give the share that says the text, and never another one."""
    right = 0
    for seed in range(passes):
        rng = np.random.default_rng(seed)
        speed_px_ms = modules_per_s * module_px / 1000.0
        events = simulate(
            TEXT, preset=preset, module_px=module_px, width=WIDTH, height=HEIGHT, seed=seed,
            speed_px_ms=speed_px_ms, duration_us=round(1000.0 * TRAVEL_PX / speed_px_ms),
            angle=float(rng.uniform(0.0, 360.0)), direction=float(rng.uniform(0.0, 360.0)),
        ).events  # fmt: skip
        texts = {reading.text for reading in read_codes(events).readings}
        if texts - {TEXT}:
            raise SystemExit(f"FALSE: {texts} at {modules_per_s} modules/s, {preset}, seed {seed}")
        right += bool(texts)
    return right / passes


def main() -> None:
    """Print a line for each speed and sensor."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--preset", nargs="+", default=["fast", "hard"], choices=sorted(PRESETS))
    parser.add_argument("--speeds", nargs="+", type=float, default=[2500, 3500, 5000, 10_000, 14_000, 20_000])
    parser.add_argument("--module-px", type=float, default=4.0)
    parser.add_argument("--passes", type=int, default=3)
    given = parser.parse_args()
    print(f"{'preset':8} {'modules/s':>10} {'lag [modules]':>14} {'read':>6}")
    for preset in given.preset:
        for speed in given.speeds:
            lag = 1e-6 * PRESETS[preset].tau_us * speed
            share = share_read(preset, speed, given.module_px, given.passes)
            print(f"{preset:8} {speed:10.0f} {lag:14.2f} {share:6.0%}", flush=True)


if __name__ == "__main__":
    main()
