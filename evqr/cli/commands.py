"""The commands `evqr read | info | simulate | demo`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evqr.cli.options import (
    BAD,
    COMPILING,
    NOTHING,
    OK,
    LagType,
    SizeType,
    VersionType,
    backend_options,
    examples,
    note,
    process_pool,
    progress_bar,
    recording_options,
)
from evqr.errors import StreamChoice, UsageError
from evqr.output import records
from evqr.results import ReadResult, ReadStatus
from evqr.values import json_line

if TYPE_CHECKING:
    from evqr.config import ReadConfig
    from evqr.recording import Recording, RecordingOptions


@click.command(
    epilog=examples(
        "evqr read line3.raw",
        "evqr read line3.h5 --json --picture line3.png",
        "evqr read shift1/*.h5 --json --jobs 4",
        "evqr read line3.h5 --each-window --max-windows 10",
    )
)
@click.argument(
    "recordings", nargs=-1, required=True, metavar="RECORDING...", type=click.Path(path_type=Path)
)
@click.option(
    "--json", "as_json", is_flag=True, help="One JSON object a line on stdout, and nothing else there."
)
@recording_options
@click.option(
    "--window-us",
    type=click.IntRange(min=1),
    metavar="N",
    help="Length of a window; default: about 2 px of motion.",
)
@click.option("--max-windows", type=click.IntRange(min=1), metavar="N", help="Take at most so many windows.")
@click.option("--each-window", is_flag=True, help="Read windows one by one, each from cold, a line each.")
@click.option(
    "--vote",
    type=click.Choice(["mode", "soft", "information"]),
    help="How windows are combined; default: information.",
)
@click.option(
    "--lag-us",
    type=LagType(),
    metavar="ON,OFF",
    help="Lags of the pixels, in microseconds; default: estimated.",
)
@click.option(
    "--charset",
    metavar="NAME",
    help="Character set of codes that do not name theirs, as utf-8 or shift_jis; default: guessed.",
)
@backend_options
@click.option("--jobs", type=click.IntRange(min=1), default=1, metavar="N", help="Recordings read at a time.")
@click.option("--picture", type=click.Path(path_type=Path), metavar="FILE", help="Draw the first reading.")
def read(
    recordings: tuple[Path, ...],
    as_json: bool,
    opening: RecordingOptions,
    window_us: int | None,
    max_windows: int | None,
    each_window: bool,
    vote: str | None,
    lag_us: tuple[float, float] | None,
    charset: str | None,
    backend: str,
    device: str,
    threads: int | None,
    jobs: int,
    picture: Path | None,
) -> int:
    """Read every code that passes, each once.

    Exit status: 0 when something was read, 1 when nothing was read, 2 when any recording could not be used.
    """
    if len(recordings) != 1 and (each_window or picture):
        raise UsageError(
            f"{'--each-window' if each_window else '--picture'} takes one recording: name only one"
        )
    if each_window and picture:
        raise UsageError("--picture draws a reading of the whole recording: leave out --each-window")
    if picture:
        from evqr.output.picture import require_drawable

        require_drawable(picture)
    config = _read_config(charset, window_us=window_us, max_windows=max_windows, lag_us=lag_us, vote=vote)
    compute = {"config": config, "backend": backend, "device": device}
    if len(recordings) != 1:
        _prepare(backend, device)
        return _read_many(recordings, jobs, as_json, threads=threads, **opening, **compute)

    from evqr.recording import open_recording

    with open_recording(recordings[0], **opening) as recording:
        _prepare(backend, device)
        if each_window:
            status = _read_each_window(recording, as_json, threads=threads, **compute)
        else:
            status = _read_one(recording, as_json, picture, threads=threads, **compute)
    return status


def _read_config(charset: str | None, **given: Any) -> ReadConfig:
    from evqr.config import DecodeConfig, ReadConfig

    try:
        given["decode"] = DecodeConfig(charset=charset)
        return ReadConfig(**{name: value for name, value in given.items() if value is not None})
    except (TypeError, ValueError) as error:
        raise UsageError(str(error)) from error


def _prepare(backend: str, device: str) -> None:
    """Refuse a backend or a device that is not there; compile kernels that are not yet, and say so."""
    from evqr.device import kernels_on
    from evqr.launched import LAUNCHED

    kernels = kernels_on(backend, device)
    if kernels.needs_compile(device, LAUNCHED):
        note(COMPILING)
        kernels.load(device, LAUNCHED)


def _read_one(recording: Recording, as_json: bool, picture: Path | None, **options: Any) -> int:
    from evqr.offline import read_codes

    with progress_bar(Path(recording.path).name) as progress:
        result = read_codes(recording, progress=progress, **options)
    _show(result, as_json, {})
    _warn(recording.path, _warnings(result))
    if picture and result.readings:
        from evqr.output.picture import picture_events, save_picture

        reading = result.readings[0]
        save_picture(picture, picture_events(recording, reading), reading)
    elif picture:
        note(f"nothing read: {picture} is not drawn")
    return _exit_status([result.status])


def _read_each_window(recording: Recording, as_json: bool, **options: Any) -> int:
    from evqr.offline import read_windows

    statuses = []
    for window in read_windows(recording, **options):
        click.echo(window.to_json() if as_json else records.window_text(window))
        statuses.append(window.status)
    _warn(recording.path, recording.notes)
    return _exit_status(statuses)


def _read_many(recordings: tuple[Path, ...], jobs: int, as_json: bool, **options: Any) -> int:
    from tqdm import tqdm

    from evqr.many import read_many

    statuses = []
    with process_pool(jobs) as pool:
        results = read_many(recordings, executor=pool, **options)
        # disable=None: no bar where stderr is no terminal
        for path, result in zip(
            tqdm(recordings, unit=" recording", leave=False, disable=None), results, strict=True
        ):
            with tqdm.external_write_mode():
                if not as_json:
                    click.echo(f"{path}:")
                _show(result, as_json, {"recording": str(path)})
                _warn(str(path), _warnings(result))
            statuses.append(result.status)
    return _exit_status(statuses)


def _show(result: ReadResult, as_json: bool, extra: dict[str, Any]) -> None:
    if as_json:
        for record in records.result_records(result):
            click.echo(json_line({**extra, **record}))
    else:
        click.echo(records.result_text(result))


def _warnings(result: ReadResult) -> list[str]:
    """Return what was odd about a recording and its codes, each once."""
    odd = (text for reading in result.readings for text in (*reading.warnings, reading.gs1_error) if text)
    return list(dict.fromkeys((*result.warnings, *odd)))


def _warn(path: str, warnings: Sequence[str]) -> None:
    for warning in warnings:
        note(f"{path}: {warning}")


def _exit_status(statuses: Sequence[ReadStatus]) -> int:
    if ReadStatus.ERROR in statuses:
        return BAD
    return OK if ReadStatus.READ in statuses else NOTHING


@click.command(epilog=examples("evqr info line3.raw", "evqr info events.txt --sensor 640x480 --time-unit s"))
@click.argument("recording", metavar="RECORDING", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
@recording_options
def info(recording: Path, as_json: bool, opening: RecordingOptions) -> int:
    """Tell what a recording holds, and anything suspicious in it.

    Of a recording with several event streams their names are told; --stream NAME tells of one.
    """
    from evqr.recording import open_recording, summarise

    try:
        with open_recording(recording, **opening) as opened:
            found = summarise(opened)
    except StreamChoice as choice:
        record = {"path": str(recording), "streams": list(choice.streams)}
        click.echo(json_line(record) if as_json else records.streams_text(choice.streams))
        return OK
    click.echo(json_line(records.info_record(found)) if as_json else records.info_text(found))
    return OK


@click.command(
    epilog=examples(
        "evqr convert line3.raw line3.h5",
        "evqr convert stereo.bag left.aedat4 --stream /left/events",
        "evqr convert long.csv part.raw --sensor 640x480 --start-us 1000000 --end-us 2000000",
    )
)
@click.argument("recording", metavar="IN", type=click.Path(path_type=Path))
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
        raise UsageError(f"{output}: is there already; choose another name, or write over it with --force")
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
    "--symbology", default="QRCode", show_default=True, help="Or MicroQRCode; in any case, as microqr."
)
@click.option("--version", type=VersionType(), metavar="1-40|M1-M4", help="Default: the smallest that fits.")
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
@click.option("--tilt", type=float, default=0.0, show_default=True, help="Of the object's plane [deg].")
@click.option("--invert", is_flag=True, help="Print light on dark.")
@click.option("--gs1", is_flag=True, help="Texts are GS1 messages, as (01)09506000134352(10)LOT42.")
@click.option("--eci", type=click.IntRange(0, 999_999), metavar="N", help="ECI designator, as 26 for UTF-8.")
@click.option("--charset", metavar="NAME", help="Character set of the text, as utf-8; default: of the ECI.")
@click.option("--append", is_flag=True, help="The texts are parts of one message (structured append).")
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
    tilt: float,
    invert: bool,
    gs1: bool,
    eci: int | None,
    charset: str | None,
    append: bool,
    no_code: bool,
    sensor: tuple[int, int],
    duration_us: int | None,
    seed: int,
) -> int:
    """Write a recording of simulated codes.

    A textured object with a printed code passes an event camera; the recording holds events and truth.
    """
    from evqr.recording.writing import save_recording, writer_of
    from evqr.simulate import simulate as run_simulation
    from evqr.simulate.sensor import needs_compile

    writer_of(output, truth=True)  # before the work is done
    if needs_compile():
        note(COMPILING)
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
        tilt=tilt,
        invert=invert,
        gs1=gs1,
        eci=eci,
        charset=charset,
        append=append,
        code=not no_code,
        width=sensor[0],
        height=sensor[1],
        duration_us=duration_us,
        seed=seed,
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
    from evqr.output.picture import picture_events, require_drawable, save_picture
    from evqr.recording import open_recording

    require_drawable(picture)
    _prepare(backend, device)
    with demo_recording() as path, open_recording(path) as recording:
        with progress_bar(path.name) as progress:
            result = read_codes(recording, backend=backend, device=device, threads=threads, progress=progress)
        _show(result, False, {})
        if result.readings:
            reading = result.readings[0]
            save_picture(picture, picture_events(recording, reading), reading, truth=demo_truth(path))
            click.echo(f"picture: {picture}")
    return _exit_status([result.status])
