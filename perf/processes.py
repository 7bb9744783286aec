"""Whole processes, as users start them: to the first record, beside a busy neighbour, and two jobs.

Nothing is set in their environment that would hold threads back, and each is started in the folder of its
tree, of which it then imports.  What the machine adds is told by a control, processes that count and share
nothing, under the same conditions in the same rounds.
"""

from __future__ import annotations

import contextlib
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cases
import reader_times
from against import HERE, Tree, checked_out, environment, git
from table import Row, row

from evqr.demo import demo_recording
from evqr.recording.writing import save_recording

THIS, CONTROL = "this", "counting"
ROUNDS = {"start": 7, "busy": 3, "jobs": 3}
"""What can be timed, and how often."""

PARTS = ("start ms", "process s", "ratio")
"""In the order in which they are printed."""

FIRST_RECORD_SECONDS = 0.2
"""From a process's start to its first record, beyond imports and the load of the kernels, at most."""

COPIES = {"busy": 6, "jobs": 24}
"""Of each scene, a recording: two processes take a second to start, and so are worth it for many."""

QUIET_OVER_BUSY = 1 / 1.3
JOBS_RATIO = 1.7

LIST_MODULES = """
import atexit, runpy, sys
listed = open(sys.argv.pop(1), "w")
atexit.register(lambda: print(*sys.modules, file=listed))
runpy.run_module("evqr", run_name="__main__")
"""
"""Runs the command, then writes the names of what it imported to a file, in their order."""

LOAD = """
import importlib, sys
try:
    from evqr.cli.running import collect_garbage_rarely as as_the_command_does
    as_the_command_does()
except ImportError:
    pass  # commits that had none
for name in open(sys.argv[1]).read().split():
    if not name.endswith("__main__"):
        try:
            importlib.import_module(name)
        except Exception:
            pass  # parts of packages that only their own parent can import
from evqr import Solver
Solver()
print("ready", flush=True)
"""

COUNT = """
total = 0
for k in range({}):
    total += k * k
"""


@dataclass(frozen=True)
class Run:
    """What a process took: seconds to its first line, to its end, and of processors."""

    first: float
    whole: float
    processor: float


def run(command: Sequence[str], folder: Path, cores: frozenset[int] | None = None) -> Run:
    """Run a command in a folder, on all cores or on some."""

    def confine() -> None:
        if cores is not None:
            os.sched_setaffinity(0, cores)

    begin = time.perf_counter()
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=confine,
    )
    assert process.stdout is not None and process.stderr is not None
    process.stdout.readline()
    first = time.perf_counter() - begin
    process.stdout.read()
    complaints = process.stderr.read().decode()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    whole = time.perf_counter() - begin
    process.stdout.close()
    process.stderr.close()
    if process.returncode:
        sys.exit(f"{' '.join(command[:4])} ... ended with {process.returncode}: {complaints.strip()}")
    return Run(first, whole, used.ru_utime + used.ru_stime)


def read(tree: Tree, *arguments: str | Path) -> list[str]:
    """Give the command that reads with a tree, whose folder it is to be started in."""
    return [str(tree.python), "-m", "evqr", "read", *map(str, arguments)]


def rounds_of(
    contestants: Mapping[str, Callable[[], Run]], rounds: int, seed: int = 0
) -> Iterator[dict[str, Run]]:
    """Run all once a round, one after the other in another order each time; the first does not count."""
    rng = random.Random(seed)
    for round_ in range(rounds + 1):
        runs = {name: contestants[name]() for name in rng.sample(list(contestants), len(contestants))}
        if round_ > 0:
            yield runs


def time_processes(
    kinds: Sequence[str], ref: str | None, rounds: int | None
) -> tuple[dict[str, str], list[Row]]:
    """Time whole processes of this tree, and of another commit where one is named."""
    trees = {THIS: Tree(HERE, Path(sys.executable))}
    if ref is not None:
        trees[git("rev-parse", "--short", f"{ref}^{{commit}}")] = checked_out(ref)
    time_of = {"start": time_start, "busy": time_busy, "jobs": time_jobs}
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for kind in kinds:
            rows += time_of[kind](trees, Path(folder), rounds or ROUNDS[kind])
    return {"against": ref or "nothing"}, sorted(rows, key=lambda r: PARTS.index(str(r["part"])))


def time_start(trees: Mapping[str, Tree], folder: Path, rounds: int) -> list[Row]:
    """Time the way to the first record of the demo, and what a process does of it that only loads."""
    with demo_recording() as demo:
        contestants: dict[str, Callable[[], Run]] = {}
        for name, tree in trees.items():
            listed = folder / f"{name}.modules"
            run([str(tree.python), "-c", LIST_MODULES, str(listed), "read", str(demo)], tree.path)
            load = [str(tree.python), "-c", LOAD, str(listed)]
            contestants[name] = lambda tree=tree: run(read(tree, demo), tree.path)
            contestants[f"{name}, load"] = lambda load=load, tree=tree: run(load, tree.path)
        trials = list(rounds_of(contestants, rounds))
    rows = []
    for name in trees:
        pairs = [(trial[name], trial[f"{name}, load"]) for trial in trials]
        beyond = [1e3 * (read.first - load.first) for read, load in pairs]
        rows += [
            row("start ms", "demo", name, "to the first record", [1e3 * read.first for read, _ in pairs]),
            row("start ms", "demo", name, "imports, kernels", [1e3 * load.first for _, load in pairs]),
            row("start ms", "demo", name, "beyond", beyond),
            row(
                "start ms", "demo", name, "beyond, processor",
                [1e3 * (read.processor - load.processor) for read, load in pairs],
            ),
        ]  # fmt: skip
        if name == THIS:
            share = [1e3 * FIRST_RECORD_SECONDS / max(each, 1.0) for each in beyond]
            rows.append(
                row("ratio", "demo", f"{FIRST_RECORD_SECONDS} s / beyond", "start", share, required=1.0)
            )
    return rows


