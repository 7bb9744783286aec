#!/usr/bin/env python3
"""One tree's reader in a process of its own, which reads a window when asked: for `against.py`.

usage: worker.py TREE DEVICE FOLDER

TREE is a checkout of any commit.  Of it are used what stays as it is: `evqr.EventArray`, `evqr.Solver`, and
of its perf/pipeline.py `Recording`, `prepare`, `can_run`, `RUN` and a job's ``start_us``.  FOLDER holds
recordings, each a file of `against.store`.  Every answer is a line of JSON on standard output: first
{"versions", "windows": [[case, start_us, methods], ...]}, then {"ms", "text"} for each line {"case",
"start_us", "method"} on standard input.  Ends with its input.
"""

from __future__ import annotations

import json
import os
import sys
import time
from importlib.metadata import distributions
from pathlib import Path
from types import ModuleType
from typing import Any, TextIO

import numpy as np


def imported(tree: Path) -> tuple[ModuleType, ModuleType]:
    """Import evqr and perf/pipeline.py of a tree, and of no other."""
    sys.path[:1] = [str(tree / "perf"), str(tree)]  # in the place of this file's own folder
    import pipeline

    import evqr

    for module in (evqr, pipeline):
        if tree not in Path(str(module.__file__)).parents:
            sys.exit(f"worker: {module.__name__} comes from {module.__file__}, not from {tree}")
    return evqr, pipeline


def load(path: Path, evqr: ModuleType, pipeline: ModuleType) -> Any:
    """Give a stored recording as one of the tree's."""
    with np.load(path) as file:
        columns = [file[name] for name in ("t", "x", "y", "p")]
        width, height = (int(side) for side in file["size"])
        return pipeline.Recording(
            path.stem,
            evqr.EventArray(*columns, width, height),
            frozenset(json.loads(str(file["texts"]))),
            tuple(int(start) for start in file["starts_us"]),
        )


def serve(tree: Path, device: str, folder: Path, questions: TextIO, answers: TextIO) -> None:
    """Prepare all windows, tell which there are, then read those that are asked for."""
    evqr, pipeline = imported(tree)
    solver = evqr.Solver(device=device)
    jobs = {}
    for path in sorted(folder.glob("*.npz")):
        for job in pipeline.prepare(load(path, evqr, pipeline), solver):
            jobs[path.stem, job.start_us] = job
    windows = [[*key, [m for m in pipeline.RUN if pipeline.can_run(m, job)]] for key, job in jobs.items()]
    versions = {d.name: d.version for d in distributions()}
    print(json.dumps({"versions": versions, "windows": windows}), file=answers, flush=True)
    for line in questions:
        asked = json.loads(line)
        job, run = jobs[asked["case"], asked["start_us"]], pipeline.RUN[asked["method"]]
        begin = time.perf_counter()
        text = run(job, solver)
        ms = 1e3 * (time.perf_counter() - begin)
        print(json.dumps({"ms": ms, "text": text}), file=answers, flush=True)


def main() -> None:
    tree, device, folder = sys.argv[1:]
    with os.fdopen(os.dup(1), "w") as answers:
        os.dup2(2, 1)  # libraries greet on standard output
        serve(Path(tree).resolve(), device, Path(folder), sys.stdin, answers)


if __name__ == "__main__":
    main()
