"""Where results go, and how they are written: for people, as JSON lines, or as texts alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Literal

import click

from evqr.cli.options import debugging, in_options, note
from evqr.cli.sources import Named
from evqr.errors import EvqrError, UsageError
from evqr.output import records
from evqr.reason import Reason
from evqr.results import ReadResult, ReadStatus, WindowReading
from evqr.symbol.messages import Message
from evqr.values import json_line

Form = Literal["report", "json", "text"]


class Sink:
    """Writes results, to standard output or to a file; a context manager.

    Parameters
    ----------
    form : "report", "json" or "text"
        Some lines a reading for people, with the recording's name above; one JSON object a line; or one text
        a line.
    output : path, optional
        The file; default: standard output.
    messages : bool
        Whether messages are written, so that texts of their parts alone are not.
    """

    def __init__(self, form: Form, output: Path | None, *, messages: bool = False) -> None:
        self.form = form
        self._messages = messages
        self._output = output
        self._file: IO[str] | None = None
        self._heading: str | None = None

    def __enter__(self) -> Sink:
        if self._output is not None:
            try:
                self._file = open(self._output, "w", encoding="utf-8", errors="backslashreplace")
            except OSError as error:
                raise self._lost(error) from error
        return self

    def __exit__(self, *failure: object) -> None:
        if self._file is not None:
            try:
                self._file.close()
            except OSError as error:
                raise self._lost(error) from error

    def result(self, source: Named, result: ReadResult) -> None:
        """Write what a recording gave, and on standard error what was odd about it."""
        if result.status is ReadStatus.ERROR and self.form != "json":
            where = result.reason_code is Reason.FAILED and not debugging()
            self.failed(source, result.reason + ("; --debug shows where" if where else ""))
        elif self.form == "json":
            for record in records.result_records(result):
                self._record(source, record)
        elif self.form == "text":
            for reading in result.readings:
                if not (self._messages and reading.structured_append):
                    self._line(records.payload_text(reading))
        else:
            self._under(source, records.result_text(result))
        self.warn(source, warnings_of(result))

    def message(self, message: Message, names: Sequence[str]) -> None:
        """Write a message; the names are those of the recordings that its parts are from."""
        if self.form == "json":
            self._line(json_line(records.message_record(message, names)))
        elif self.form == "report":
            self._line(f"{records.message_text(message)} (from {', '.join(dict.fromkeys(names))})")
        elif message.text is not None:
            self._line(records.printable(message.text))
        else:
            note(str(message))

    def window(self, source: Named, window: WindowReading) -> None:
        """Write what a window gave."""
        if self.form == "json":
            self._record(source, window.to_dict())
        elif self.form == "text":
            for code in window.codes:
                if code.payload is not None:
                    self._line(records.payload_text(code.payload))
        else:
            self._under(source, records.window_text(window))

    def error(self, source: Named | None, error: EvqrError) -> None:
        """Write a record of what stops everything; the message itself goes to standard error."""
        if self.form == "json":
            name = None if source is None else source.name
            record = {
                "status": ReadStatus.ERROR,
                "reason": in_options(str(error)),
                "reason_code": error.reason,
            }
            self._line(json_line({"recording": name, **record}))

    def failed(self, source: Named, reason: str) -> None:
        """Say on standard error why a recording could not be read."""
        named = _as_named(source, reason)
        note(named if source.name in named else f"{source.name}: {named}", important=True)

    def warn(self, source: Named, warnings: Sequence[str]) -> None:
        """Say on standard error what was odd about a recording."""
        for warning in warnings:
            note(f"{source.name}: {warning}")

    def _record(self, source: Named, record: Mapping[str, Any]) -> None:
        reason = record.get("reason")
        if reason:
            record = {**record, "reason": _as_named(source, str(reason))}
        self._line(json_line({"recording": source.name, **record}))

    def _under(self, source: Named, text: str) -> None:
        if source.name != self._heading:
            self._heading = source.name
            self._line(f"{records.printable(source.name)}:")
        self._line(text)

    def _line(self, text: str) -> None:
        if self._file is None:
            click.echo(text)
            return
        try:
            self._file.write(text + "\n")
            self._file.flush()
        except OSError as error:
            raise self._lost(error) from error

    def _lost(self, error: OSError) -> UsageError:
        return UsageError(f"{self._output}: cannot be written ({error.strerror or error}); name another file")


def _as_named(source: Named, message: str) -> str:
    """Call a recording what the user called it, not the file where standard input is kept."""
    return in_options(message.replace(str(source.path), source.name))


def warnings_of(result: ReadResult) -> list[str]:
    """Return what was odd about a recording and its codes, each once."""
    odd = (text for reading in result.readings for text in (*reading.warnings, reading.gs1_error) if text)
    return list(dict.fromkeys((*result.warnings, *odd)))
