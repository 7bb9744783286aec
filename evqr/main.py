"""The command line `evqr`: the product's commands and those of the paper's experiment, joined.

Results go to stdout; progress, notes and errors go to stderr.  Exit status: 0 something was read, or what was
asked for is done; 1 nothing was read; 2 bad input, bad use or surroundings that fail; 3 a fault of the
program; 130 interrupted; 141 the reader of our output left.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from typing import ClassVar

import click

from evqr.cli.options import INTERRUPTED, examples
from evqr.cli.running import (
    collect_garbage_rarely,
    end_at_once,
    end_within_a_second_of_ctrl_c,
    leave_ctrl_c_to_the_thread,
    run_command,
)

COMPLETE = "_EVQR_COMPLETE"
"""The environment variable by which a shell asks for completions."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its status."""
    collect_garbage_rarely()
    end_within_a_second_of_ctrl_c()
    status = run(arguments)
    leave_ctrl_c_to_the_thread()
    if status == INTERRUPTED:
        end_at_once(status)
    sys.exit(status)


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in given  # before a command or behind it

    def command() -> int:
        instruction = os.environ.get(COMPLETE)
        if instruction:
            from click.shell_completion import shell_complete

            return shell_complete(evqr, {}, "evqr", COMPLETE, instruction)
        # Not click's own main, which gives a closed pipe the status that here means "nothing read".
        words = [word for word in given if word != "--debug"]
        with evqr.make_context("evqr", words or ["--help"]) as context:
            context.meta["debug"] = debug
            return evqr.invoke(context)

    return run_command(command, debug=debug)


class _Commands(click.Group):
    """Commands, imported when they are first asked for."""

    home: ClassVar = {
        "read": "evqr.cli.read",
        "batch": "evqr.cli.batch",
        "info": "evqr.cli.commands",
        "convert": "evqr.cli.commands",
        "simulate": "evqr.cli.commands",
        "demo": "evqr.cli.commands",
        "watch": "evqr.cli.watch",
        "doctor": "evqr.cli.doctor",
        "calibrate": "evqr.cli.calibrate",
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
    epilog=examples("evqr demo", "evqr read line3.raw", "evqr doctor")
    + "\n\n\b\nExit status:\n"
    + "  0 something was read, or what was asked for is done; 1 nothing was read;\n"
    + "  2 bad input, bad use or surroundings that fail; 3 a fault of evqr; 130 interrupted."
    + "\n\n\b\nCompletion of commands and options in a shell:\n"
    + '  eval "$(_EVQR_COMPLETE=bash_source evqr)"     (or zsh_source, fish_source)'
    + "\n\n\b\nKernels are compiled in the first run and kept; evqr doctor says where.\n"
    + "  WARP_CACHE_PATH names another directory for them.",
)
@click.option("--debug", is_flag=True, help="Show the traceback of a fault of evqr; goes with any command.")
@click.version_option(package_name="evqr", message="evqr %(version)s")
def evqr(debug: bool) -> None:
    """Read 2-D codes from event-camera recordings."""
