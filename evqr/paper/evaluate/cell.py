"""Cells of the table, a method on a recording each: computed anywhere, kept in a file of their own."""

from __future__ import annotations

import base64
import functools
import json
import os
import platform
import subprocess
import zlib
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, Future, as_completed
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.errors import UsageError
from evqr.events.window import Window
from evqr.paper.dataset.manifest import Entry, Sequence, load_manifest, load_sequence, write_atomically
from evqr.paper.dataset.truth import Modules, Truth
from evqr.paper.evaluate.metrics import Score, Trial, score
from evqr.paper.evaluate.picture import picture_of
from evqr.paper.evaluate.trial import run_trial
from evqr.paper.methods.method import Method
from evqr.paper.methods.registry import METHODS, make_method

EVALUATION = 3
"""Raised when cells would come out otherwise, whatever the method: older files are then computed again."""

SEED = 20
"""Of the events that are left out where a cell keeps a share of them."""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """What is to be computed.

    Attributes
    ----------
    recording : str
        Name in the manifest.
    method : str
        Name in `METHODS`.
    trials : int, optional
        Windows or frames, spread evenly over the recording; None: all.
    stretch : float
        Length of the windows, of the manifest's.
    keep : float
        Share of the events that is kept, at random.
    quick : bool
        Whether methods that take long give up earlier.
    """

    recording: str
    method: str
    trials: int | None = None
    stretch: float = 1.0
    keep: float = 1.0
    quick: bool = False

    @property
    def name(self) -> str:
        """Name of its file."""
        parts = [self.recording, self.method]
        parts += [f"x{self.stretch:g}"] if self.stretch != 1.0 else []
        parts += [f"keep{self.keep:g}"] if self.keep != 1.0 else []
        parts += [f"n{self.trials}"] if self.trials is not None else []
        parts += ["quick"] if self.quick else []
        return "--".join(parts)


@dataclass(frozen=True, kw_only=True, eq=False)
class CellResult:
    """A cell, computed.

    Attributes
    ----------
    cell : Cell
        What was computed.
    entry : Entry
        Of the manifest.
    trials : tuple of Trial
        In order of time.
    picture : (Y, X) uint8, optional
        What the method saw or made of the middle trial, around the code; None without.
    speed_px_ms : float [px/ms]
        True speed of the code, 0 where it is not known.
    machine : str
        Where it was computed.
    source : str
        What computed it.
    """

    cell: Cell
    entry: Entry
    trials: tuple[Trial, ...]
    picture: NDArray[np.uint8] | None
    speed_px_ms: float
    machine: str
    source: str

    @property
    def truth(self) -> Truth:
        """What is true of the code."""
        return self.entry.truth()

    @functools.cached_property
    def score(self) -> Score:
        """All metrics."""
        return score(self.trials, self.truth)


def run_cell(folder: Path, entry: Entry, cell: Cell) -> dict[str, Any]:
    """Compute a cell; the result is what its file holds."""
    method = make_method(cell.method, entry.version, quick=cell.quick)
    sequence = load_sequence(folder, entry)
    rng = np.random.default_rng(SEED)
    trials, picture = [], None
    inputs = _inputs(method, sequence, cell)
    for index, place in enumerate(inputs):
        seen = _seen(method, sequence, place, cell, rng)
        trial, outcome = run_trial(method, seen, sequence)
        trials.append(trial)
        if index == len(inputs) // 2:
            time_us = outcome.time_us
            if time_us is None:
                time_us = seen.middle_us if isinstance(seen, Window) else sequence.frame_t_us[place]
            picture = picture_of(outcome, time_us, sequence)
    return {
        **_key(folder, entry, cell),
        "machine": machine(),
        "source": source(),
        "speed_px_ms": 1e3 * float(np.hypot(*sequence.velocity)),
        "trials": [_record(trial) for trial in trials],
        "picture": None if picture is None else {"shape": picture.shape, "zlib": _packed(picture)},
    }


def machine() -> str:
    """Say what computes: processor and how many of them."""
    name = platform.processor() or platform.machine()
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
        name = next(
            line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")
        )
    except (OSError, StopIteration):
        pass
    return f"{name}, {os.cpu_count()} CPUs, {platform.system()}"


