"""The commands that repeat the paper's experiment: `evqr dataset make` and `evqr table1`."""

from __future__ import annotations

from pathlib import Path

import click

from evqr.cli import OK, examples, process_pool


@click.group()
def dataset() -> None:
    """Make the paper's data set again."""


@dataset.command(epilog=examples("evqr dataset make qrecd", "sha256sum -c SHA256SUMS    # in that folder"))
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path, file_okay=False))
@click.option("--jobs", type=click.IntRange(min=1), default=1, metavar="N", help="Scenes made at a time.")
@click.option(
    "--windows",
    type=click.IntRange(min=1),
    metavar="N",
    help="Simulate only so many windows around the middle of each passage; default: the whole passage.",
)
def make(folder: Path, jobs: int, windows: int | None) -> int:
    """Make 18 scenes with truth, a manifest, a card and checksums.

    Three kinds of scene (faster train, slower train, simulator) at three angles with two texts.  What is
    there already is not made again.  A folder of your own recordings needs only a manifest.json of the same
    form.
    """
    from tqdm import tqdm

    from evqr.dataset.make import make_dataset
    from evqr.dataset.scenes import scenes

    specs = list(scenes(most_windows=windows))
    with process_pool(jobs) as pool, tqdm(total=len(specs), unit=" scene", leave=False, disable=None) as bar:
        make_dataset(folder, specs, executor=pool, progress=lambda _: bar.update())
    size = sum(path.stat().st_size for path in folder.iterdir())
    click.echo(f"{folder}: {len(specs)} scenes, {size / 1e6:.0f} MB")
    return OK
