"""The command `evqr watch`: the reader of a line, fed by a source that may have no end."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import click

from evqr.cli import options
from evqr.cli.options import NOTHING, OK, config_options, in_options, note, recording_options
from evqr.errors import EvqrError, UsageError
from evqr.values import json_line

if TYPE_CHECKING:
    from evqr.config import ReadConfig
    from evqr.line.reader import Reader
    from evqr.line.records import LineRecord
    from evqr.live.pieces import Piece
    from evqr.recording import RecordingOptions


class Stoppable(Protocol):
    """What ends when it is told to."""

    def stop(self) -> None:
        """End soon."""
        ...


IN_STREAM = "stream"
"""Stands for a file of triggers, where they come with the events."""


@click.command(
    epilog=options.examples(
        "evqr watch line3.raw --json",
        "evqr watch line3.h5 --json --trigger gates.csv --speed 1",
        "evqr watch tcp://camera:7000 --json --trigger stream",
        "evqr watch camera --json",
        "evqr watch --example > line3.toml",
        "evqr watch --config line3.toml",
    )
)
@click.argument("source", metavar="SOURCE", required=False)
@click.option(
    "--config",
    "settings",
    metavar="FILE.toml",
    help="Run as a service: source, triggers, where records go, page and so on are in this file.",
)
@click.option("--check", is_flag=True, help="Only tell what is wrong with that file.")
@click.option("--example", is_flag=True, help="Print such a file, and what stands in it.")
@click.option("--schema", is_flag=True, help="Print the JSON schema of such files.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a record, and nothing else there.")
@click.option(
    "--trigger",
    metavar="FILE.csv|stream",
    help="One part a trigger: of a file, a line each, t_us,kind[,index[,ticks]], of kind pulse, start, end"
    " or ticks; or of the source.",
)
@click.option(
    "--pulse-us",
    type=(click.IntRange(min=0), click.IntRange(min=1)),
    metavar="BEFORE AFTER",
    help="Microseconds before and after a pulse in which its part passes; default: 0 100000.",
)
@click.option(
    "--speed",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="X",
    help="Play a recording so many times as fast as it was; default: as fast as it is read.",
)
@click.option("--repeat", is_flag=True, help="Play a recording again and again, until SIGTERM or Ctrl-C.")
@click.option("--quiet", is_flag=True, help="No notes and warnings; errors are told.")
@recording_options
@config_options
@click.option("--device", default="cpu", show_default=True, help='Where to compute: "cpu", "cuda:0", ...')
@click.option(
    "--backend",
    type=click.Choice(["auto", "warp", "taichi", "numpy"]),
    default="auto",
    show_default=True,
    help="What runs the kernels.",
)
def watch(
    source: str | None,
    settings: str | None,
    check: bool,
    example: bool,
    schema: bool,
    as_json: bool,
    trigger: str | None,
    pulse_us: tuple[int, int] | None,
    speed: float | None,
    repeat: bool,
    quiet: bool,
    opening: RecordingOptions,
    config: ReadConfig,
    device: str,
    backend: str,
) -> int:
    """Read a line: a record as soon as it is certain, one a part.

    SOURCE is a recording, which is played; tcp://HOST:PORT, unix:PATH or - for standard input, from which
    EVT3 or a packed stream comes; camera or camera:SERIAL, at this machine (evqr doctor lists them); or
    dv://HOST:PORT[,PORT OF TRIGGERS], what dv-processing or DV sends. What is lost is opened again. It ends
    with its source, on SIGTERM or on Ctrl-C, and tells all parts then. With --config it runs as a service:
    its source is in the file, and it logs to standard error, a JSON object a line.

    Exit status: 0 on a clean stop, 1 when a source that ended had nothing that was read, 2 when it could not
    be used, 3 when evqr itself failed.
    """
    from evqr.config import TriggerConfig
    from evqr.line.reader import Reader
    from evqr.line.trigger_file import read_triggers
    from evqr.service.feeding import feed, opened_source

    options.be_quiet(quiet)
    if example or schema:
        return _print(example=example)
    if settings is not None:
        if source is not None or trigger is not None or speed is not None or repeat:
            raise UsageError(
                "--config has source and triggers in its file: leave out SOURCE, --trigger, --speed, --repeat"
            )
        return _serve(settings, check=check, as_json=as_json)
    if source is None:
        raise UsageError("name a SOURCE, or a file of settings with --config")
    if trigger is None and pulse_us is not None:
        raise UsageError("--pulse-us says what pulses ask for: name them with --trigger")
    cfg = None if trigger is None else TriggerConfig()
    if cfg is not None and pulse_us is not None:
        cfg = replace(cfg, before_us=pulse_us[0], after_us=pulse_us[1])
    triggers = [] if trigger in (None, IN_STREAM) else read_triggers(trigger)

    def make(size: tuple[int, int]) -> Reader:
        return Reader(size, config, cfg, backend=backend, device=device, camera=source)

    options.prepare(backend, device)
    read = False
    try:
        in_stream = trigger == IN_STREAM
        with (
            opened_source(source, speed=speed, repeat=repeat, in_stream=in_stream, **opening) as opened,
            _stopped_by_signal(opened) as stopped,
        ):
            for record in feed(opened, make, triggers, in_stream=in_stream, seen=_tell_interruption(source)):
                read = read or bool(getattr(record, "texts", ())) or record.record == "read"
                row = {"record": record.record, "recording": source, **record.to_dict()}
                click.echo(json_line(row) if as_json else _text(record))
    except EvqrError as error:
        if as_json:
            said = {"status": "error", "reason": in_options(str(error)), "reason_code": error.reason}
            click.echo(json_line({"record": "error", "recording": source, **said}))
        raise
    return OK if read or stopped else NOTHING


def _print(*, example: bool) -> int:
    """Print a file of settings, or the schema of such files."""
    import json
    from importlib.resources import files

    from evqr.service.schema import json_schema

    if example:
        click.echo((files("evqr") / "data" / "watch.toml").read_text(encoding="utf-8"), nl=False)
    else:
        click.echo(json.dumps(json_schema(), indent=2))
    return OK


def _serve(path: str, *, check: bool, as_json: bool) -> int:
    """Run a service until it is told to stop, or its source ends."""
    from evqr.service.logs import logged_as_json
    from evqr.service.service import Service, sinks_of
    from evqr.service.settings import load_settings

    settings, jobs = load_settings(path)
    if check:
        for _ in sinks_of(settings):
            pass
        click.echo(f"{path}: all is well")
        return OK
    options.prepare(settings.backend, settings.device)
    out = (lambda record: click.echo(json_line(record))) if as_json else (lambda record: None)
    service = Service(settings, jobs, out=out)
    with logged_as_json(), _stopped_by_signal(service) as stopped:
        read = service.run()
    return OK if read or stopped else NOTHING


@contextmanager
def _stopped_by_signal(source: Stoppable) -> Iterator[list[int]]:
    """Let SIGTERM or Ctrl-C end a source; what was heard is in the list.

    A second Ctrl-C ends the program.
    """
    heard: list[int] = []
    before: dict[int, Any] = {}

    def stop(number: int, frame: Any) -> None:
        heard.append(number)
        restore()
        source.stop()

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)
        if before and wakeup != -1:
            signal.set_wakeup_fd(wakeup, warn_on_full_buffer=False)
        before.clear()

    wakeup = signal.set_wakeup_fd(-1)  # to whom that wakes Ctrl-C is an interruption
    for number in (signal.SIGTERM, signal.SIGINT):
        if signal.getsignal(number) is not signal.SIG_IGN:
            before[number] = signal.signal(number, stop)
    try:
        yield heard
    finally:
        restore()


def _tell_interruption(source: str) -> Callable[[Piece], None]:
    from evqr.live.pieces import Interrupted

    def tell(piece: Piece) -> None:
        if isinstance(piece, Interrupted):
            note(f"{source}: {piece.reason}; trying again")

    return tell


def _text(record: LineRecord) -> str:
    """Describe a record in a line."""
    from evqr.line.records import ClockRecord, GapRecord, OverloadRecord, PartRecord, ReadRecord
    from evqr.output.records import payload_text

    if isinstance(record, ReadRecord):
        return f"read      {payload_text(record.reading)}"
    if isinstance(record, PartRecord):
        of = f"part {record.part}" + ("" if record.trigger is None else f" (trigger {record.trigger})")
        texts = ", ".join(map(payload_text, record.readings))
        return f"{of}: {texts or 'NO READ: ' + record.reason}" + (
            f" ({record.reason})" if texts and record.reason else ""
        )
    if isinstance(record, GapRecord):
        return f"gap       {record.t_from_us} to {record.t_to_us} us: {record.reason}"
    if isinstance(record, ClockRecord):
        return f"clock     was reset from {record.t_before_us} to {record.t_after_us} us"
    assert isinstance(record, OverloadRecord)
    return f"overload  searches skipped: {record.windows}, {record.behind_ms:.0f} ms behind"
