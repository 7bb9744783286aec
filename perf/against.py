"""Times of this tree's reader against those of another commit, in pairs of one run.

The other commit has a work tree and a virtual environment of its own below the user's cache folder, with the
dependencies that this environment has; both stay there for the next time.  Two processes of each tree
(`worker.py`) read the same windows of the same events, one right after the other in random order, with
nothing set in their environment that would hold threads back.  Two of each, because processes of one tree
share what is in the caches, so that neither tree has more of that; and the other commit's two against each
other are the control: what their pairs are away from 1 is the noise of the run.  A process differs from the
next of the same tree by a few per cent for as long as it lives, by where its memory happens to lie, so that
all are started anew a few times.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from importlib.metadata import distributions
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import cases
import numpy as np
from table import Row, row

if TYPE_CHECKING:
    from pipeline import Recording

HERE = Path(__file__).resolve().parents[1]
REQUIRED = 0.95
"""Least ratio of the other commit's time over this tree's, the median of all windows with a code."""
METHODS = ("cold", "tracked")
STARTS = 3
"""How often all processes are started."""
NOTHING = "nothing"
"""A window from cold that shows no code."""
THIS, OTHER = ("this", "this again"), ("other", "other again")
"""Names of the processes."""


@dataclass(frozen=True)
class Tree:
    """A checkout, and the Python that has what it needs."""

    path: Path
    python: Path


@dataclass(frozen=True)
class Window:
    """What is asked of all: a window, and how to read it."""

    case: str
    start_us: int
    method: str


@dataclass(frozen=True)
class Trial:
    """A window read by all, one right after the other: milliseconds and text of each, and in which round."""

    window: Window
    ms: Mapping[str, float]
    text: Mapping[str, str | None]
    round: tuple[int, int] = (0, 0)


class Reads(Protocol):
    """What reads a window when asked: `Worker`."""

    def ask(self, window: Window) -> dict[str, Any]:
        """Give {"ms", "text"}."""
        ...


# The other commit's tree and environment


def git(*arguments: str, check: bool = True) -> str:
    """Run git in this clone."""
    done = subprocess.run(["git", *arguments], cwd=HERE, capture_output=True, text=True)
    if check and done.returncode:
        sys.exit(f"git {' '.join(arguments)}: {done.stderr.strip()}")
    return done.stdout.strip()


def checked_out(ref: str) -> Tree:
    """Give a commit's tree and environment, made where they are not there."""
    commit = git("rev-parse", "--verify", "--quiet", f"{ref}^{{commit}}", check=False)
    if not commit:
        sys.exit(f"--against {ref}: this clone has no such commit; fetch it, or name another")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "evqr-perf" / commit[:12]
    tree = Tree(cache / "tree", cache / "venv" / "bin" / "python")
    if not (tree.path / ".git").exists():
        git("worktree", "prune")
        git("worktree", "add", "--detach", "--force", str(tree.path), commit)
    if not up_to_date(cache / "venv"):
        install(tree, cache)
    return tree


def up_to_date(environment: Path) -> bool:
    """Whether evqr is installed there, and all that it needs has the version that it has here."""
    folder = environment / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
    there = versions_of(distributions(path=[str(folder)]))
    return "evqr" in there and not differing(there, versions_of(distributions()))


def versions_of(installed: Iterable[Any]) -> dict[str, str]:
    return {distribution.name.lower(): distribution.version for distribution in installed}


def differing(there: Mapping[str, str], here: Mapping[str, str]) -> list[str]:
    """Say which packages of both differ in version, the tools that install them apart."""
    packages = sorted((there.keys() & here.keys()) - {"evqr", "pip", "setuptools", "wheel"})
    return [f"{p} {there[p]}, here {here[p]}" for p in packages if there[p] != here[p]]


def install(tree: Tree, cache: Path) -> None:
    """Make an environment and install a tree in it, with the versions of what is installed here."""
    print(f"installing {tree.path}", file=sys.stderr)
    environment = tree.python.parents[1]
    shutil.rmtree(environment, ignore_errors=True)
    constraints = cache / "constraints.txt"
    here = versions_of(distributions())
    constraints.write_text("".join(f"{name}=={here[name]}\n" for name in sorted(here.keys() - {"evqr"})))
    pip = [str(tree.python), "-m", "pip", "install", "-q", "-c", str(constraints), "-e", str(tree.path)]
    for command in ([sys.executable, "-m", "venv", str(environment)], pip):
        done = subprocess.run(command, stdout=sys.stderr)
        if done.returncode:
            sys.exit(f"{' '.join(command)} ended with {done.returncode}")


