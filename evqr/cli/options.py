"""What commands share: types of options, options, notes, progress."""

from __future__ import annotations

import functools
import re
import shlex
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import click

from evqr.errors import UsageError

if TYPE_CHECKING:
    from evqr.symbology import Symbology

OK, NOTHING, BAD, FAILED, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 3, 130, 141
"""Exit statuses: something read, nothing read, bad input, use or surroundings, a fault of evqr, Ctrl-C, the
reader of our output left."""

COMPILING = "compiling kernels for this machine (first run only; kept in {}) ..."


class SizeType(click.ParamType):
    """``WxH`` in pixels."""

    name = "WxH"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        """Return (width, height)."""
        if isinstance(value, tuple):
            return value
        from evqr.recording.declared import parse_size

        size = parse_size(str(value))
        if size is None or min(size) < 1:
            self.fail(
                f"{value!r} is no sensor size; write it as width x height, for example 640x480", param, ctx
            )
        return size


class VersionType(click.ParamType):
    """``1`` to ``40``, or text as ``M2``, in any case."""

    name = "version"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int | str:
        """Return a number or text of the table of symbols."""
        from evqr.symbol.symbols import SYMBOLS

        names = {str(version).lower(): version for symbol in SYMBOLS.values() for version in symbol.sizes}
        if str(value).lower() not in names:
            self.fail(
                f"{value!r} is no version; write as 1 to 40, M1 to M4, R11x27, 22x22, C1 or F4",
                param,
                ctx,
            )
        return names[str(value).lower()]


class SymbologiesType(click.ParamType):
    """Names of kinds of symbols with commas between them, as ``qr,microqr``."""

    name = "symbologies"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[Symbology, ...]:
        """Return the kinds, each once."""
        from evqr.symbology import Symbology

        try:
            return tuple(dict.fromkeys(map(Symbology.parse, str(value).split(","))))
        except ValueError as error:
            self.fail(f"{error}; write names with commas between them", param, ctx)


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


def note(message: str, *, important: bool = False) -> None:
    """Say something that is no result, on one line; where the user wants it quiet, only what is important."""
    if not important and is_quiet():
        return
    with suppress(OSError):  # standard error is full or closed
        click.echo(f"evqr: {in_options(' '.join(message.split()))}", err=True)


def in_options(message: str) -> str:
    """Call the parameters that a message names what they are on the command line.

    >>> in_options('a.h5: sensor size unknown: pass sensor="WxH"')
    'a.h5: sensor size unknown: pass --sensor WxH'
    """

    def option(found: re.Match[str]) -> str:
        name, value = found[1].replace("_", "-"), found[2] or found[3] or ""
        return f"--{name} {shlex.quote(value) if ' ' in value else value}".rstrip()

    return re.sub(
        rf"""\b({"|".join([*_OPENING, "speed", "repeat"])})=(?:"([^"]*)"|'([^']*)')?""", option, message
    )


def be_quiet(quiet: bool) -> None:
    """Leave out notes and progress in the command that is running."""
    click.get_current_context().meta["quiet"] = quiet


def is_quiet() -> bool:
    """Whether notes and progress are left out."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get("quiet"))


def debugging() -> bool:
    """Whether the user asked with --debug where a fault of evqr is."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get("debug"))


def show_traceback(error: BaseException) -> None:
    """Print the traceback of a fault of evqr, where the user asked for it."""
    if debugging():
        click.echo("".join(traceback.format_exception(error)).rstrip(), err=True)


def prepare(backend: str, device: str) -> None:
    """Refuse a backend or a device that is not there; compile kernels that are not yet, and say so."""
    from evqr.device import cache_of, kernels_failing, kernels_on, load
    from evqr.launched import LAUNCHED

    kernels = kernels_on(backend, device)
    with kernels_failing():
        fresh = kernels.needs_compile(device, LAUNCHED)
    if fresh:
        note(COMPILING.format(cache_of(kernels) or "memory"))
        load(kernels, device, LAUNCHED)


def examples(*lines: str) -> str:
    """Give a command's epilog."""
    return "\b\nExamples:\n" + "\n".join(
        f"  {line}" for line in lines
    )  # \b: click leaves the lines as they are


