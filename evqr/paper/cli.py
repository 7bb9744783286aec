"""The commands that repeat the paper's experiment: `evqr dataset make` and `evqr table1`."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evqr.cli.options import OK, examples
from evqr.cli.workers import workers
from evqr.errors import UsageError
from evqr.paper.methods.registry import METHODS

if TYPE_CHECKING:
    from evqr.paper.dataset.manifest import Entry


@click.group()
def dataset() -> None:
    """Make the paper's data set again."""


@dataset.command(
    epilog=examples(
        "evqr dataset make qrecd",
        "evqr dataset make others --seed 100 --text 'LOT 4711'",
        "sha256sum -c SHA256SUMS    # in that folder",
    )
)
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path, file_okay=False))
@click.option("--jobs", type=click.IntRange(min=1), default=1, metavar="N", help="Scenes made at a time.")
@click.option(
    "--windows",
    type=click.IntRange(min=1),
    metavar="N",
    help="Simulate only so many windows around the middle of each passage; default: the whole passage.",
)
@click.option(
    "--text",
    "texts",
    multiple=True,
    metavar="TEXT",
    help="Text of the codes, up to what version 2-H holds; default: two texts.  May be repeated.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    metavar="N",
    help="Of texture and noise of the first scene; the others' follow.",
)
def make(folder: Path, jobs: int, windows: int | None, texts: tuple[str, ...], seed: int) -> int:
    """Make 18 scenes with truth, a manifest, a card and checksums.

    Three kinds of scene (faster train, slower train, simulator) at three angles with two texts.  What is
    there already is not made again.  A folder of your own recordings needs only a manifest.json of the same
    form.
    """
    from tqdm import tqdm

    from evqr.paper.dataset.make import make_dataset
    from evqr.paper.dataset.scenes import TEXTS, scenes

    specs = list(scenes(most_windows=windows, texts=texts or TEXTS, seed=seed))
    with workers(jobs) as pool, tqdm(total=len(specs), unit=" scene", leave=False, disable=None) as bar:
        make_dataset(folder, specs, executor=pool, progress=lambda _: bar.update())
    size = sum(path.stat().st_size for path in folder.iterdir())
    click.echo(f"{folder}: {len(specs)} scenes, {size / 1e6:.0f} MB")
    return OK


STRETCHES = (0.5, 2.0)
SHARES = (0.5, 0.35, 0.25, 0.18, 0.12)
SWEEP_TRIALS = 12
QUICK_TRIALS, QUICK_WINDOWS = 2, 130


class TrialsType(click.ParamType):
    """``N`` or ``METHOD=N``."""

    name = "N"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str | None, int]:
        """Return (method, number); the method is None where the number is for all."""
        if isinstance(value, tuple):
            return value
        method, equals, number = str(value).rpartition("=")
        if not (number.isdecimal() and int(number)) or (equals and method not in METHODS):
            self.fail(
                f"{value!r} is no number of trials; write N or METHOD=N, for example bardow=3", param, ctx
            )
        return method or None, int(number)


