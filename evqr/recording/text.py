"""Text, an event a line: columns in any order that names, values or the user tell.

NumPy parses a block of lines at a time; where it cannot, each line of the block is looked at.  No package
reads more than one fixed order.
"""

from __future__ import annotations

import codecs
import re
import warnings
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .faults import Faults
from .options import Asked
from .source import RawChunks, RawColumns, Source, explained
from .text_head import (
    NO_EVENT_ADVICE,
    SAMPLE_LINES,
    WORDS,
    Head,
    is_blank,
    no_event_text,
    read_head,
    value_of,
)

ENCODING_BYTES = 1 << 16
_WORD = re.compile(rf"\b({'|'.join(WORDS)})\b", re.IGNORECASE)


class TextSource(Source):
    """A text file, parsed a block of lines at a time."""

    def __init__(self, path: str, asked: Asked) -> None:
        self._encoding = _encoding(path)
        with explained(path, "text file"), self._open(path) as file:
            self._head = head = read_head(list(islice(file, SAMPLE_LINES)), path, asked)
        order = " ".join(column for column in head.columns if column != "-")
        words = f"text {order}, {head.style.words}"
        super().__init__(path, words, sensor=head.sensor, unit=head.unit, notes=head.notes)

    def _open(self, path: str) -> Any:
        return open(path, encoding=self._encoding, errors="replace")

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Parse ``chunk_events`` lines at a time."""
        parser = _Parser(self._head, faults)
        with self._open(self.name) as file:
            with explained(self.name, "text file"):
                done = len(list(islice(file, self._head.lines)))
            while True:
                with explained(self.name, f"text file after line {done:,}"):
                    block = list(islice(file, chunk_events))
                    if not block:
                        return
                    raw = parser(block, done)
                done += len(block)
                if raw is not None:
                    yield raw


class _Parser:
    """Lines to columns.  Times are whole numbers until a line has a fraction.

    As float64 a stamp in ns since 1970 would lose its last digits.
    """

    def __init__(self, head: Head, faults: Faults) -> None:
        self._head = head
        self._faults = faults
        self._whole_times = head.whole_times

    def __call__(self, block: list[str], done: int) -> RawColumns | None:
        """Parse lines, of which ``done`` came before."""
        lines = [line for line in block if not is_blank(line)]
        if not lines:  # NumPy would warn
            return None
        table = self._table(lines)
        if table is None:
            return self._line_by_line(block, done)
        return RawColumns(*(table[column] for column in "txyp"))

    def _table(self, lines: list[str]) -> NDArray[Any] | None:
        """Parse lines that are all events; None where one is not."""
        style = self._head.style
        if style.decimal_comma:
            lines = [line.replace(",", ".") for line in lines]
        if self._head.words:
            lines = [_WORD.sub(lambda word: f"{WORDS[word[0].casefold()]}", line) for line in lines]
        if style.separator:  # one at the end makes no column
            lines = [line.rstrip().removesuffix(style.separator) for line in lines]
        for whole in (True, False) if self._whole_times else (False,):
            kinds = {"t": "i8" if whole else "f8", "x": "f8", "y": "f8", "p": "f8"}
            fields = [
                (column, kinds[column]) if column in kinds else (f"unused{i}", "U1")
                for i, column in enumerate(self._head.columns)
            ]
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")  # NumPy reads 5.5 as 5 with a warning
                    table = np.loadtxt(
                        lines, fields, comments=None, delimiter=style.separator, ndmin=1, quotechar='"'
                    )
            except (ValueError, Warning):
                continue
            self._whole_times = whole
            return table
        return None

    def _line_by_line(self, block: list[str], done: int) -> RawColumns | None:
        """Parse each line, and tell of those that are no events."""
        head = self._head
        rows: list[list[int | float]] = []
        wrong: list[tuple[int, str]] = []
        for number, line in enumerate(block, done + 1):
            if is_blank(line):
                continue
            cells = head.style.cells(line)
            values = [value_of(cells[head.columns.index(c)]) for c in "txyp"] if self._fits(cells) else [None]
            good = [value for value in values if value is not None]
            if len(good) == 4:
                rows.append(good)
            else:
                wrong.append((number, line))
        if wrong and not wrong[-1][1].endswith("\n"):  # only the last line of a file can end without
            self._faults.cut(no_event_text(*wrong.pop()))
        if wrong:
            self._faults.met += len(wrong)
            self._faults.leave_out(len(wrong), no_event_text(*wrong[0]), NO_EVENT_ADVICE)
        if not rows:
            return None
        t, *others = zip(*rows, strict=True)
        whole = all(isinstance(value, int) and abs(value) < 1 << 63 for value in t)
        return RawColumns(
            np.array(t, np.int64 if whole else np.float64), *(np.array(c, float) for c in others)
        )

    def _fits(self, cells: list[str]) -> bool:
        return len(cells) == len(self._head.columns)


def _encoding(path: str) -> str:
    """Find the encoding of a text file: by its mark, else UTF-8, else one in which any byte is a letter."""
    with explained(path, "text file"), open(path, "rb") as file:
        head = file.read(ENCODING_BYTES)
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"