@functools.cache
def source() -> str:
    """Say which version of evqr this is, and of which commit where it runs from a clone."""
    here = Path(__file__)

    def git(*arguments: str) -> str:
        done = subprocess.run(
            ["git", *arguments], cwd=here.parent, capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    try:
        git("ls-files", "--error-unmatch", here.name)  # installed below some other repository it is not its
        commit = git("describe", "--always", "--dirty", "--abbrev=10")
    except (OSError, subprocess.CalledProcessError):
        return f"evqr {version('evqr')}"
    return f"evqr {version('evqr')}, commit {commit}"


def _inputs(method: Method, sequence: Sequence, cell: Cell) -> list[int]:
    """Windows at which trials begin, or numbers of frames."""
    if method.takes == "frame":
        count = len(sequence.frames)
    else:
        count = int(sequence.windows - max(1.0, cell.stretch * method.windows)) + 1
    if count <= 0 or cell.trials is None or cell.trials >= count:
        return list(range(max(count, 0)))
    # the middles of as many equal parts
    return [int((k + 0.5) * count / cell.trials) for k in range(cell.trials)]


def _seen(method: Method, sequence: Sequence, place: int, cell: Cell, rng: np.random.Generator) -> Any:
    if method.takes == "frame":
        return sequence.frames[place]
    window = sequence.window(place, cell.stretch * method.windows)
    return window if cell.keep == 1.0 else window.keep(rng.random(len(window)) < cell.keep)


def _key(folder: Path, entry: Entry, cell: Cell) -> dict[str, Any]:
    """Give what a kept cell must agree in to be the one that is asked for."""
    settings = {
        "evaluation": EVALUATION + METHODS[cell.method].revision,
        "cell": asdict(cell),
        "entry": asdict(entry),
        "bytes": (folder / entry.recording).stat().st_size if (folder / entry.recording).is_file() else 0,
    }
    return json.loads(json.dumps(settings))


def run_cells(
    dataset: Path,
    cells: Iterable[Cell],
    kept: Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[Cell], object] | None = None,
) -> list[CellResult]:
    """Compute the cells that are not kept yet, and keep each as soon as it is done.

    Parameters
    ----------
    dataset : Path
        Folder with a manifest.
    cells : iterable of Cell
        What is to be computed; those that are kept already are not computed again.
    kept : Path
        Folder of the cells' files.
    executor : Executor, optional
        Any `concurrent.futures.Executor`, Dask's ``client.get_executor()`` included, whose workers see
        ``dataset`` under the same path; None: in this thread.
    progress : callable, optional
        Called with each cell that is there.

    Raises
    ------
    UsageError
        A cell names a recording that the manifest does not have.
    """
    kept.mkdir(parents=True, exist_ok=True)
    entries = {entry.name: entry for entry in load_manifest(dataset)}
    cells = list(cells)
    for cell in cells:
        if cell.recording not in entries:
            raise UsageError(f"{dataset}: the manifest has no recording {cell.recording!r}")
    tell = progress or (lambda cell: None)
    pending: dict[Future[dict[str, Any]], Cell] = {}
    try:
        for cell in cells:
            entry = entries[cell.recording]
            if _load(kept, cell, _key(dataset, entry, cell)) is not None:
                tell(cell)
            elif executor is None:
                _keep(kept, cell, run_cell(dataset, entry, cell))
                tell(cell)
            else:
                pending[executor.submit(run_cell, dataset, entry, cell)] = cell
        for done in as_completed(pending):
            _keep(kept, pending[done], done.result())
            tell(pending[done])
    finally:
        for future in pending:
            future.cancel()
    results = []
    for cell in cells:
        record = _load(kept, cell, _key(dataset, entries[cell.recording], cell))
        assert record is not None, f"{cell.name} was computed and kept"
        results.append(_result(cell, entries[cell.recording], record))
    return results


def _keep(kept: Path, cell: Cell, record: dict[str, Any]) -> None:
    write_atomically(kept / f"{cell.name}.json", json.dumps(record))


def _load(kept: Path, cell: Cell, key: Mapping[str, Any]) -> dict[str, Any] | None:
    """Give a kept cell, None where there is none or it is of something else."""
    try:
        record = json.loads((kept / f"{cell.name}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if all(record.get(name) == value for name, value in key.items()) else None


def _result(cell: Cell, entry: Entry, record: Mapping[str, Any]) -> CellResult:
    picture = record["picture"]
    size = len(entry.truth().modules)
    return CellResult(
        cell=cell,
        entry=entry,
        trials=tuple(_trial(trial, size) for trial in record["trials"]),
        picture=None
        if picture is None
        else _unpacked(picture["zlib"]).view(np.uint8).reshape(picture["shape"]),
        speed_px_ms=record["speed_px_ms"],
        machine=record["machine"],
        source=record.get("source", "not recorded"),
    )


def _record(trial: Trial) -> dict[str, Any]:
    record = {field.name: getattr(trial, field.name) for field in fields(Trial)}
    record["modules"] = None if trial.modules is None else _packed(trial.modules)
    return record


def _trial(record: Mapping[str, Any], size: int) -> Trial:
    modules: Modules | None = None
    if record["modules"] is not None:
        modules = _unpacked(record["modules"]).reshape(size, size)
    return Trial(**{**record, "modules": modules})


def _packed(array: NDArray[Any]) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(array).tobytes())).decode("ascii")


def _unpacked(text: str) -> NDArray[np.int8]:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), np.int8)