@click.command(epilog=examples("evqr table1 --quick", "evqr table1 --jobs 8 --trials bardow=3 --out results"))
@click.option("--scenes", metavar="A,B", help="Scenes, by name in the manifest; default: all.")
@click.option("--methods", metavar="A,B", help=f"Of {', '.join(METHODS)}; default: all but bardow_full.")
@click.option("--quick", is_flag=True, help="Two trials a cell on shorter recordings, to see that it works.")
@click.option(
    "--trials",
    type=TrialsType(),
    multiple=True,
    metavar="N|METHOD=N",
    help="Windows or frames a cell, spread evenly over the recording; default: all.  May be repeated.",
)
@click.option("--sweep/--no-sweep", default=None, help="Other windows and fewer events, for the plots.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, metavar="N", help="Cells computed at a time.")
@click.option("--dask", metavar="ADDRESS", help="Compute on the workers of this Dask scheduler.")
@click.option(
    "--dataset",
    "data",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Recordings with a manifest; default: made as by evqr dataset make, in OUT/dataset.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default="table1",
    show_default=True,
    metavar="DIR",
    help="Where results go, and what a killed run goes on from.",
)
def table1(
    scenes: str | None,
    methods: str | None,
    quick: bool,
    trials: tuple[tuple[str | None, int], ...],
    sweep: bool | None,
    jobs: int,
    dask: str | None,
    data: Path | None,
    out: Path,
) -> int:
    """Repeat the paper's Table 1: every method on the same events.

    Writes the table (Markdown, CSV, JSON), the figures, and report.html with all of it into the folder OUT.
    Each cell is kept in a file of its own as soon as it is done, so a run that was killed goes on from there.
    """
    from tqdm import tqdm

    from evqr.output.drawing import figure_class
    from evqr.paper.evaluate.cell import Cell, run_cells
    from evqr.paper.evaluate.details import SINGLE
    from evqr.paper.evaluate.report import About, write_report

    figure_class()  # before the work is done
    chosen = (
        _chosen(methods, METHODS, "method")
        if methods is not None
        else [name for name, row in METHODS.items() if not row.by_name]
    )
    with workers(jobs, dask) as executor:
        data, entries, about = _recordings(data, out, scenes, quick, executor)
        number = {name: QUICK_TRIALS if quick else None for name in METHODS}
        for method, count in trials:
            number |= {name: count for name in ([method] if method else METHODS)}
        table = [
            Cell(recording=e.name, method=m, trials=number[m], quick=quick) for e in entries for m in chosen
        ]
        more: list[Cell] = []
        if sweep or (sweep is None and not quick):
            for entry in entries:
                for method in (m for m in chosen if m in SINGLE):
                    count = min(number[method] or SWEEP_TRIALS, SWEEP_TRIALS)
                    base = Cell(recording=entry.name, method=method, trials=count, quick=quick)
                    more += [replace(base, stretch=stretch) for stretch in STRETCHES]
                    more += [replace(base, keep=share) for share in SHARES]
        cells = [*table, *more]
        with tqdm(total=len(cells), unit=" cell", leave=False, disable=None) as bar:
            results = run_cells(
                data, cells, out / "cells", executor=executor, progress=lambda cell: bar.update()
            )
    command = " ".join(["evqr", *sys.argv[1:]]) if len(sys.argv) > 1 else "evqr table1"
    written = write_report(
        out, results[: len(table)], results[len(table) :], About(command=command, dataset=about)
    )
    click.echo((out / "table1.md").read_text(encoding="utf-8"))
    click.echo("written: " + ", ".join(str(path) for path in written))
    return OK


def _chosen(asked: str | None, known: Iterable[str], what: str) -> list[str]:
    names = list(dict.fromkeys(known))
    if asked is None:
        return names
    wanted = [name.strip() for name in asked.split(",")]
    for name in wanted:
        if name not in names:
            raise UsageError(f"there is no {what} {name!r}; choose of {', '.join(names)}")
    return [name for name in names if name in wanted]


def _recordings(
    data: Path | None, out: Path, scenes: str | None, quick: bool, executor: Executor | None
) -> tuple[Path, list[Entry], str]:
    """Give the folder, its recordings that are asked for, and a line about them; make them where needed."""
    from tqdm import tqdm

    from evqr.paper.dataset.make import make_dataset
    from evqr.paper.dataset.manifest import load_manifest
    from evqr.paper.dataset.scenes import KINDS, TEXTS
    from evqr.paper.dataset.scenes import scenes as all_scenes

    if data is not None:
        entries = load_manifest(data)
        wanted = _chosen(scenes, (entry.scene for entry in entries), "scene")
        chosen = [entry for entry in entries if entry.scene in wanted]
        # the paper takes one text: the first of each scene and angle
        first = {(entry.scene, entry.angle): entry for entry in reversed(chosen)}
        chosen = [entry for entry in chosen if first[entry.scene, entry.angle].text == entry.text]
        for entry in chosen:
            other = first[entry.scene, entry.angle]
            if other is not entry:
                raise UsageError(
                    f"{data}: {other.name!r} and {entry.name!r} both show {entry.text!r} at {entry.angle:g}"
                    f" deg in scene {entry.scene!r}; give one of them another scene in the manifest"
                )
        return (
            data,
            chosen,
            f"{len(chosen)} recordings of {data.name}, the first text of each scene and angle",
        )
    wanted = _chosen(scenes, (kind.name for kind in KINDS), "scene")
    specs = [
        spec
        for spec in all_scenes(most_windows=QUICK_WINDOWS if quick else None)
        if spec.text == TEXTS[0] and spec.kind.name in wanted
    ]
    folder = out / ("dataset-quick" if quick else "dataset")
    with tqdm(total=len(specs), unit=" scene", leave=False, disable=None) as bar:
        made = make_dataset(folder, specs, executor=executor, progress=lambda name: bar.update())
    return folder, made, f"{len(made)} scenes of evqr dataset make" + (", shortened" if quick else "")
