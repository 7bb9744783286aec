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
    return "\n".join(
        [INTRODUCTION, "", *_command(evqr, context, depth=2), *_commands(evqr, context, depth=2)]
    )


def _commands(group: click.Group, context: click.Context, depth: int) -> Iterator[str]:
    """Tell of the commands of a group, and of those of groups in it."""
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        inner = click.Context(command, info_name=name, parent=context)
        yield from _command(command, inner, depth)
        if isinstance(command, click.Group):
            yield from _commands(command, inner, depth + 1)


def _command(command: click.Command, context: click.Context, depth: int) -> Iterator[str]:
    """Tell of one command: what it does, how it is called, its options, and what its help ends with."""
    yield from (f"{'#' * depth} {context.command_path}", "")
    for paragraph in (command.help or "").split("\n\n"):
        yield from (" ".join(paragraph.split()), "")
    pieces = " ".join(command.collect_usage_pieces(context))
    yield from ("```text", f"{context.command_path} {pieces}", "```", "")
    records = [
        option.get_help_record(context) for option in command.params if isinstance(option, click.Option)
    ]
    shown = [record for record in records if record is not None]
    if shown:
        yield from ("| option | what |", "|---|---|")
        yield from (f"| {_code(name)} | {_cell(what)} |" for name, what in shown)
        yield ""
    for section in (command.epilog or "").split("\b\n"):
        heading, *lines = section.strip().splitlines() or [""]
        if lines:
            language = "sh" if heading == "Examples:" else "text"
            text = (line.removeprefix("  ") for line in lines)
            yield from (heading, "", f"```{language}", *text, "```", "")


def _code(text: str) -> str:
    """Write code for a cell: a bar within backticks is shown differently by different readers of Markdown."""
    return f"<code>{text.replace('|', '&#124;')}</code>" if "|" in text else f"`{text}`"


def _cell(text: str) -> str:
    """Keep a text on one line of a table."""
    return " ".join(text.split()).replace("|", "\\|")
