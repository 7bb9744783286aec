"""The command `evqr read`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evqr.cli import options
from evqr.cli.options import BAD, FAILED, NOTHING, OK, backend_options, config_options, recording_options
from evqr.cli.sink import Form, Sink
from evqr.cli.sources import Named, recordings_of
from evqr.cli.workers import prepare, workers
from evqr.errors import EvqrError, UsageError
from evqr.reason import Reason
from evqr.results import ReadResult, ReadStatus

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from evqr.cli.pictures import Pictures
    from evqr.config import ReadConfig
    from evqr.recording import RecordingOptions


@click.command(
    epilog=options.examples(
        "evqr read line3.raw",
        "evqr read line3.h5 --json --picture line3.png",
        "evqr read shift1/ 'shift2/*.raw' --jobs 4 --text --output texts.txt",
        "evqr read line3.h5 --each-window --max-windows 10",
        "ssh camera cat line3.raw | evqr read - --json",
    )
)
@click.argument("sources", nargs=-1, required=True, metavar="RECORDING...", type=click.Path())
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line, and nothing else there.")
@click.option("--text", "as_text", is_flag=True, help="One text a line, and nothing else there.")
@click.option(
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write results to this file instead of to standard output.",
)
@click.option("--quiet", is_flag=True, help="No notes, warnings and progress; errors are told.")
@recording_options
@click.option(
    "--messages",
    is_flag=True,
    help="Join parts of messages over all recordings; with --text, messages stand in place of their parts.",
)
@click.option("--each-window", is_flag=True, help="Read windows one by one, each from cold, a line each.")
@config_options
@backend_options
@click.option("--jobs", type=click.IntRange(min=1), default=1, metavar="N", help="Recordings read at a time.")
@click.option(
    "--picture",
    type=click.Path(path_type=Path),
    metavar="FILE|DIR",
    help="Draw the first reading, or what there is instead, to a .png, .svg or .pdf file; all to a folder.",
)
def read(
    sources: tuple[str, ...],
    as_json: bool,
    as_text: bool,
    output: Path | None,
    quiet: bool,
    opening: RecordingOptions,
    messages: bool,
    each_window: bool,
    config: ReadConfig,
    backend: str,
    device: str,
    threads: int | None,
    jobs: int,
    picture: Path | None,
) -> int:
    """Read every code that passes, each once.

    RECORDING is a file, a folder (the recordings in it), a pattern in quotes, or - for standard input.

    Exit status: 0 when something was read, 1 when nothing was read, 2 when any recording could not be used, 3
    when evqr itself failed.
    """
    options.be_quiet(quiet)
    if as_json and as_text:
        raise UsageError("--json and --text are two forms of the same: leave out one")
    if each_window and picture:
        raise UsageError("--picture draws a reading of the whole recording: leave out --each-window")
    if each_window and messages:
        raise UsageError("--messages joins readings of whole recordings: leave out --each-window")
    if each_window and jobs > 1:
        raise UsageError("--jobs reads whole recordings at a time: leave out --each-window")
    form: Form = "json" if as_json else "text" if as_text else "report"
    compute = {"config": config, "backend": backend, "device": device, "threads": threads}
    with (
        recordings_of(sources) as recordings,
        Sink(form, _other_file(output, recordings), messages=messages) as sink,
        workers(jobs) as pool,
    ):
        try:
            pictures = _pictures(picture, recordings)
            prepare(pool, jobs, backend, device)
        except EvqrError as error:
            sink.error(None, error)
            raise
        if each_window:
            read_alone = [_each_window(named, sink, {**compute, **opening}) for named in recordings]
            return exit_status((result.status, result.reason_code) for result in read_alone)
        results = []
        for named, result in _results(recordings, pool, {**compute, **opening}):
            sink.result(named, result)
            results.append(result)
            if pictures is not None:
                pictures.draw(named, result, opening)
        if messages:
            _tell_messages([named.name for named in recordings], results, sink)
    return exit_status((result.status, result.reason_code) for result in results)


def _tell_messages(names: Sequence[str], results: Sequence[ReadResult], sink: Sink) -> None:
    """Join what all recordings gave, with the names of those that each message is from."""
    from evqr.symbol.messages import join_messages

    readings = [
        (reading, name) for name, result in zip(names, results, strict=True) for reading in result.readings
    ]
    name_of = {id(reading): name for reading, name in readings}
    for message in join_messages(reading for reading, _ in readings):
        sink.message(message, [name_of[id(part)] for part in message.parts])


def _other_file(output: Path | None, recordings: Sequence[Named]) -> Path | None:
    """Refuse to write results over a recording."""
    for named in recordings:
        if output is not None and output.exists() and named.path.exists() and output.samefile(named.path):
            raise UsageError(f"{output}: is a recording to be read; name another file for the results")
    return output


def _pictures(picture: Path | None, recordings: Sequence[Named]) -> Pictures | None:
    if picture is None:
        return None
    from evqr.cli.pictures import Pictures

    return Pictures(picture, recordings)


def _results(
    recordings: Sequence[Named], pool: Executor | None, given: dict[str, Any]
) -> Iterator[tuple[Named, ReadResult]]:
    """Read recordings, one after another or several at a time; what cannot be read is a result, too."""
    if pool is None:
        from evqr.solvers import KeptSolvers

        kept = KeptSolvers()
        for named in recordings:
            with options.progress_bar(named.name) as progress, kept.used():
                result = _read_one(named, {**given, "progress": progress})
            yield named, result
        return
    from tqdm import tqdm

    from evqr.many import read_many

    read = read_many([named.path for named in recordings], executor=pool, **given)
    # disable=None: no bar where stderr is no terminal
    shown = tqdm(recordings, unit=" recording", leave=False, disable=True if options.is_quiet() else None)
    for named, result in zip(shown, read, strict=True):
        with tqdm.external_write_mode():
            yield named, result


def _read_one(named: Named, given: dict[str, Any]) -> ReadResult:
    from evqr.many import failed
    from evqr.offline import read_codes

    try:
        return read_codes(named.path, **given)
    except EvqrError as error:
        return failed(str(named.path), error)
    except Exception as error:  # whatever is wrong with one recording must not end the others
        options.show_traceback(error)
        return failed(str(named.path), error)


def _each_window(named: Named, sink: Sink, given: dict[str, Any]) -> ReadResult:
    """Read windows one by one, and say what they come to."""
    from evqr.many import failed
    from evqr.offline import read_windows

    status, warnings = ReadStatus.NO_READ, ()
    try:
        for window in read_windows(named.path, **given):
            sink.window(named, window)
            warnings = window.warnings
            if window.status is ReadStatus.READ:
                status = ReadStatus.READ
    except EvqrError as error:
        result = failed(str(named.path), error)
        sink.result(named, result)
        return result
    sink.warn(named, warnings)
    return ReadResult(status, warnings=warnings)


def exit_status(outcomes: Iterable[tuple[ReadStatus, str | None]]) -> int:
    """Give the exit status for recordings of which each has a status, and a reason where it has one."""
    known = set(outcomes)
    if any(reason == Reason.FAILED for _, reason in known):
        return FAILED
    statuses = {status for status, _ in known}
    if ReadStatus.ERROR in statuses:
        return BAD
    return OK if ReadStatus.READ in statuses else NOTHING
