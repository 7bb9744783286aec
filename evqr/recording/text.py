"""Text, one event a line: ``t x y p`` or any order that a header line names, with spaces, tabs or commas.

A first line of two numbers is the sensor size (as E2VID writes it); lines starting with # or % are comments.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np

from ..errors import RecordingError
from .columns import require_columns
from .source import RawChunks, RawColumns, Source, explained

COMMENTS = ("#", "%")
ORDER = ("t", "x", "y", "p")


class _Head(NamedTuple):
    """What the lines before the first event tell."""

    lines: int
    sensor: tuple[int, int] | None
    order: tuple[str, ...]
    comma: bool
    whole_times: bool


class TextSource(Source):
    """A text file, parsed by NumPy a block of lines at a time."""

    def __init__(self, path: str) -> None:
        with explained(path, "text file"), open(path, encoding="utf-8-sig") as file:
            self._head = _read_head(file, path)
        separator = "commas" if self._head.comma else "spaces"
        super().__init__(path, f"text {' '.join(self._head.order)}, {separator}", sensor=self._head.sensor)

    def raw_chunks(self, chunk_events: int) -> RawChunks:
        """Parse ``chunk_events`` lines at a time."""
        head = self._head
        # Whole times keep all their 64 bits; as float64 a stamp in ns since 1970 would lose its last digits.
        kinds = {"t": "i8" if head.whole_times else "f8", "x": "f8", "y": "f8", "p": "f8"}
        row = np.dtype([(column, kinds[column]) for column in head.order])
        comma = "," if head.comma else None
        with open(self.name, encoding="utf-8-sig") as file:
            with explained(self.name, "text file"):
                done = len(list(islice(file, head.lines)))
            while True:
                with explained(self.name, f"text file after line {done:,}"):
                    block = list(islice(file, chunk_events))
                    lines = [line for line in block if not _is_blank(line)]
                    # An empty list would make NumPy warn.
                    try:
                        table = (
                            np.loadtxt(lines, row, comments=None, delimiter=comma, ndmin=1) if lines else None
                        )
                    except ValueError:
                        _refuse_what_is_no_event(block, done, self.name)
                        raise
                if not block:
                    return
                done += len(block)
                if table is not None:
                    yield RawColumns(*(table[column] for column in ORDER))


def _read_head(file: Iterator[str], path: str) -> _Head:
    """Read up to the first event."""
    sensor: tuple[int, int] | None = None
    order: tuple[str, ...] = ORDER
    for number, line in enumerate(file):
        if _is_blank(line):
            continue
        comma = "," in line
        words = line.replace(",", " ").split()
        if len(words) == 2 and sensor is None and all(word.isdecimal() for word in words):
            sensor = int(words[0]), int(words[1])
        elif len(words) >= 4 and not any(_is_number(word) for word in words):
            found = require_columns(words, path, f"header line {number + 1}")
            order = tuple(sorted(ORDER, key=lambda column: words.index(found[column])))
            if len(words) != 4:
                raise RecordingError(
                    f"{path}: header line {number + 1} names {len(words)} columns; keep t, x, y and p only"
                )
        elif len(words) == 4 and all(_is_number(word) for word in words):
            return _Head(number, sensor, order, comma, words[order.index("t")].isdecimal())
        else:
            raise _no_event(path, number + 1, line)
    raise RecordingError(f"{path}: the recording is empty: text without a single event")


def _refuse_what_is_no_event(block: list[str], done: int, path: str) -> None:
    """Raise for the first line that is not four numbers; ``done`` lines came before the block."""
    for number, line in enumerate(block, done + 1):
        words = line.replace(",", " ").split()
        if not _is_blank(line) and (len(words) != 4 or not all(map(_is_number, words))):
            raise _no_event(path, number, line)


def _no_event(path: str, number: int, line: str) -> RecordingError:
    return RecordingError(
        f"{path}: line {number:,} is no event: {line.strip()[:60]!r};"
        " a text recording has t x y p on each line"
    )


def _is_blank(line: str) -> bool:
    text = line.lstrip()
    return not text or text.startswith(COMMENTS)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