def time_busy(trees: Mapping[str, Tree], folder: Path, rounds: int) -> list[Row]:
    """Time reading on two cores, alone and with a neighbour that never rests on one of them."""
    mine, neighbours = two_cores()
    paths = stored(folder, COPIES["busy"])
    commands = {name: (read(tree, *paths), tree.path) for name, tree in trees.items()}
    commands[CONTROL] = counting(1), folder
    contestants: dict[str, Callable[[], Run]] = {}
    for name, (command, where) in commands.items():
        contestants[name] = lambda command=command, where=where: run(command, where, mine)

        def beside(command: list[str] = command, where: Path = where) -> Run:
            with neighbour(neighbours):
                return run(command, where, mine)

        contestants[f"{name}, busy"] = beside
    trials = list(rounds_of(contestants, rounds))
    rows = []
    for name in commands:
        pairs = [(trial[name], trial[f"{name}, busy"]) for trial in trials]
        ratios = [quiet.whole / busy.whole for quiet, busy in pairs]
        spent = [quiet.processor / busy.processor for quiet, busy in pairs]
        judged = {"required": QUIET_OVER_BUSY} if name == THIS else {}
        rows += [
            row("process s", "a busy neighbour", name, "quiet", [quiet.whole for quiet, _ in pairs]),
            row("process s", "a busy neighbour", name, "busy", [busy.whole for _, busy in pairs]),
            row("ratio", "a busy neighbour", name, "quiet / busy", ratios, **judged),
            row("ratio", "a busy neighbour", name, "processor time", spent),
        ]
    return rows


def time_jobs(trees: Mapping[str, Tree], folder: Path, rounds: int) -> list[Row]:
    """Time many recordings with one job and with two, and one process that counts against two of them."""
    paths = stored(folder, COPIES["jobs"])
    case = f"{len(paths)} recordings"
    contestants: dict[str, Callable[[], Run]] = {}
    for name, tree in trees.items():
        for jobs in (1, 2):
            command = read(tree, *paths, "--jobs", str(jobs))
            contestants[f"{name} {jobs}"] = lambda command=command, tree=tree: run(command, tree.path)
    for jobs in (1, 2):
        contestants[f"{CONTROL} {jobs}"] = lambda jobs=jobs: run(counting(jobs), folder)
    trials = list(rounds_of(contestants, rounds))
    rows = []
    for name in (*trees, CONTROL):
        pairs = [(trial[f"{name} 1"], trial[f"{name} 2"]) for trial in trials]
        work = 2 if name == CONTROL else 1  # two that count do twice as much as one
        ratios = [work * one.whole / two.whole for one, two in pairs]
        spent = [work * one.processor / two.processor for one, two in pairs]
        judged = {"required": JOBS_RATIO} if name == THIS else {}
        rows += [
            row("process s", case, name, "--jobs 1", [one.whole for one, _ in pairs]),
            row("process s", case, name, "--jobs 2", [two.whole for _, two in pairs]),
            row("ratio", case, name, "--jobs 1 / 2", ratios, **judged),
            row("ratio", case, name, "processor time", spent),
        ]
    return rows


def stored(folder: Path, copies: int) -> list[Path]:
    """Write the scenes with codes as files, so many of each: one, and others that are links to it."""
    paths = [folder / f"{name}-{copy}.h5" for copy in range(copies) for name in cases.PIPELINE]
    for path in paths:
        name, _, copy = path.stem.rpartition("-")
        if path.exists():
            continue
        if int(copy):
            os.link(folder / f"{name}-0.h5", path)
        else:
            save_recording(path, reader_times.simulated(name).events)
    return paths


def counting(processes: int, steps: int = 20_000_000) -> list[str]:
    """Give a command that counts in so many processes at once, and waits for them."""
    count = COUNT.format(steps)
    if processes == 1:
        return [sys.executable, "-c", count]
    started = f"[subprocess.Popen([sys.executable, '-c', {count!r}]) for _ in range({processes})]"
    return [sys.executable, "-c", f"import subprocess, sys; [each.wait() for each in {started}]"]


def two_cores() -> tuple[frozenset[int] | None, frozenset[int] | None]:
    """Give the cores for who is timed, two of them, and for its neighbour, one of the two."""
    if not hasattr(os, "sched_setaffinity"):
        return None, None
    cores = sorted(os.sched_getaffinity(0))[:2]
    return frozenset(cores), frozenset(cores[-1:])


@contextlib.contextmanager
def neighbour(cores: frozenset[int] | None) -> Iterator[None]:
    """Run a process that never rests."""

    def confine() -> None:
        if cores is not None:
            os.sched_setaffinity(0, cores)

    process = subprocess.Popen([sys.executable, "-c", "while True: pass"], preexec_fn=confine)
    try:
        yield
    finally:
        process.kill()
        process.wait()
