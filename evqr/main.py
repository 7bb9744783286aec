"""The command line `evqr`: the product's commands and those of the paper's experiment, joined.

Results go to stdout; progress, notes and errors go to stderr.  Exit status: 0 something was read, 1 nothing
was read, 2 bad input or bad use, 130 interrupted.
"""

from __future__ import annotations

import importlib
import io
import os
import sys
from collections.abc import Sequence
from typing import ClassVar

import click

from evqr.cli.options import BAD, INTERRUPTED, PIPE_CLOSED, examples
from evqr.errors import EvqrError


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


class _Commands(click.Group):
    """Commands, imported when they are first asked for."""

    home: ClassVar = {
        "read": "evqr.cli.commands",
        "info": "evqr.cli.commands",
        "convert": "evqr.cli.commands",
        "simulate": "evqr.cli.commands",
        "demo": "evqr.cli.commands",
        "dataset": "evqr.paper.cli",
        "table1": "evqr.paper.cli",
    }

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(self.home)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        module = self.home.get(cmd_name)
        return None if module is None else getattr(importlib.import_module(module), cmd_name)


@click.group(
    cls=_Commands,
    no_args_is_help=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=examples("evqr demo", "evqr read line3.raw"),
)
@click.version_option(package_name="evqr", message="evqr %(version)s")
def evqr() -> None:
    """Read 2-D codes from event-camera recordings."""
