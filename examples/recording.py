"""What the examples share: a few pixels' travel of events from a recording that knows its truth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

TRAVEL_PX = 4.0
"""How far the code moves within the window."""

TOLERANCE = 0.02
"""Of the speed: how well the motion must be found."""


class Window(NamedTuple):
    """Events around a moment, as the kernels take them, and the motion that the recording knows of."""

    x: NDArray[np.float32]  # (E,) [px]
    y: NDArray[np.float32]
    t: NDArray[np.float32]  # (E,) [s] from the middle of the window
    polarity: NDArray[np.float32]  # (E,) -1 or 1
    window_ptr: NDArray[np.int32]  # (2,) one window
    shape: tuple[int, int]  # of the sensor
    seconds: float
    velocity: NDArray[np.float64]  # (2,) [px/s] true


def window_of_arguments(description: str) -> Window:
    """Read the window from the recording that the command line names."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("recording", type=Path, help=".h5 file with events and truth")
    return read_window(parser.parse_args().recording)


def read_window(path: Path) -> Window:
    """Take the events while the code moves `TRAVEL_PX`, half-way through the time it is in view."""
    with h5py.File(path) as file:
        events, truth = file["events"], file["truth"]
        times = truth["t_us"][:][truth["in_view"][:].astype(bool)]
        middle = int(times[len(times) // 2])
        velocity = np.array([np.interp(middle, truth["t_us"], truth["velocity"][:, k]) for k in range(2)])
        half_us = int(0.5e6 * TRAVEL_PX / np.linalg.norm(velocity))
        begin, end = np.searchsorted(events["t"], [middle - half_us, middle + half_us])
        x, y, p = (events[name][begin:end].astype(np.float32) for name in "xyp")
        t = ((events["t"][begin:end] - middle) * 1e-6).astype(np.float32)
        shape = int(file.attrs["height"]), int(file.attrs["width"])
    window_ptr = np.array([0, len(x)], np.int32)
    return Window(x, y, t, 2 * p - 1, window_ptr, shape, 2e-6 * half_us, velocity)


def report(found: NDArray[np.floating], window: Window) -> int:
    """Print found and true motion; give the exit status: 0 when they agree."""
    error = float(np.linalg.norm(found - window.velocity) / np.linalg.norm(window.velocity))
    print(f"{len(window.x)} events in {1e3 * window.seconds:.2f} ms")
    for name, (x, y) in (("found", found), ("true", window.velocity)):
        print(f"{name} ({x:.0f}, {y:.0f}) px/s")
    print(f"they differ by {error:.1%} of the speed, {TOLERANCE:.0%} are allowed")
    return int(error > TOLERANCE)
