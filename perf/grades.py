#!/usr/bin/env python3
"""Compare grades of readings with those of the prints that the simulator showed, by their ranks.

usage: grades.py [--prints 60] [--seed 0] [--preset slow] [--plot FILE]

Each print is a QR code that something is wrong with, or nothing: a scratch or a blot, a faint ink, a blur,
modules that are missing, ink that has spread or is short.  Its true grade comes from its light as a verifier
would measure it, through an aperture of 0.8 modules (`evqr.grade.grade_of` of both); the reading's comes from
events alone.  Ranks are of grades and the shares of the way to the next, of the worst part, so that they are
not all ties.  Exit 1 below 0.9.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is imported

import argparse
import math
import sys

import numpy as np
from numpy.typing import NDArray
from without_code import label

import evqr
from evqr.config import ReadConfig
from evqr.grade import CONTRAST, DAMAGE, MODULATION, UNUSED, Grade, grade_of
from evqr.simulate.config import PRESETS, CodePlacement
from evqr.simulate.printed import PrintedSymbol, make_symbol
from evqr.simulate.texture import gaussian_blur
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded

FINE = 6
"""Squares a module, along each side, that a print is made of."""

MODULE_PX = 6.0
APERTURE = 0.8
WHITE = 0.85
LEAST = 0.9
FAULTS = ("none", "blot", "faint", "blur", "missing", "growth")


def damaged(symbol: PrintedSymbol, fault: str, rng: np.random.Generator) -> tuple[NDArray[np.uint8], dict]:
    """Give the fine squares of a print with a fault, 1 dark, and what the scene needs to know of it."""
    modules, scene = symbol.modules.astype(bool), {}
    rows = len(modules)
    if fault == "missing":
        modules = modules & (rng.random(modules.shape) > rng.uniform(0.0, 0.25))
    dark = np.kron(modules, np.ones((FINE, FINE), bool))
    if fault == "blot":
        v, u = np.indices(dark.shape)
        middle, radius = rng.uniform(0.0, FINE * rows, 2), FINE * rng.uniform(0.5, 0.2 * rows)
        dark = np.where((v - middle[0]) ** 2 + (u - middle[1]) ** 2 < radius**2, rng.random() < 0.5, dark)
    elif fault == "growth":
        spread, ink = int(rng.integers(0, 2)), rng.random() < 0.5
        for _ in range(spread):
            for axis in (0, 1):
                both = np.roll(dark, 1, axis), np.roll(dark, -1, axis)
                dark = dark | both[0] | both[1] if ink else dark & both[0] & both[1]
    elif fault == "faint":
        scene["black"] = float(WHITE - rng.uniform(0.15, 0.75))
    elif fault == "blur":
        scene["psf_px"] = float(rng.uniform(0.6, 3.5))
    return dark.astype(np.uint8), {"black": 0.1, "psf_px": 0.6, **scene}


def true_grade(symbol: PrintedSymbol, squares: NDArray[np.uint8], scene: dict) -> Grade | None:
    """Grade a print as a verifier would; None where it does not decode."""
    light = np.where(np.pad(squares, 4 * FINE) > 0, scene["black"], WHITE).astype(np.float32)
    blur = scene["psf_px"] / MODULE_PX * FINE
    light = gaussian_blur(light, (blur, blur))
    v, u = np.indices((FINE, FINE)) - (FINE - 1) / 2
    inside = np.hypot(v, u) <= 0.5 * APERTURE * FINE
    rows, columns = symbol.modules.shape
    cells = light[4 * FINE : -4 * FINE, 4 * FINE : -4 * FINE].reshape(rows, FINE, columns, FINE)
    mean = (cells * inside[:, None]).sum(axis=(1, 3)) / inside.sum()
    high, low = float(mean.max()), float(mean.min())
    q = 2.0 * (mean - (high + low) / 2.0) / max(high - low, 1e-9)
    exact = np.where(symbol.modules > 0, -1, 1).astype(np.int8)
    decoded = decode_grid(q, symbol.space, effort="full")
    if not isinstance(decoded, Decoded):
        return None
    return grade_of(
        q, exact, symbol.space, np.eye(3), contrast=1.0 - low / high, unused=decoded.unused_correction,
        check=decoded.check,
    )  # fmt: skip


def rank_value(grade: Grade | None) -> float:
    """Put a grade on a scale: its number, and how far the worst of its parts is on the way to the next."""
    if grade is None:
        return -1.0
    levels = {"unused correction": UNUSED, "modulation": MODULATION, "contrast": CONTRAST}
    least = math.inf
    for part in grade.parts:
        if part.name in levels:
            steps = (0.0, *levels[part.name], 1.0)
            value = float(np.interp(part.value, steps, range(6)))
        elif part.name == "fixed pattern damage":
            value = float(np.interp(part.value, (0.0, *DAMAGE[::-1][1:], 1.0), (5, 4, 3, 2, 0)))
        else:
            value = float(part.number + 1)
        least = min(least, value, part.number + 1.0)
    return least


def ranks(values: list[float]) -> NDArray[np.float64]:
    """Rank values, ties by their mean rank."""
    _, inverse, counts = np.unique(np.round(values, 9), return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    return (ends - (counts + 1) / 2.0)[inverse]


def spearman(one: list[float], other: list[float]) -> float:
    """Give the rank correlation."""
    a, b = ranks(one) - ranks(one).mean(), ranks(other) - ranks(other).mean()
    return float((a * b).sum() / math.sqrt(float((a * a).sum() * (b * b).sum())))


def run(fault: str, seed: int, preset: str) -> tuple[Grade | None, Grade | None]:
    """Make a print, and grade it and its reading."""
    rng = np.random.default_rng([seed, FAULTS.index(fault)])
    symbol = make_symbol(CodePlacement(text="GRADE " + str(seed), version=2, ec="Q"))
    squares, scene = damaged(symbol, fault, rng)
    angle, direction = rng.uniform(0.0, 360.0, 2).tolist()
    events = label(
        squares, angle=angle, direction=direction, module_px=MODULE_PX / FINE, quiet=4 * FINE, preset=preset,
        speed_px_ms=4.0, duration_us=4000, width=320, height=240, white=WHITE, seed=seed, **scene,
    )  # fmt: skip
    result = evqr.read_codes(events, config=ReadConfig(symbologies=("qr",)), threads=1)  # pyright: ignore[reportArgumentType]
    read = result.readings[0].grade if result.readings else None
    return true_grade(symbol, squares, scene), read


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--prints", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--preset", choices=sorted(PRESETS), default="slow")
    parser.add_argument("--plot", help="picture to write")
    arguments = parser.parse_args()
    true, read, letters = [], [], []
    for k in range(arguments.prints):
        fault = FAULTS[k % len(FAULTS)]
        pair = run(fault, arguments.seed + k, arguments.preset)
        true.append(rank_value(pair[0]))
        read.append(rank_value(pair[1]))
        letters.append(tuple("-" if each is None else each.letter for each in pair))
        print(f"{fault:8s} print {pair[0] or '-'}; reading {pair[1] or '-'}", flush=True)
    rho = spearman(true, read)
    print("| print | " + " | ".join("ABCDF-") + " |\n|---" + 6 * "|---" + "|")
    for row in "ABCDF-":
        print(f"| {row} | " + " | ".join(str(letters.count((row, column))) for column in "ABCDF-") + " |")
    same = sum(a == b for a, b in letters)
    print(f"rank correlation {rho:.3f} ({LEAST} required); {same} of {len(letters)} letters are the same")
    if arguments.plot:
        draw(true, read, rho, arguments.plot)
    return 0 if rho >= LEAST else 1


def draw(true: list[float], read: list[float], rho: float, path: str) -> None:
    """Draw both grades of each print against each other."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(4.2, 4.0), layout="constrained")
    axes.plot([-1, 5], [-1, 5], color="0.8", linewidth=1)
    axes.plot(true, read, "o", markersize=4, alpha=0.6)
    ticks = dict(zip((-1, 0.5, 1.5, 2.5, 3.5, 4.5), ("none", *"FDCBA"), strict=True))
    axes.set_xticks(list(ticks), list(ticks.values()))
    axes.set_yticks(list(ticks), list(ticks.values()))
    axes.set_xlabel("grade of the print")
    axes.set_ylabel("grade of the reading")
    axes.set_title(f"rank correlation {rho:.2f}", fontsize=10)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    sys.exit(main())