def recording_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say what a recording does not, and what of it to read.

    The command gets them together, as ``opening``: the keywords of `evqr.open_recording`.
    """

    @functools.wraps(command)
    def with_opening(*args: Any, **given: Any) -> Any:
        opening = {name: given.pop(name) for name in _OPENING}
        return command(*args, opening={k: v for k, v in opening.items() if v not in (None, False)}, **given)

    for option in reversed(_OPENING.values()):
        with_opening = option(with_opening)
    return with_opening


_OPENING = {
    "sensor": click.option(
        "--sensor",
        type=SizeType(),
        metavar="WxH",
        help="Sensor size, where the recording does not tell, or tells wrong.",
    ),
    "time_unit": click.option(
        "--time-unit",
        type=click.Choice(["us", "ms", "s", "ns"]),
        help="Unit of the stored time stamps, where the recording does not tell, or tells wrong.",
    ),
    "stream": click.option(
        "--stream", metavar="NAME", help="Which of several event streams, groups or topics; see evqr info."
    ),
    "columns": click.option(
        "--columns",
        metavar="t,x,y,p",
        help="What the columns of a table without names are, in their order; - for any other.",
    ),
    "start_us": click.option(
        "--start-us", type=int, metavar="N", help="Leave out what was before this time of the recording."
    ),
    "end_us": click.option(
        "--end-us", type=int, metavar="N", help="Leave out what was at this time or later."
    ),
    "strict": click.option(
        "--strict",
        is_flag=True,
        help="Refuse a recording with one wrong event, and one that is cut short.",
    ),
}


def config_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say how to read; the command gets ``config``, a `ReadConfig`."""

    @functools.wraps(command)
    def with_config(*args: Any, **given: Any) -> Any:
        from evqr.config import DecodeConfig, ReadConfig

        chosen = {name: given.pop(name) for name in _CONFIG}
        decode, profile = {"charset": chosen.pop("charset")}, chosen.pop("sensor_profile")
        if profile is not None:
            from evqr.sensor_profile import read_profile

            if chosen["lag_us"] is not None:
                raise UsageError("--lag-us and --sensor-profile say the same: leave out one")
            chosen["lag_us"] = read_profile(profile).lag_us
        try:
            config = ReadConfig(
                decode=DecodeConfig(**decode), **{k: v for k, v in chosen.items() if v is not None}
            )
        except (TypeError, ValueError) as error:
            raise UsageError(str(error)) from error
        return command(*args, config=config, **given)

    for option in reversed(_CONFIG.values()):
        with_config = option(with_config)
    return with_config


_CONFIG = {
    "window_us": click.option(
        "--window-us",
        type=click.IntRange(min=1),
        metavar="N",
        help="Length of a window; default: about 2 px of motion.",
    ),
    "max_windows": click.option(
        "--max-windows", type=click.IntRange(min=1), metavar="N", help="Take at most so many windows."
    ),
    "vote": click.option(
        "--vote",
        type=click.Choice(["mode", "soft", "information"]),
        help="How windows are combined; default: information.",
    ),
    "lag_us": click.option(
        "--lag-us",
        type=LagType(),
        metavar="ON,OFF",
        help="Lags of the pixels, in microseconds; default: estimated.",
    ),
    "sensor_profile": click.option(
        "--sensor-profile",
        type=click.Path(),
        metavar="FILE",
        help="Lags of the pixels as evqr calibrate found them out.",
    ),
    "symbologies": click.option(
        "--symbologies",
        type=SymbologiesType(),
        metavar="NAME,...",
        help="Kinds of symbols to search for, as qr,datamatrix; default: all.",
    ),
    "charset": click.option(
        "--charset",
        metavar="NAME",
        help="Character set of codes that do not name theirs, as utf-8 or shift_jis; default: guessed.",
    ),
}


def backend_options(command: Callable[..., Any]) -> Callable[..., Any]:
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


@contextmanager
def progress_bar(name: str) -> Iterator[Callable[[int, int | None], None] | None]:
    """Show a bar over the time of the recording, on a terminal only."""
    if sys.stderr is None or not sys.stderr.isatty() or is_quiet():
        yield None
        return
    from tqdm import tqdm

    layout = "{l_bar}{bar}| {n_fmt}/{total_fmt} ms of events [{elapsed}]"
    with tqdm(desc=name, bar_format=layout, leave=False) as bar:

        def advance(done_us: int, total_us: int | None) -> None:
            bar.total = None if total_us is None else total_us // 1000
            bar.update(done_us // 1000 - bar.n)

        yield advance


@contextmanager
def share_bar(name: str) -> Iterator[Callable[[int, int], None] | None]:
    """Show a bar over parts of some work that are done, on a terminal only."""
    if sys.stderr is None or not sys.stderr.isatty() or is_quiet():
        yield None
        return
    from tqdm import tqdm

    with tqdm(desc=name, bar_format="{l_bar}{bar}| [{elapsed}]", leave=False) as bar:

        def advance(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield advance
