#!/usr/bin/env python3
"""Check, or fit anew, how sure modules are (`evqr.fit.certainty`), on passes that it was not fitted to.

usage: calibration.py [--seeds 3] [--first 100] [--fit] [--save FILE] [--load FILE] [--plot FILE]

Simulated codes of every symbology and sensor, of any size up to 45 modules, pass at any angle and speed;
three windows of each, of 0.5 to 2 px of travel, are aligned from the true pose and solved.  Reliability is
compared in bins of the probability that a module is what its sign says: how often it is.  Bins of fewer than
400 modules are left out.  With --fit half of the seeds give new parameters, and the others judge them.  The
outermost modules of Aztec codes, which stand without a quiet zone beside whatever there is, are left out.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is imported

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from evqr.clock import StageClock
from evqr.events.batch import EventBatch
from evqr.events.window import make_window
from evqr.fit import certainty
from evqr.fit.refine import complete, refine
from evqr.motion import Motion
from evqr.search.screen import Candidate
from evqr.simulate import PRESETS, simulate
from evqr.solver import Solver
from evqr.symbol.symbols import SYMBOLS, space_of
from evqr.symbology import Symbology

LEAST_MODULES = 400
KINDS = tuple(SYMBOLS)
COLUMNS = ("kind", "seed", "strength", "right", "information", "unclear", "probability")


def modules_of(solver: Solver, seed: int, symbology: Symbology, preset: str) -> NDArray[np.float64]:
    """Simulate a pass, solve three windows of it, and give a row of `COLUMNS` for each unknown module."""
    rng = np.random.default_rng([seed, KINDS.index(symbology), list(PRESETS).index(preset)])
    sizes = [version for version, shape in SYMBOLS[symbology].sizes.items() if max(shape) <= 45]
    version, speed = sizes[rng.integers(len(sizes))], float(rng.uniform(1.0, 10.0))
    space = space_of(symbology, version)
    largest = min(7.0, 215.0 / float(np.hypot(space.rows, space.columns)))
    pass_ = simulate(
        "".join(rng.choice(list("0123456789"), 4)), symbology=symbology, version=version,
        ec="L" if symbology is Symbology.MICRO_QR_CODE else "M", preset=preset, seed=seed,
        module_px=float(rng.uniform(min(3.2, largest), largest)), speed_px_ms=speed,
        angle=float(rng.uniform(0.0, 360.0)), direction=float(rng.uniform(0.0, 360.0)), width=320, height=240,
        duration_us=round(12e3 / speed), threads=1,
    )  # fmt: skip
    truth, windows, motions, known = pass_.truth["truth"], [], [], []
    half = round(500.0 * float(rng.choice([0.5, 1.0, 2.0])) / speed)
    for share in (0.25, 0.5, 0.75):
        k = int(share * len(truth["t_us"]))
        middle = int(truth["t_us"][k])
        windows.append(make_window(pass_.events, middle - half, middle + half))
        motions.append(Motion(truth["velocity"][k], middle))
        known.append([Candidate(space, truth["H"][k], 1.0, 0)])
    batch, unknown_lags = EventBatch.of(windows), [None] * len(windows)
    refined = refine(batch, motions, known, unknown_lags, solver.config, workspace=solver.workspace)
    found = complete(
        batch, refined, unknown_lags, solver.config, workspace=solver.workspace, clock=StageClock()
    )
    free = ~space.known
    if symbology is Symbology.AZTEC:
        free[[0, -1]] = free[:, [0, -1]] = False
    rows = []
    for each in solver.solve([one for one in found if one.score >= solver.config.align.min_score]):
        dark = certainty.dark(each.q, space, each.information)[free]
        right = (each.q < 0.0)[free] == (truth["modules"] > 0)[free]
        count = int(free.sum())
        columns = (
            np.full(count, KINDS.index(symbology)), np.full(count, seed), np.abs(each.q[free]), right,
            np.full(count, each.information), np.full(count, certainty.unclear(each.q, space)),
            np.maximum(dark, 1.0 - dark),
        )  # fmt: skip
        rows.append(np.column_stack(columns))
    return np.concatenate(rows) if rows else np.empty((0, len(COLUMNS)))


def bins(probability: NDArray, right: NDArray) -> list[tuple[int, float, float]]:
    """Give how many modules, their mean probability, and what share is right, by tenths of the range."""
    edges, found = np.linspace(0.5, 1.0, 11), []
    which = np.clip(np.searchsorted(edges, probability, side="right") - 1, 0, 9)
    for k in range(10):
        its = which == k
        if its.sum() >= LEAST_MODULES:
            found.append((int(its.sum()), float(probability[its].mean()), float(right[its].mean())))
    return found


def fitted(rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit the parameters, by likelihood: those of all, and the level of each symbology."""
    from scipy.optimize import minimize

    kind, _, strength, right, information, unclear, _ = rows[:: max(1, len(rows) // 40_000)].T
    strength, kind = np.minimum(strength, certainty.MOST), kind.astype(int)

    def loss(w: NDArray[np.float64]) -> float:
        level = w[4 + kind] + w[0] * np.log(information) + w[1] * np.log(unclear + 0.01)
        odds = np.exp(np.clip(level, -10.0, 5.0)) * strength * (1 + np.exp(w[2]) * strength ** np.exp(w[3]))
        return float(np.logaddexp(0.0, np.where(right > 0, -odds, odds)).mean())

    start = np.array([0.7, -0.4, 0.4, 0.3, *certainty.LEVEL.values()])
    best = minimize(loss, start, method="L-BFGS-B").x
    return np.array([best[0], best[1], np.exp(best[2]), np.exp(best[3])]), best[4:]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=100, help="the first seed")
    parser.add_argument("--fit", action="store_true", help="fit parameters to half of the seeds")
    parser.add_argument("--save", type=Path, help="keep what was simulated, .npy")
    parser.add_argument("--load", type=Path, help="take that")
    parser.add_argument("--plot", help="picture to write")
    arguments = parser.parse_args()
    if arguments.load:
        rows = np.load(arguments.load)
    else:
        solver = Solver()
        seeds = range(arguments.first, arguments.first + arguments.seeds)
        work = [(seed, kind, preset) for seed in seeds for kind in KINDS for preset in PRESETS]
        rows = np.concatenate([modules_of(solver, *each) for each in tqdm(work, disable=None)])
        if arguments.save:
            np.save(arguments.save, rows)
    if arguments.fit:
        even = rows[:, 1] % 2 == 0
        shared, levels = fitted(rows[even])
        print("information, unclear, bend, power:", *np.round(shared, 3))
        print("levels:", {kind.value: round(float(a), 3) for kind, a in zip(KINDS, levels, strict=True)})
        rows = rows[~even].copy()
        strength = np.minimum(rows[:, 2], certainty.MOST)
        level = levels[rows[:, 0].astype(int)] + shared[1] * np.log(rows[:, 5] + 0.01)
        odds = np.exp(level) * rows[:, 4] ** shared[0] * strength * (1 + shared[2] * strength ** shared[3])
        rows[:, 6] = 1.0 / (1.0 + np.exp(-odds))
    found = {"all": bins(rows[:, 6], rows[:, 3])}
    for k, kind in enumerate(KINDS):
        its = rows[:, 0] == k
        found[kind.value] = bins(rows[its, 6], rows[its, 3])
    print("| | modules | largest difference in a bin | mean difference |\n|---|---|---|---|")
    for name, some in found.items():
        off = [(count, abs(expected - true)) for count, expected, true in some]
        total = sum(count for count, _ in off)
        mean = sum(count * each for count, each in off) / max(total, 1)
        print(f"| {name} | {total:,} | {max((each for _, each in off), default=0.0):.3f} | {mean:.4f} |")
    if arguments.plot:
        draw(found, arguments.plot)
    return 0


def draw(found: dict[str, list[tuple[int, float, float]]], path: str) -> None:
    """Draw how often modules are right against how often they should be."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(2, 3, figsize=(8.4, 5.6), sharex=True, sharey=True, layout="constrained")
    for axes, (name, some) in zip(panels.ravel(), found.items(), strict=True):
        axes.plot([0.5, 1.0], [0.5, 1.0], color="0.7", linewidth=1)
        axes.fill_between([0.5, 1.0], [0.48, 0.98], [0.52, 1.02], color="0.92")
        axes.plot([each[1] for each in some], [each[2] for each in some], "o-", markersize=4)
        axes.set_title(name, fontsize=10)
    figure.supxlabel("probability that a module is what its sign says", fontsize=10)
    figure.supylabel("how often it is", fontsize=10)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    sys.exit(main())
