"""The command line: `evqr read | info | simulate | demo`, and what `cli_paper` adds.

Results go to stdout; progress, notes and errors go to stderr.  Exit status: 0 something was read, 1 nothing
was read, 2 bad input or bad use, 130 interrupted.
"""

from __future__ import annotations

import importlib
import io
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import click

from evqr import report
from evqr.errors import EvqrError, UsageError
from evqr.types import ReadResult, ReadStatus

if TYPE_CHECKING:
    from evqr.config import ReadConfig
    from evqr.recording import Recording
    from evqr.recording.source import TimeUnit

OK, NOTHING, BAD, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 130, 141

COMPILING = "compiling kernels for this machine (first run only) ..."


class SizeType(click.ParamType):
    """``WxH`` in pixels."""

    name = "WxH"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        """Return (width, height)."""
        if isinstance(value, tuple):
            return value
        width, _, height = str(value).lower().partition("x")
        if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
            self.fail(
                f"{value!r} is no sensor size; write it as width x height, for example 640x480", param, ctx
            )
        return int(width), int(height)


class LagType(click.ParamType):
    """``ON,OFF`` in microseconds."""

    name = "ON,OFF"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float]:
        """Return the lags of ON and of OFF events [us]."""
        if isinstance(value, tuple):
            return value
        try:
            on, off = (float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(
                f"{value!r} is no pair of lags; write microseconds as ON,OFF, for example 300,600", param, ctx
            )
        return on, off


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its status."""
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(
            errors="backslashreplace"
        )  # a text that the terminal cannot show is no failure
    try:
        # Not click's own main, which gives a closed pipe the status that here means "nothing read".
        with evqr.make_context("evqr", list(sys.argv[1:] if arguments is None else arguments)) as context:
            status = evqr.invoke(context)
        sys.stdout.flush()
        return status
    except click.exceptions.Exit as done:  # --help, --version
        return done.exit_code
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "evqr"
        return _refuse(f"{error.format_message()} (see '{command} --help')")
    except click.ClickException as error:
        return _refuse(error.format_message())
    except EvqrError as error:
        return _refuse(str(error))
    except KeyboardInterrupt:
        click.echo("evqr: interrupted", err=True)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of our output left; Python would complain once more when it flushes stdout at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_CLOSED


def _refuse(message: str) -> int:
    click.echo(f"evqr: {' '.join(message.split())}", err=True)
    return BAD


def note(message: str) -> None:
    """Say something that is no result."""
    click.echo(f"evqr: {message}", err=True)


def examples(*lines: str) -> str:
    """Give a command's epilog."""
    return "\b\nExamples:\n" + "\n".join(
        f"  {line}" for line in lines
    )  # \b: click leaves the lines as they are


class _Commands(click.Group):
    """Commands, some of which live in modules that are imported when they are first asked for."""

    elsewhere: ClassVar = {"dataset": "evqr.cli_paper", "table1": "evqr.cli_paper"}

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted([*super().list_commands(ctx), *self.elsewhere])

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in self.elsewhere:
            return getattr(importlib.import_module(self.elsewhere[cmd_name]), cmd_name)
        return super().get_command(ctx, cmd_name)


@click.group(
    cls=_Commands,
    no_args_is_help=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=examples("evqr demo", "evqr read line3.raw"),
)
@click.version_option(package_name="evqr", message="evqr %(version)s")
def evqr() -> None:
    """Read 2-D codes from event-camera recordings."""


def _recording_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say what a recording does not."""
    for option in (
        click.option(
            "--time-unit",
            type=click.Choice(["us", "ms", "s", "ns"]),
            help="Unit of the stored time stamps, where the recording does not tell.",
        ),
        click.option(
            "--sensor", type=SizeType(), metavar="WxH", help="Sensor size, where the recording does not tell."
        ),
    ):
        command = option(command)
    return command


def _backend_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say where to compute."""
    for option in (
        click.option(
            "--threads",
            type=click.IntRange(min=1),
            metavar="N",
            help="Windows worked on at a time, a CPU thread each; default 1.",
        ),
        click.option(
            "--device", default="cpu", show_default=True, help='Where to compute: "cpu", "cuda:0", ...'
        ),
        click.option(
            "--backend",
            type=click.Choice(["auto", "warp", "taichi", "numpy"]),
            default="auto",
            show_default=True,
            help="What runs the kernels.",
        ),
    ):
        command = option(command)
    return command


@evqr.command(
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
@_recording_options
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
@_backend_options
@click.option("--jobs", type=click.IntRange(min=1), default=1, metavar="N", help="Recordings read at a time.")
@click.option("--picture", type=click.Path(path_type=Path), metavar="FILE", help="Draw the first reading.")
def read(
    recordings: tuple[Path, ...],
    as_json: bool,
    sensor: tuple[int, int] | None,
    time_unit: TimeUnit | None,
    window_us: int | None,
    max_windows: int | None,
    each_window: bool,
    vote: str | None,
    lag_us: tuple[float, float] | None,
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
        from evqr.picture import require_drawable

        require_drawable(picture)
    config = _read_config(window_us=window_us, max_windows=max_windows, lag_us=lag_us, vote=vote)
    compute = {"config": config, "backend": backend, "device": device}
    told = {"sensor": sensor, "time_unit": time_unit}
    if len(recordings) != 1:
        _prepare(backend, device)
        return _read_many(recordings, jobs, as_json, threads=threads, **told, **compute)

    from evqr.recording import open_recording

    with open_recording(recordings[0], **told) as recording:
        _prepare(backend, device)
        if each_window:
            status = _read_each_window(recording, as_json, threads=threads, **compute)
        else:
            status = _read_one(recording, as_json, picture, threads=threads, **compute)
        for warning in recording.warnings:
            note(f"{recording.path}: {warning}")
        return status


def _read_config(**given: Any) -> ReadConfig:
    from evqr.config import ReadConfig, Vote

    given = {name: value for name, value in given.items() if value is not None}
    if "vote" in given:
        given["vote"] = Vote(given["vote"])
    try:
        return ReadConfig(**given)
    except ValueError as error:
        raise UsageError(str(error)) from error


def _prepare(backend: str, device: str) -> None:
    """Refuse a backend or a device that is not there; compile kernels that are not yet, and say so."""
    from evqr_kernels.backend import BackendUnavailable, get_backend, require_device

    try:
        kernels = get_backend(backend)
        require_device(kernels, device)
    except (BackendUnavailable, ValueError) as error:
        raise UsageError(str(error)) from error
    if kernels.needs_compile(device):
        note(COMPILING)
        kernels.load(device)


def _read_one(recording: Recording, as_json: bool, picture: Path | None, **options: Any) -> int:
    from evqr.reader import read_codes

    with _progress_bar(Path(recording.path).name) as progress:
        result = read_codes(recording, progress=progress, **options)
    _show(result, as_json, {})
    if picture and result.readings:
        from evqr.picture import picture_events, save_picture

        reading = result.readings[0]
        save_picture(picture, picture_events(recording, reading), reading)
    elif picture:
        note(f"nothing read: {picture} is not drawn")
    return _exit_status([result.status])


def _read_each_window(recording: Recording, as_json: bool, **options: Any) -> int:
    from evqr.reader import read_windows

    statuses = []
    for window in read_windows(recording, **options):
        click.echo(report.json_line(report.window_record(window)) if as_json else report.window_text(window))
        statuses.append(window.status)
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
            statuses.append(result.status)
    return _exit_status(statuses)


def _begin_worker() -> None:
    """Let a worker end at once, without a traceback, on Ctrl-C, which reaches it too, and with its parent.

    A worker of a parent that was killed would work on what was handed out, and then wait for ever.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


@contextmanager
def process_pool(jobs: int) -> Iterator[ProcessPoolExecutor | None]:
    """Start workers as fresh processes: kernels and their threads do not survive a fork."""
    if jobs == 1:
        yield None
        return
    pool = ProcessPoolExecutor(
        jobs,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin_worker,
    )
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _show(result: ReadResult, as_json: bool, extra: dict[str, Any]) -> None:
    if as_json:
        for record in report.result_records(result):
            click.echo(report.json_line({**extra, **record}))
    else:
        click.echo(report.result_text(result))


def _exit_status(statuses: Sequence[ReadStatus]) -> int:
    if ReadStatus.ERROR in statuses:
        return BAD
    return OK if ReadStatus.READ in statuses else NOTHING


@contextmanager
def _progress_bar(name: str) -> Iterator[Callable[[int, int | None], None] | None]:
    """Show a bar over the time of the recording, on a terminal only."""
    if not sys.stderr.isatty():
        yield None
        return
    from tqdm import tqdm

    layout = "{l_bar}{bar}| {n_fmt}/{total_fmt} ms of events [{elapsed}]"
    with tqdm(desc=name, bar_format=layout, leave=False) as bar:

        def advance(done_us: int, total_us: int | None) -> None:
            bar.total = None if total_us is None else total_us // 1000
            bar.update(done_us // 1000 - bar.n)

        yield advance


@evqr.command(epilog=examples("evqr info line3.raw", "evqr info events.txt --sensor 640x480 --time-unit s"))
@click.argument("recording", metavar="RECORDING", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
@_recording_options
def info(recording: Path, as_json: bool, sensor: tuple[int, int] | None, time_unit: TimeUnit | None) -> int:
    """Tell what a recording holds, and anything suspicious in it."""
    from evqr.recording import open_recording, summarise

    with open_recording(recording, sensor=sensor, time_unit=time_unit) as opened:
        found = summarise(opened)
    click.echo(report.json_line(report.info_record(found)) if as_json else report.info_text(found))
    return OK


@evqr.command(
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
    "--version", type=click.IntRange(1, 40), metavar="1-40", help="Default: the smallest that fits."
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
@click.option("--tilt", type=float, default=0.0, show_default=True, help="Of the object's plane [deg].")
@click.option("--invert", is_flag=True, help="Print light on dark.")
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
    version: int | None,
    ec: Any,
    mask: int | None,
    angle: float,
    direction: float,
    speed_px_ms: float | None,
    module_px: float,
    preset: str,
    tilt: float,
    invert: bool,
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

    writer_of(output)  # before the work is done
    if needs_compile():
        note(COMPILING)
    made = run_simulation(
        text,
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


@evqr.command(epilog=examples("evqr demo --picture demo.png"))
@click.option(
    "--picture",
    type=click.Path(path_type=Path),
    default="evqr-demo.png",
    show_default=True,
    metavar="FILE",
    help="Where the picture goes.",
)
@_backend_options
def demo(picture: Path, backend: str, device: str, threads: int | None) -> int:
    """Read the recording that comes with evqr.

    Prints what was read and draws how: events, events with the motion taken out and the outline found,
    estimated modules beside the true ones.
    """
    from evqr.demo import demo_recording, demo_truth
    from evqr.picture import picture_events, require_drawable, save_picture
    from evqr.reader import read_codes
    from evqr.recording import open_recording

    require_drawable(picture)
    _prepare(backend, device)
    with demo_recording() as path, open_recording(path) as recording:
        with _progress_bar(path.name) as progress:
            result = read_codes(recording, backend=backend, device=device, threads=threads, progress=progress)
        _show(result, False, {})
        if result.readings:
            reading = result.readings[0]
            save_picture(picture, picture_events(recording, reading), reading, truth=demo_truth(path))
            click.echo(f"picture: {picture}")
    return _exit_status([result.status])