# A process a tree


class Worker:
    """A process of `worker.py`, seen from here."""

    def __init__(self, tree: Tree, device: str, folder: Path) -> None:
        command = [str(tree.python), str(HERE / "perf" / "worker.py"), str(tree.path), device, str(folder)]
        self._tree = tree
        self._process = subprocess.Popen(
            command, env=environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            sys.exit(f"the reader of {self._tree.path} ended with {self._process.wait()}")
        return json.loads(line)

    def ready(self) -> tuple[set[Window], dict[str, str]]:
        """Wait until it has started; give the windows that it can read, and the versions of its packages."""
        answer = self._answer()
        windows = {Window(case, start, m) for case, start, methods in answer["windows"] for m in methods}
        return windows, answer["versions"]

    def ask(self, window: Window) -> dict[str, Any]:
        """Let it read a window; give milliseconds and text."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(vars(window)) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def environment() -> dict[str, str]:
    """Give this process's environment without what holds threads back or names other trees.

    Byte code is kept, as that of installed packages is: to compile it takes a third of a process's start.
    """
    left_out = "PYTHONPATH", "PYTHONDONTWRITEBYTECODE"
    return {k: v for k, v in os.environ.items() if not k.endswith("_THREADS") and k not in left_out}


def store(recordings: Iterable[Recording], folder: Path) -> None:
    """Write recordings for workers, so that all read the same events."""
    for recording in recordings:
        events = recording.events
        np.savez(
            folder / f"{recording.case}.npz",
            t=events.t,
            x=events.x,
            y=events.y,
            p=events.p,
            size=(events.width, events.height),
            texts=json.dumps(sorted(recording.texts)),
            starts_us=recording.starts_us,
        )


# Pairs


def run_trials(
    workers: Mapping[str, Reads],
    windows: Sequence[Window],
    rounds: int,
    seed: int = 0,
    alone: Collection[Window] = (),
) -> Iterator[Trial]:
    """Let all read every window once a round, one right after the other, in another order each time.

    The first round is not reported: buffers are made in it.  Windows ``alone`` are read by this tree only.
    """
    rng = random.Random(seed)
    for round_ in range(rounds + 1):
        for window in rng.sample(windows, len(windows)):
            asked = THIS if window in alone else tuple(workers)
            answers = {name: workers[name].ask(window) for name in rng.sample(asked, len(asked))}
            if round_ > 0:
                yield Trial(
                    window,
                    {name: answer["ms"] for name, answer in answers.items()},
                    {name: answer["text"] for name, answer in answers.items()},
                    (seed, round_),
                )


def rows_of(
    name: str, texts: Mapping[str, frozenset[str]], windows: Iterable[Window], trials: Iterable[Trial]
) -> list[Row]:
    """Make rows of ratios, of milliseconds, and of texts.

    Parameters
    ----------
    name
        of the other commit
    texts
        that are right, by case; where there are none, nothing is to be read
    windows
        that the other commit can read; one that this tree cannot has no trial, and counts as not read
    trials
        of these windows, and of those without a code that the other commit leaves out: where nothing moves
    """
    of_window: dict[Window, list[Trial]] = {window: [] for window in windows}
    every = list(trials)
    for trial in every:
        if trial.window in of_window:
            of_window[trial.window].append(trial)
    ratios, times, same = [], [], []
    for case in (*texts, "all"):
        for kind in (*METHODS, NOTHING):
            groups = [
                of_window[w] for w in of_window if case in (w.case, "all") and kind == kind_of(w, texts)
            ]
            if not groups:
                continue
            each = [trial for group in groups for trial in group]
            judged = {"required": REQUIRED} if case == "all" and kind != NOTHING else {}
            for stage, pairs, more in (
                (f"{name} / this", tuple(zip(OTHER, THIS, strict=True)), judged),
                (f"{name} / {name}", (OTHER,), {}),
            ):
                values = [trial.ms[a] / trial.ms[b] for trial in each for a, b in pairs]
                ratios += [row("ratio", case, kind, stage, values, **more)] if values else []
            for stage, readers in (("this", THIS), (name, OTHER)):
                values = [trial.ms[reader] for trial in each for reader in readers]
                right = [t.text[reader] in texts[t.window.case] for t in each for reader in readers]
                read = "" if kind == NOTHING or not right else f"{np.mean(right):.0%}"
                times += [row("window ms", case, kind, stage, values, read=read)] if values else []
            good = [bool(group) and all(as_good(t, texts[t.window.case]) for t in group) for group in groups]
            if case == "all" or not all(good):
                same.append(row("same text", case, kind, "share", [float(np.mean(good))], required=1.0))
                same[-1]["n"] = len(good)
    return [*ratios, *rows_without_code(name, texts, every), *rows_of_views(every), *times, *same]


def rows_without_code(name: str, texts: Mapping[str, frozenset[str]], trials: Iterable[Trial]) -> list[Row]:
    """Make rows of the other commit's time on windows with a code over this tree's on those without.

    Windows differ, so that a pair is a window without a code and the median of those with one in its round.
    """
    cold: dict[tuple[int, int], list[float]] = {}
    without: dict[str, list[Trial]] = {}
    for trial in trials:
        kind = kind_of(trial.window, texts)
        if kind == "cold" and trial.window.case not in cases.VIEWS:
            cold.setdefault(trial.round, []).extend(trial.ms[reader] for reader in OTHER)
        elif kind == NOTHING:
            without.setdefault(trial.window.case.split("-")[0], []).append(trial)
    usual = {round_: float(np.median(values)) for round_, values in cold.items()}
    made = []
    for group, each in without.items():
        values = [
            usual[trial.round] / trial.ms[reader] for trial in each if trial.round in usual for reader in THIS
        ]
        if values:
            required = cases.WITH_OVER_WITHOUT.get(group, "")
            made.append(row("ratio", group, NOTHING, f"{name} with a code / this", values, required=required))
    return made


def rows_of_views(trials: Iterable[Trial]) -> list[Row]:
    """Make the row of this tree's time in a small view over that in a large one: the same code, in pairs."""
    times: dict[str, dict[tuple[object, ...], float]] = {case: {} for case in cases.VIEWS}
    for trial in trials:
        if trial.window.method == "cold" and trial.window.case in times:
            for reader in THIS:
                times[trial.window.case][trial.window.start_us, trial.round, reader] = trial.ms[reader]
    small, large = times.values()
    values = [small[key] / large[key] for key in small if key in large]
    stage = " / ".join(cases.VIEWS)
    return [row("ratio", "views", "cold", stage, values, required=cases.VIEWS_RATIO)] if values else []


def kind_of(window: Window, texts: Mapping[str, frozenset[str]]) -> str | None:
    """Give what a row calls it; None for what is not timed."""
    if texts[window.case]:
        return window.method if window.method in METHODS else None
    return NOTHING if window.method == "cold" else None


def as_good(trial: Trial, right: frozenset[str]) -> bool:
    """Whether this tree read what the other commit did, or what is right."""
    others = {trial.text[reader] for reader in OTHER}
    return all(trial.text[reader] in right | others for reader in THIS)


def time_against(
    ref: str, recordings: Sequence[Recording], device: str, rounds: int
) -> tuple[dict[str, str], list[Row]]:
    """Time this tree against another commit; give what is to be known of it, and rows."""
    other = checked_out(ref)
    name = git("rev-parse", "--short", f"{ref}^{{commit}}")
    texts = {recording.case: recording.texts for recording in recordings}
    trees = dict.fromkeys(THIS, Tree(HERE, Path(sys.executable))) | dict.fromkeys(OTHER, other)
    trials: list[Trial] = []
    with tempfile.TemporaryDirectory() as folder:
        store(recordings, Path(folder))
        for start in range(STARTS):
            with contextlib.ExitStack() as stack:
                workers = {
                    reader: stack.enter_context(contextlib.closing(Worker(tree, device, Path(folder))))
                    for reader, tree in trees.items()
                }
                ready = {reader: worker.ready() for reader, worker in workers.items()}
                (here, versions), (there, their_versions) = ready[THIS[0]], ready[OTHER[0]]
                timed = sorted((window for window in there if kind_of(window, texts)), key=astuple)
                alone = {window for window in here - there if kind_of(window, texts) == NOTHING}
                read = sorted({window for window in timed if window in here} | alone, key=astuple)
                trials += run_trials(workers, read, rounds, start, alone)
    differ = differing(their_versions, versions)
    about = {
        "against": f"{ref}, {name}, in an environment of its own",
        "its packages": "; ".join(differ) or "as here",
    }
    return about, rows_of(name, texts, timed, trials)
