#!/usr/bin/env python3
"""What is still read of hard passes: read rates by what makes them hard, goals beside limits.

usage: hard_passes.py [--sweep NAME ...] [--quick] [--jobs 2] [--against COMMIT] [--csv FILE] [--plots DIR]

What is varied is in `hard_sweeps.py`.  Of each value and seed the whole recording is read, and windows of
2 px of travel alone.  A limit is the hardest value up to which at least half is read; with --against the same
events are read by another commit, too.  Exit 1 where a text is read that is not printed.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is imported: the processes share the cores

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from hard_sweeps import SWEEPS, Sweep
from tqdm import tqdm

import evqr
from evqr.events.array import EventArray

WINDOWS = 6
"""Of a recording that are read alone."""


# ---- reading


def read(events: EventArray, texts: frozenset[str], options: Mapping[str, Any]) -> dict[str, Any]:
    """Read a recording whole and by windows, and say which shares of it are right, and what is false."""
    config = evqr.ReadConfig(**options)
    whole = {reading.text for reading in evqr.read_codes(events, config=config).readings}
    alone, false = [], sorted(str(text) for text in whole - texts)
    for window in evqr.read_windows(events, config=evqr.ReadConfig(**options, max_windows=WINDOWS)):
        said = {code.text for code in window.codes if code.text is not None}
        alone.append(len(said & texts) / len(texts))
        false += sorted(said - texts)
    return {
        "whole": len(whole & texts) / len(texts),
        "alone": sum(alone) / max(len(alone), 1),
        "false": false,
    }


def run(job: tuple[str, float, int], folder: str | None) -> dict[str, Any]:
    """Make a recording, store it where it is asked for, and read it."""
    name, value, seed = job
    sweep = SWEEPS[name]
    events, texts = sweep.make(value, seed)
    if folder is not None:
        columns = {each: getattr(events, each) for each in ("t", "x", "y", "p")}
        about = json.dumps({"texts": sorted(texts), "options": dict(sweep.options)})
        np.savez(
            Path(folder) / f"{name}_{value:g}_{seed}.npz", **columns, size=(events.width, events.height),
            about=about,
        )  # fmt: skip
    return {"sweep": name, "value": value, "seed": seed, **read(events, texts, sweep.options)}


READER = """
import json, sys
from pathlib import Path
import numpy as np
sys.path.insert(0, sys.argv[1])
import evqr
for path in sorted(Path(sys.argv[2]).glob("*.npz")):
    with np.load(path) as file:
        events = evqr.EventArray(*(file[name] for name in "txyp"), *(int(side) for side in file["size"]))
        about = json.loads(str(file["about"]))
    options = about["options"]
    whole = [each.text for each in evqr.read_codes(events, config=evqr.ReadConfig(**options)).readings]
    windows = evqr.read_windows(events, config=evqr.ReadConfig(**options, max_windows=int(sys.argv[3])))
    codes = [getattr(window, "codes", (window,)) for window in windows]
    alone = [[code.text for code in each if code.text is not None] for each in codes]
    print(json.dumps([path.stem, about["texts"], whole, alone]), flush=True)
