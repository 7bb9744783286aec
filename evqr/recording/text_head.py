"""What the first lines of a text recording tell: separator, columns, sensor, unit.

Lines that are no events are titles, names of columns, the sensor's size (two whole numbers, as E2VID writes
it), or comments, which begin with #, % or // and may tell any of these.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from ..errors import RecordingError
from .columns import Columns, find_columns, require_columns, settle_order, unit_in_name
from .declared import (
    TIMES,
    DeclaredSensor,
    DeclaredUnit,
    Unclear,
    find_sensor,
    first_of,
    parse_size,
    parse_unit,
)
from .options import Asked

COMMENTS = ("#", "%", "//")
WORDS = {
    **dict.fromkeys(("true", "on", "pos", "positive", "brighter"), 1),
    **dict.fromkeys(("false", "off", "neg", "negative", "darker"), 0),
}
"""What may stand for a polarity."""

SAMPLE_LINES = 4096
MAX_TITLES = 32

_NAME = re.compile(r"\"[^\"]*\"|'[^']*'|[^\s\[(,;]+(?:\s*[\[(][^\])]*[\])])?")
_SAID = re.compile(rf"([A-Za-z][\w ]*?)\s*[:=]?\s*[\[(]?(\d+)(?:\s*[x{TIMES}*,; ]\s*(\d+))?", re.ASCII)
_UNIT = re.compile(
    r"\b(?:units?\s*[:=]?|(?:t|times?|timestamps?)\s+(?:is |are )?in|(?:t|times?|timestamps?)\s*[\[(])"
    r"\s*([^\s,;\])]+)",
    re.IGNORECASE,
)


class Style(NamedTuple):
    """How values are written in a line.

    Attributes
    ----------
    separator : str, optional
        Between values; None: spaces or tabs.
    decimal_comma : bool
        Whether fractions begin with a comma.
    """

    separator: str | None
    decimal_comma: bool

    def cells(self, line: str) -> list[str]:
        """Cells of a line, without quotes."""
        line = line.strip().strip("[](){}").removesuffix(self.separator or " ").strip()
        cells = [cell.strip().strip("\"'") for cell in line.split(self.separator)]
        return [cell.replace(",", ".") for cell in cells] if self.decimal_comma else cells

    def values(self, line: str) -> list[float] | None:
        """Values of a line, or None if any is none."""
        return _values(self.cells(line))

    @property
    def words(self) -> str:
        """The separator in words."""
        return {None: "spaces", ",": "commas", ";": "semicolons", "|": "bars"}[self.separator]


STYLES = tuple(
    Style(separator, comma)
    for separator, comma in (
        (";", False),
        (";", True),
        (",", False),
        ("|", False),
        (None, False),
        (None, True),
    )
)


class Head(NamedTuple):
    """What the lines before the first event, and the first events, tell.

    Attributes
    ----------
    lines : int
        Lines before the first event.
    style : Style
        How values are written.
    columns : Columns
        What each column is.
    sensor : DeclaredSensor or Unclear, optional
        As declared, if it is.
    unit : DeclaredUnit, optional
        As declared, if it is.
    whole_times : bool
        Whether no time of the sample has a fraction.
    words : bool
        Whether polarities are words.
    notes : tuple of str
        What was decided.
    """

    lines: int
    style: Style
    columns: Columns
    sensor: DeclaredSensor | Unclear | None
    unit: DeclaredUnit | None
    whole_times: bool
    words: bool
    notes: tuple[str, ...]


def read_head(lines: Sequence[str], path: str, asked: Asked) -> Head:
    """Judge the first lines of a file.

    Parameters
    ----------
    lines : sequence of str
        The first `SAMPLE_LINES` lines, or all.
    path : str
        The recording, for messages.
    asked : Asked
        What the user says.
    """
    said: dict[str, str] = {}
    sensor: DeclaredSensor | None = None
    unit: DeclaredUnit | None = None
    names: list[str] | None = None
    names_line = 0
    titles: list[int] = []
    for number, line in enumerate(lines):
        text = line.strip()
        if not text:
            continue
        comment = text.startswith(COMMENTS)
        text = text.lstrip("#%/ ") if comment else text
        if comment:
            said |= {m[1]: m[2] if m[3] is None else f"{m[2]}x{m[3]}" for m in _SAID.finditer(text)}
            unit = unit or _unit_in(text)
        elif (style := event_style(text, names)) is not None:
            if names is None and titles and asked.columns is None:
                _refuse_unknown_names(lines[titles[-1]], style, text, path, titles[-1] + 1)
            passed = _passed_over(titles)
            rows = [
                values for line in lines[number:] if not is_blank(line) and (values := style.values(line))
            ]
            cells = style.cells(text)
            columns, remark = _columns(rows, len(cells), names, asked, path, f"header line {names_line + 1}")
            t, p = columns.index("t"), columns.index("p")
            if names is not None and len(names) == len(cells):
                named = unit_in_name(names[t])
                unit = DeclaredUnit(named, f"column {names[t]!r} says so") if named else unit
            return Head(
                number,
                style,
                columns,
                first_of((sensor, find_sensor(said))),
                unit,
                all(_is_whole(style, line, t) for line in lines[number:] if not is_blank(line)),
                any(word in _cell(style, line, p) for line in lines[number:] for word in WORDS),
                tuple(note for note in (*passed, remark) if note),
            )
        elif (size := _size(text)) is not None and sensor is None:
            sensor = DeclaredSensor(size)
            continue
        elif names is not None and (units := _units_below(text, len(names))):
            unit = unit or _time_unit_below(names, units)
            continue
        found = names_in(text)
        if found is not None and len(find_columns(found)) == 4:
            names, names_line = found, number
        elif not comment:
            titles.append(number)
            if len(titles) > MAX_TITLES or (found is not None and len(find_columns(found)) > 1):
                break
    if not titles:
        raise RecordingError(f"{path}: the recording is empty: text without a single event")
    first = titles[-1] if names_in(lines[titles[-1]]) else titles[0]
    named = names_in(lines[first]) or []
    if len(named) >= 4:
        require_columns(named, path, f"header line {first + 1}")
    raise no_event(path, titles[0] + 1, lines[titles[0]])


def event_style(line: str, names: list[str] | None = None) -> Style | None:
    """How a line is written if it is an event: at least four values, or values below the names t, x, y, p."""
    for style in STYLES:
        cells = style.cells(line)
        if names is not None and len(cells) == len(names):
            cells = [cells[names.index(name)] for name in find_columns(names).values()]
        if len(cells) >= 4 and _values(cells) is not None:
            return style
    return None


def names_in(line: str) -> list[str] | None:
    """Names of columns that a line may hold, or None where it has a number."""
    text = line.strip().lstrip("#%/ ").rstrip(",;|\t ")
    separator = next((s for s in (";", ",", "\t", "|") if s in text), None)
    parts = text.split(separator) if separator else _NAME.findall(text)
    names = [part.strip().strip("\"'").strip() for part in parts]
    return (
        None if any(value_of(name) is not None and name.casefold() not in WORDS for name in names) else names
    )


def _units_below(line: str, count: int) -> list[str] | None:
    """Cells of a line below the names that has units for as many columns, or None."""
    cells = names_in(line) or []
    units = [parse_unit(cell) for cell in cells]
    return cells if count - 1 <= len(cells) <= count and any(units) else None  # the last may be empty


def _time_unit_below(names: list[str], units: list[str]) -> DeclaredUnit | None:
    column = names.index(find_columns(names)["t"])
    cell = units[column] if column < len(units) else ""
    unit = parse_unit(cell)
    return DeclaredUnit(unit, f"{cell!r} below the names says so") if unit else None


def is_blank(line: str) -> bool:
    """Whether a line holds nothing, or a comment."""
    text = line.lstrip()
    return not text or text.startswith(COMMENTS)


def no_event(path: str, number: int, line: str) -> RecordingError:
    """Error of a line that is no event."""
    return RecordingError(f"{path}: {no_event_text(number, line)}; {NO_EVENT_ADVICE}")


def no_event_text(number: int, line: str) -> str:
    """Tell what is wrong with a line that is no event."""
    return f"line {number:,} is no event: {line.strip()[:60]!r}"


NO_EVENT_ADVICE = "a text recording has t x y p on each line"


def _columns(
    rows: list[list[float]], count: int, names: list[str] | None, asked: Asked, path: str, where: str
) -> tuple[Columns, str]:
    """Tell what the columns of the sample are, and a note on it."""
    table = np.array([row for row in rows if len(row) == count] or [[0.0] * count])
    if asked.columns is not None:
        if len(asked.columns) != count:
            raise RecordingError(
                f'{path}: columns="{",".join(asked.columns)}" names {len(asked.columns)} columns, and lines'
                f" have {count}; name all of them, with - for what is not read"
            )
        return asked.columns, ""
    if names is not None:
        if len(names) == count - 1 and _is_index(table[:, 0]):  # as R writes tables
            names = ["", *names]
        if len(names) != count:
            raise RecordingError(
                f"{path}: {where} names {len(names)} columns, and lines have {count}; say what they are:"
                f' columns="{",".join(["t", "x", "y", "p", *"-" * (count - 4)])}"'
            )
        found = {name: column for column, name in find_columns(names).items()}
        others = [repr(name) if name else "an index" for name in names if name not in found]
        remark = f"columns that are not read: {', '.join(others)}" if others else ""
        return tuple(found.get(name, "-") for name in names), remark
    if count == 4:
        return settle_order(list(table.T), asked.sensor, path, "the text")
    if count == 5 and _is_index(table[:, 0]):
        order, remark = settle_order(list(table.T[1:]), asked.sensor, path, "the text")
        index = "the first column is taken as an index: it counts the lines"
        return ("-", *order), f"{index}; {remark}" if remark else index
    raise RecordingError(
        f"{path}: lines have {count} columns without names; say which are t, x, y and p:"
        f' columns="{",".join(["t", "x", "y", "p", *"-" * (count - 4)])}"'
    )


def _is_index(column: np.ndarray) -> bool:
    return len(column) > 1 and column[0] in (0, 1) and bool(np.all(np.diff(column) == 1))


def _refuse_unknown_names(line: str, style: Style, event: str, path: str, number: int) -> None:
    """Raise for names of columns, as many as there are values, that are not those of events."""
    names = names_in(line)
    if names is not None and len(names) == len(style.cells(event)):
        require_columns(names, path, f"header line {number}")


def _passed_over(titles: list[int]) -> list[str]:
    if not titles:
        return []
    lines = ", ".join(str(number + 1) for number in titles)
    return [f"line{'s' * (len(titles) > 1)} {lines}: no event and no names of columns, passed over"]


def _unit_in(text: str) -> DeclaredUnit | None:
    for match in _UNIT.finditer(text):
        if unit := parse_unit(match[1]):
            return DeclaredUnit(unit, f"a comment says {match[0].strip()!r}")
    return None


def _size(text: str) -> tuple[int, int] | None:
    """Size that a line is, of two whole numbers and nothing else."""
    return parse_size(text) if re.fullmatch(rf"\d+(?:\s*[x{TIMES},;]\s*|\s+)\d+", text) else None


def _values(cells: Iterable[str]) -> list[float] | None:
    values: list[float] = []
    for cell in cells:
        if (value := value_of(cell)) is None:
            return None
        values.append(value)
    return values


def value_of(cell: str) -> int | float | None:
    """Return the value of a cell: whole with all its digits, any other, or a word for a polarity."""
    cell = cell.strip().strip("\"'")
    if cell.lstrip("+-").isdecimal() and cell.isascii():
        return int(cell) if len(cell) < 40 else float(cell)
    try:
        return float(cell)
    except ValueError:
        return WORDS.get(cell.casefold())


def _cell(style: Style, line: str, index: int) -> str:
    cells = style.cells(line)
    return cells[index].casefold() if index < len(cells) else ""


def _is_whole(style: Style, line: str, index: int) -> bool:
    cell = _cell(style, line, index)
    return not cell or cell.lstrip("+-").isdecimal() or value_of(cell) is None
