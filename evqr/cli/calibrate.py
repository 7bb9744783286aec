"""The command `evqr calibrate`: how the pixels of a sensor respond, to a file that other commands take."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from evqr.cli import options
from evqr.cli.options import NOTHING, OK, examples, recording_options, share_bar
from evqr.errors import UsageError

if TYPE_CHECKING:
    from evqr.recording import RecordingOptions


@click.command(
    epilog=examples("evqr calibrate line3.raw line3.json", "evqr read --sensor-profile line3.json line3.raw")
)
@click.argument("recording", type=click.Path(path_type=Path))
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--force", is_flag=True, help="Write over OUT if it is there.")
@recording_options
def calibrate(recording: Path, out: Path, force: bool, opening: RecordingOptions) -> int:
    """Find out how the pixels of a sensor respond, from a RECORDING with a code in it.

    The time constants with which most of its windows are read, each alone, are written to OUT, which read,
    batch and watch take by --sensor-profile. They hold for this sensor, its biases and this light.

    Exit status: 0 when OUT is written, 1 when no window is read, 2 for bad input.
    """
    from evqr.calibrate import calibrate as calibrated

    if out.exists() and not force:
        raise UsageError(f"{out}: is there already; name another file, or take --force")
    with share_bar(str(recording)) as progress:
        profile = calibrated(str(recording), progress=progress, **opening)
    if profile is None:
        options.note(f"{recording}: no window is read, whatever the pixels' time constants", important=True)
        return NOTHING
    profile.write(out)
    on, off = profile.lag_us
    click.echo(f"{out}: ON events lag by {on:g} us, OFF events by {off:g} us")
    return OK
