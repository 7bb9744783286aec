"""The commands `evqr info | convert | simulate | demo`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evqr.cli import options
from evqr.cli.options import (
    COMPILING,
    NOTHING,
    OK,
    SizeType,
    VersionType,
    backend_options,
    examples,
    in_options,
    note,
    progress_bar,
    recording_options,
    share_bar,
)
from evqr.cli.sources import STANDARD_INPUT
from evqr.errors import EvqrError, MissingExtra, StreamChoice, UsageError
from evqr.output import records
from evqr.values import json_line

if TYPE_CHECKING:
    from evqr.recording import RecordingOptions


def _one_file(context: click.Context, parameter: click.Parameter, recording: Path) -> Path:
    """Refuse standard input, which evqr read takes beside files."""
    if str(recording) == STANDARD_INPUT and not recording.exists():
        name = context.command.name
        raise UsageError(f"-: standard input is taken by evqr read; save it to a file for evqr {name}")
    return recording


@click.command(
    epilog=examples(
        "evqr info line3.raw --picture line3.png", "evqr info events.txt --sensor 640x480 --time-unit s"
    )
)
@click.argument("recording", metavar="RECORDING", type=click.Path(path_type=Path), callback=_one_file)
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
@recording_options
@click.option(
    "--picture",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Draw what the camera saw to a .png, .svg or .pdf file.",
)
def info(recording: Path, as_json: bool, opening: RecordingOptions, picture: Path | None) -> int:
    """Tell what a recording holds, and anything suspicious in it.

    Of a recording with several event streams their names are told; --stream NAME tells of one.
    """
    from evqr.output.drawing import require_drawable, save_figure
    from evqr.recording import open_recording, summarise

    if picture is not None:
        require_drawable(picture)  # before the work is done
    try:
        with open_recording(recording, **opening) as opened:
            with progress_bar(recording.name) as progress:
                found = summarise(opened, progress=progress)
            if picture is not None:
                from evqr.output.overview import draw_recording

                save_figure(picture, draw_recording(opened, found))
    except StreamChoice as choice:
        record = {"path": str(recording), "streams": list(choice.streams)}
        click.echo(json_line(record) if as_json else records.streams_text(choice.streams))
        return OK
    except EvqrError as error:
        if as_json:
            said = {"status": "error", "reason": in_options(str(error)), "reason_code": error.reason}
            click.echo(json_line({"path": str(recording), **said}))
        raise
    click.echo(json_line(records.info_record(found)) if as_json else records.info_text(found))
    return OK


_THERE = "{}: is there already; choose another name, or write over it with --force"


@click.command(
    epilog=examples(
        "evqr convert line3.raw line3.h5",
        "evqr convert stereo.bag left.aedat4 --stream /left/events",
        "evqr convert long.csv part.raw --sensor 640x480 --start-us 1000000 --end-us 2000000",
    )
)
@click.argument("recording", metavar="IN", type=click.Path(path_type=Path), callback=_one_file)
@click.argument("output", metavar="OUT", type=click.Path(path_type=Path))
@recording_options
@click.option("--force", is_flag=True, help="Write over OUT if it is there.")
def convert(recording: Path, output: Path, opening: RecordingOptions, force: bool) -> int:
    """Write a recording in another format.

    The suffix of OUT names it: .h5, .npz, .txt, .csv, .raw (Prophesee EVT3) or .aedat4.
    """
    from evqr.recording import convert_recording, open_recording
    from evqr.recording.writing import writer_of

    writer_of(output)  # before the work is done
    if output.exists() and (not force or output.samefile(recording)):
        raise UsageError(_THERE.format(output))
    with open_recording(recording, **opening) as opened:
        with progress_bar(recording.name) as progress:
            notes = convert_recording(opened, output, progress=progress)
        for text in (*opened.notes, *notes):
            note(f"{recording}: {text}")
        first, last = opened.t_first_us or 0, opened.t_last_us or 0
        size = f"{opened.width}x{opened.height}"
        click.echo(f"{output}: {opened.n_events:,} events in {(last - first) / 1000:.1f} ms, {size}")
    return OK


@click.command(
    epilog=examples('evqr simulate pass.h5 --text "LOT 42" --preset fast --seed 1', "evqr read pass.h5")
)
@click.argument("output", metavar="OUT.h5", type=click.Path(path_type=Path))
@click.option(
    "--text",
    multiple=True,
    default=["EVQR"],
    show_default=True,
    help="What the code says.  Given several times: as many codes, one behind the other.",
)
@click.option(
    "--symbology",
    default="QRCode",
    show_default=True,
    help="Or MicroQRCode, RMQRCode, DataMatrix, Aztec; as microqr, too.",
)
@click.option(
    "--version", type=VersionType(), metavar="N|M1|R11x27|22x22|F4", help="Default: what holds the text."
)
@click.option(
    "--ec", type=click.Choice(["L", "M", "Q", "H"]), default="M", show_default=True, help="Error correction."
)
@click.option("--mask", type=click.IntRange(0, 7), metavar="0-7", help="Default: as the standard chooses.")
@click.option("--angle", type=float, default=30.0, show_default=True, help="Of the code in the image [deg].")
@click.option("--direction", type=float, default=0.0, show_default=True, help="Of travel in the image [deg].")
@click.option("--speed-px-ms", type=float, help="Speed in the image [px/ms]; default: the preset's.")
@click.option("--module-px", type=float, default=6.0, show_default=True, help="Width of a module [px].")
@click.option(
    "--preset",
    type=click.Choice(["clean", "slow", "fast", "hard"]),
    default="clean",
    show_default=True,
    help="The sensor and the light.",
)
@click.option(
    "--turn-radius-px",
    type=float,
    help="It turns with a turntable, so far from the axis; default: straight [px].",
)
@click.option("--tilt", type=float, default=0.0, show_default=True, help="Of the object's plane [deg].")
@click.option("--invert", is_flag=True, help="Print light on dark.")
@click.option("--gs1", is_flag=True, help="Texts are GS1 messages, as (01)09506000134352(10)LOT42.")
@click.option("--eci", type=click.IntRange(0, 999_999), metavar="N", help="ECI designator, as 26 for UTF-8.")
@click.option("--charset", metavar="NAME", help="Character set of the text, as utf-8; default: of the ECI.")
@click.option("--append", is_flag=True, help="The texts are parts of one message (structured append).")
@click.option(
    "--application", metavar="AI", help="Application indicator, two digits or a letter (FNC1 second)."
)
@click.option("--no-code", is_flag=True, help="Print things that look a little like a code, but no code.")
@click.option(
    "--sensor", type=SizeType(), metavar="WxH", default="640x480", show_default=True, help="Sensor size."
)
@click.option("--duration-us", type=click.IntRange(min=1), metavar="N", help="Default: long enough to read.")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    metavar="N",
    default=0,
    show_default=True,
    help="Of textures and noise.",
)
@click.option("--force", is_flag=True, help="Write over OUT if it is there.")
def simulate(
    output: Path,
    text: tuple[str, ...],
    symbology: str,
    version: int | str | None,
    ec: Any,
    mask: int | None,
    angle: float,
    direction: float,
    speed_px_ms: float | None,
    module_px: float,
    preset: str,
    turn_radius_px: float | None,
    tilt: float,
    invert: bool,
    gs1: bool,
    eci: int | None,
    charset: str | None,
    append: bool,
    application: str | None,
    no_code: bool,
    sensor: tuple[int, int],
    duration_us: int | None,
    seed: int,
    force: bool,
) -> int:
    """Write a recording of simulated codes.

    A textured object with a printed code passes an event camera; the recording holds events and truth.
    """
    from evqr.device import cache_of, kernels_on
    from evqr.recording.writing import save_recording, writer_of
    from evqr.simulate import simulate as run_simulation
    from evqr.simulate.sensor import needs_compile

    writer_of(output, truth=True)  # before the work is done
    if not output.parent.is_dir():
        raise UsageError(f"{output}: there is no folder {output.parent}")
    if output.exists() and not force:
        raise UsageError(_THERE.format(output))
    if needs_compile():
        note(COMPILING.format(cache_of(kernels_on("warp", "cpu"))))
    with share_bar(output.name) as progress:
        made = run_simulation(
            text,
            symbology=symbology,
            version=version,
            ec=ec,
            mask=mask,
            angle=angle,
            direction=direction,
            speed_px_ms=speed_px_ms,
            module_px=module_px,
            preset=preset,
            turn_radius_px=turn_radius_px,
            tilt=tilt,
            invert=invert,
            gs1=gs1,
            eci=eci,
            charset=charset,
            append=append,
            application=application,
            code=not no_code,
            width=sensor[0],
            height=sensor[1],
            duration_us=duration_us,
            seed=seed,
            progress=progress,
        )
    save_recording(output, made.events, truth=made.truth)
    events = made.events
    duration_ms = (int(events.t[-1]) - int(events.t[0])) / 1000 if len(events) else 0.0
    click.echo(f"{output}: {len(events):,} events in {duration_ms:.1f} ms, {events.width}x{events.height}")
    return OK


@click.command(epilog=examples("evqr demo --picture demo.png"))
@click.option(
    "--picture",
    type=click.Path(path_type=Path),
    default="evqr-demo.png",
    show_default=True,
    metavar="FILE",
    help="Where the picture goes.",
)
@backend_options
def demo(picture: Path, backend: str, device: str, threads: int | None) -> int:
    """Read the recording that comes with evqr.

    Prints what was read and draws how: events, events with the motion taken out and the outline found,
    estimated modules beside the true ones.
    """
    from evqr.demo import demo_recording, demo_truth
    from evqr.offline import read_codes
    from evqr.output.drawing import require_drawable
    from evqr.output.picture import picture_events, save_picture
    from evqr.recording import open_recording

    without = ""
    try:
        require_drawable(picture)
    except MissingExtra as missing:
        without = str(missing)
    options.prepare(backend, device)
    with demo_recording() as path, open_recording(path) as recording:
        with progress_bar(path.name) as progress:
            result = read_codes(recording, backend=backend, device=device, threads=threads, progress=progress)
        click.echo(records.result_text(result))
        if result.readings and not without:
            reading = result.readings[0]
            save_picture(picture, picture_events(recording, reading), reading, truth=demo_truth(path))
            click.echo(f"picture: {picture}")
    if without:
        note(f"no picture is drawn: {without}")
    return OK if result.readings else NOTHING
