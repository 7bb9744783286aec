"""The command `evqr batch`."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from evqr.cli import options
from evqr.cli.options import backend_options, config_options, recording_options
from evqr.cli.read import exit_status
from evqr.cli.sources import STANDARD_INPUT, recordings_of
from evqr.cli.workers import prepare, workers
from evqr.errors import UsageError
from evqr.results import ReadStatus

if TYPE_CHECKING:
    from evqr.config import ReadConfig
    from evqr.recording import RecordingOptions


@click.command(
    epilog=options.examples(
        "evqr batch archive/ --out archive.db --jobs 8",
        "evqr batch 'shift*/*.raw' --out shifts.db --dask tcp://scheduler:8786",
        'sqlite3 archive.db "SELECT path, text FROM parts JOIN recordings ON id = recording"',
    )
)
@click.argument("sources", nargs=-1, required=True, metavar="RECORDING...", type=click.Path())
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="DB",
    help="The SQLite file; what is in it already is not read again.",
)
@click.option("--quiet", is_flag=True, help="No notes and progress; errors are told.")
@recording_options
@config_options
@backend_options
@click.option("--jobs", type=click.IntRange(min=1), default=1, metavar="N", help="Recordings read at a time.")
@click.option("--dask", metavar="ADDRESS", help="Read on the workers of this Dask scheduler.")
def batch(
    sources: tuple[str, ...],
    out: Path,
    quiet: bool,
    opening: RecordingOptions,
    config: ReadConfig,
    backend: str,
    device: str,
    threads: int | None,
    jobs: int,
    dask: str | None,
) -> int:
    """Read an archive into a database, a row a part.

    RECORDING is a file, a folder (the recordings in it) or a pattern in quotes. A run that was ended goes on
    where it was: recordings that are in the database, and have not changed since, are not read again; those
    that could not be read are. Rows do not depend on where and in which order recordings are read.

    Exit status, of all recordings that are named: as of evqr read.
    """
    from tqdm import tqdm

    from evqr.archive import read_archive
    from evqr.output.database import ReadingsDatabase

    options.be_quiet(quiet)
    if STANDARD_INPUT in sources:
        raise UsageError("-: standard input is taken by evqr read; save it to a file for evqr batch")
    if dask is not None and jobs > 1:
        raise UsageError("--dask computes on the workers of its scheduler: leave out --jobs")
    settings = {**config.changed(), **opening}
    with recordings_of(sources) as recordings, ReadingsDatabase(out, settings) as database:
        paths = list(dict.fromkeys(named.path for named in recordings if named.path != out))
        pending = database.pending(paths)
        compute = {"config": config, "backend": backend, "device": device, "threads": threads, **opening}
        # disable=None: no bar where stderr is no terminal
        with tqdm(
            total=len(paths), initial=len(paths) - len(pending), unit=" recording", leave=False,
            disable=True if quiet else None,
        ) as bar:  # fmt: skip
            for path, result in read_archive(
                pending, database, workers=partial(_ready_workers, jobs, dask, backend, device), **compute
            ):
                if result.status is ReadStatus.ERROR:
                    with bar.external_write_mode():
                        options.note(_of(path, result.reason), important=True)
                bar.update()
        outcomes = database.statuses(paths)
    count = {status: sum(status is found for found, _ in outcomes) for status in ReadStatus}
    click.echo(
        f"{out}: {len(paths)} recordings, {len(paths) - len(pending)} of them there already;"
        f" {count[ReadStatus.READ]} with codes, {count[ReadStatus.NO_READ]} without,"
        f" {count[ReadStatus.ERROR]} could not be read"
    )
    return exit_status(outcomes)


@contextmanager
def _ready_workers(jobs: int, dask: str | None, backend: str, device: str) -> Iterator[Executor | None]:
    """Give what computes, with its kernels prepared; workers of a Dask scheduler load them."""
    with workers(jobs, dask) as executor:
        if dask is None:
            prepare(executor, jobs, backend, device)
        yield executor


def _of(path: Path, reason: str) -> str:
    return reason if str(path) in reason else f"{path}: {reason}"
