"""The page of the command line, from the commands themselves."""

from __future__ import annotations

from collections.abc import Iterator

import click

from evqr.main import evqr

INTRODUCTION = """\
# Commands

`evqr --help` and `evqr COMMAND --help` print the same. Results go to stdout; progress, notes and errors go to
stderr. What the exit statuses mean is on the page [Errors and reasons](errors.md#exit-statuses), what
`--json` prints on [Records](records.md). """


def commands_page() -> str:
    """Write the page."""
    context = click.Context(evqr, info_name="evqr")
    return "\n".join([INTRODUCTION, *_group(evqr, context, depth=2)])


def _group(group: click.Group, context: click.Context, depth: int) -> Iterator[str]:
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        inner = click.Context(command, info_name=name, parent=context)
        yield f"{'#' * depth} {inner.command_path}"
        yield ""
        for paragraph in (command.help or "").split("\n\n"):
            yield from (" ".join(paragraph.split()), "")
        if isinstance(command, click.Group):
            yield from _group(command, inner, depth + 1)
        else:
            yield from _command(command, inner)


def _command(command: click.Command, context: click.Context) -> Iterator[str]:
    pieces = " ".join(command.collect_usage_pieces(context))
    yield from ("```text", f"{context.command_path} {pieces}", "```", "")
    options = [each for each in command.params if isinstance(each, click.Option) and not each.hidden]
    if options:
        yield from ("| option | what |", "|---|---|")
        for option in options:
            record = option.get_help_record(context)
            assert record is not None
            yield f"| {_code(record[0])} | {_cell(record[1])} |"
        yield ""
    lines = [line.strip() for line in (command.epilog or "").replace("\b", "").splitlines()]
    shown = [line for line in lines if line and line != "Examples:"]
    if shown:
        yield from ("```sh", *shown, "```", "")


def _code(text: str) -> str:
    """Write code for a cell: a bar within backticks is shown differently by different readers of Markdown."""
    return f"<code>{text.replace('|', '&#124;')}</code>" if "|" in text else f"`{text}`"


def _cell(text: str) -> str:
    """Keep a text on one line of a table."""
    return " ".join(text.split()).replace("|", "\\|")