"""
"""What another commit is asked: no more of it than has always been there."""


def read_by(commit: str, folder: str) -> Iterator[dict[str, Any]]:
    """Read what was stored by another commit's tree, with this Python's packages."""
    here = Path(__file__).resolve().parents[1]
    with tempfile.TemporaryDirectory() as place:
        tree = Path(place) / "tree"
        subprocess.run(["git", "worktree", "add", "-q", "--detach", str(tree), commit], cwd=here, check=True)
        try:
            arguments = [sys.executable, "-c", READER, str(tree), folder, str(WINDOWS)]
            done = subprocess.run(arguments, cwd=place, stdout=subprocess.PIPE, text=True, check=True)
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", str(tree)], cwd=here, check=True)
    for line in done.stdout.splitlines():
        stem, printed, whole, alone = json.loads(line)
        name, value, seed = stem.rsplit("_", 2)
        texts = set(printed)
        shares = [len(set(said) & texts) / len(texts) for said in alone]
        false = sorted({text for said in [whole, *alone] for text in said} - texts)
        yield {
            "sweep": name, "value": float(value), "seed": int(seed), "false": false,
            "whole": len(set(whole) & texts) / len(texts), "alone": sum(shares) / max(len(shares), 1),
        }  # fmt: skip


# ---- what came out


def limit(sweep: Sweep, rates: Mapping[float, float], least: float) -> float | None:
    """Give the hardest value up to which at least so much is read; None where the easiest is not."""
    reached = None
    for value in sweep.values:
        if value in rates and rates[value] < least:
            break
        reached = value if value in rates else reached
    return reached


def rates_of(sweep: Sweep, outcomes: Sequence[dict], what: str) -> dict[float, float]:
    """Give the mean share that was read, by value."""
    found: dict[float, list[float]] = {}
    for one in outcomes:
        if one["sweep"] == sweep.name:
            found.setdefault(one["value"], []).append(one[what])
    return {value: float(np.mean(found[value])) for value in sweep.values if value in found}


def table(sweeps: Sequence[Sweep], readers: Mapping[str, Sequence[dict]]) -> str:
    """Put limits beside goals, in Markdown."""
    lines = [
        "| sweep | parameter | goal | "
        + " | ".join(f"whole, {r} | alone, {r}" for r in readers)
        + " | false |",
        "|---" * (4 + 2 * len(readers)) + "|",
    ]
    for sweep in sweeps:
        row, false = [], 0
        for outcomes in readers.values():
            for what, least in (("whole", 0.5), ("alone", 0.5)):
                rates = rates_of(sweep, outcomes, what)
                reached = limit(sweep, rates, least)
                at_goal = f" ({rates[sweep.goal]:.0%} at the goal)" if sweep.goal in rates else ""
                row.append(("-" if reached is None else f"{reached:g}") + at_goal)
            false += sum(len(one["false"]) for one in outcomes if one["sweep"] == sweep.name)
        unit = f" [{sweep.unit}]" if sweep.unit else ""
        goal = f"{sweep.goal:g}, {sweep.what.replace(' ', ' and ')}"
        lines.append(f"| {sweep.name} | {sweep.parameter}{unit} | {goal} | {' | '.join(row)} | {false} |")
    return "\n".join(lines)


def write_csv(path: Path, readers: Mapping[str, Sequence[dict]]) -> None:
    """Write a row a recording and reader."""
    with path.open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(
            ["reader", "sweep", "parameter", "unit", "value", "goal", "seed", "whole", "alone", "false"]
        )
        for reader, outcomes in readers.items():
            for one in outcomes:
                sweep = SWEEPS[one["sweep"]]
                about = [sweep.parameter, sweep.unit, f"{one['value']:g}", f"{sweep.goal:g}", one["seed"]]
                shares = [f"{one['whole']:.3f}", f"{one['alone']:.3f}", len(one["false"])]
                out.writerow([reader, sweep.name, *about, *shares])


def draw(sweep: Sweep, readers: Mapping[str, Sequence[dict]], path: Path) -> None:
    """Draw what is read against the parameter, the goal beside it."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(3.6, 2.3), layout="constrained")
    for k, (reader, outcomes) in enumerate(readers.items()):
        for what, style in (("whole", "o-"), ("alone", "s--")):
            rates = rates_of(sweep, outcomes, what)
            name = {"whole": "whole", "alone": "windows alone"}[what] + (f", {reader}" if k else "")
            colour = ("tab:blue", "0.6")[min(k, 1)] if what == "whole" else ("tab:orange", "0.75")[min(k, 1)]
            axes.plot([*rates], [*rates.values()], style, markersize=4, label=name, color=colour)
    axes.axvline(sweep.goal, color="tab:green", linewidth=1, linestyle=":", label="goal")
    if sweep.values[0] > sweep.values[-1]:
        axes.invert_xaxis()
    if max(sweep.values) > 20 * max(min(sweep.values), 1e-9) > 1e-3:
        axes.set_xscale("log")
    axes.set_ylim(-0.05, 1.05)
    axes.set_xlabel(f"{sweep.parameter} [{sweep.unit}]" if sweep.unit else sweep.parameter, fontsize=8)
    axes.set_ylabel("share read", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.legend(fontsize=6)
    figure.savefig(path, dpi=90)
    pyplot.close(figure)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sweep", nargs="+", metavar="NAME", default=list(SWEEPS), choices=list(SWEEPS))
    parser.add_argument("--quick", action="store_true", help="the goal and what is next easier, one seed")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--against", metavar="COMMIT", help="read by this commit, too")
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--plots", type=Path, help="folder for a picture a sweep, NAME.png")
    arguments = parser.parse_args()
    sweeps = [SWEEPS[name] for name in arguments.sweep]
    jobs = []
    for sweep in sweeps:
        values = sweep.values
        if arguments.quick:
            k = values.index(sweep.goal)
            values = values[max(k - 1, 0) : k + 1]
        seeds = range(arguments.first, arguments.first + (1 if arguments.quick else arguments.seeds))
        jobs += [(sweep.name, value, seed) for value in values for seed in seeds]
    readers: dict[str, list[dict]] = {"this": []}
    with tempfile.TemporaryDirectory() as folder:
        work = partial(run, folder=folder if arguments.against else None)
        with ProcessPoolExecutor(arguments.jobs, mp_context=get_context("spawn")) as pool:
            for outcome in tqdm(pool.map(work, jobs), total=len(jobs), disable=None, unit="pass"):
                readers["this"].append(outcome)
        if arguments.against:
            readers[arguments.against] = list(read_by(arguments.against, folder))
    print(table(sweeps, readers))
    if arguments.csv:
        write_csv(arguments.csv, readers)
    if arguments.plots:
        arguments.plots.mkdir(parents=True, exist_ok=True)
        for sweep in sweeps:
            draw(sweep, readers, arguments.plots / f"{sweep.name}.png")
    return 1 if any(one["false"] for outcomes in readers.values() for one in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
