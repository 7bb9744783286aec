"""A record as one line of text, as a PLC wants it."""

from __future__ import annotations

import string
from collections.abc import Iterator, Mapping
from typing import Any

from evqr.sinks.sink import JsonRecord


class LineFormat:
    """Fills a format string with what a record says.

    Parameters
    ----------
    format : str
        As of ``str.format``, with the keys of a record, such as ``"{part:06d};{text}"``; ``{text}`` is all
        texts, joined. What a record does not have is empty.
    no_read : str
        What ``{text}`` is where nothing was read.
    between : str
        What joins texts.

    Raises
    ------
    ValueError
        The format string is not one, or asks for more than a record's keys.
    """

    def __init__(self, format: str, *, no_read: str = "NOREAD", between: str = "|") -> None:
        self._no_read, self._between = no_read, between
        self._parts = list(_parsed(format))
        self.fill({"record": "part"})  # what is wrong is found now, not at the first part

    def fill(self, record: JsonRecord) -> str:
        """Give the line of a record, without line breaks in it.

        Parameters
        ----------
        record : mapping
            Plain values.

        Returns
        -------
        line : str
            Control characters in texts are left out: they would end a line, or start a new one.
        """
        values = {**record, "text": self._text(record)}
        return "".join(
            literal if name is None else _shown(values.get(name), spec) for literal, name, spec in self._parts
        )

    def _text(self, record: JsonRecord) -> str:
        texts = record.get("texts")
        found = [record["text"]] if texts is None and record.get("text") is not None else texts or []
        return self._between.join(map(_printable, found)) if found else self._no_read


def _parsed(format: str) -> Iterator[tuple[str, str | None, str]]:
    for literal, name, spec, conversion in string.Formatter().parse(format):
        if literal:
            yield literal, None, ""
        if name is not None:
            if conversion is not None or not name.isidentifier():
                raise ValueError(f"format must name keys of records alone, got {{{name}}}")
            yield "", name, spec or ""


def _shown(value: Any, spec: str) -> str:
    if value is None or isinstance(value, (Mapping, list, tuple)):
        value = "" if value is None else str(value)
    if isinstance(value, str):
        value = _printable(value)
    try:
        return format(value, spec)
    except ValueError:  # as "04d" of what is no number, or is not there
        return str(value)


def _printable(text: str) -> str:
    return "".join(c for c in text if c.isprintable())
