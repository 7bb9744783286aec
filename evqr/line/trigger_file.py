"""Triggers from a file: a line each, ``t_us,kind[,index[,ticks]]``."""

from __future__ import annotations

import csv
import math
from os import PathLike
from typing import NoReturn

from evqr.errors import UsageError
from evqr.line.gates import Trigger, TriggerKind

COLUMNS = ("t_us", "kind", "index", "ticks")
"""Of the file, in this order; the last one or two may be left out."""


def read_triggers(path: str | PathLike[str]) -> list[Trigger]:
    """Read triggers from a file of comma-separated values.

    Parameters
    ----------
    path : path
        A first line may name the columns: ``t_us`` in us, ``kind`` (pulse, start, end, ticks), ``index`` and
        ``ticks``, each of which may be empty.

    Returns
    -------
    triggers : list of Trigger
        In order of time; those of one time in the order of the file.

    Raises
    ------
    UsageError
        The file cannot be read, or a line is no trigger.
    """
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            rows = list(enumerate(csv.reader(file), 1))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror or error}); check the path") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{path}: is no text of {','.join(COLUMNS)} ({error}); save it as CSV") from error
    if rows and tuple(cell.strip() for cell in rows[0][1][:1]) == COLUMNS[:1]:
        rows = rows[1:]
    triggers = [_trigger(path, number, row) for number, row in rows if any(cell.strip() for cell in row)]
    return sorted(triggers, key=lambda trigger: trigger.t_us)


def _trigger(path: str | PathLike[str], number: int, row: list[str]) -> Trigger:
    def refuse(problem: str) -> NoReturn:
        raise UsageError(f"{path}: line {number}: {problem}; a line is {','.join(COLUMNS)}")

    cells = [cell.strip() for cell in row]
    if not 2 <= len(cells) <= len(COLUMNS):
        refuse(f"{len(cells)} columns")
    values: dict[str, int | float | None] = {}
    for name, kind, cell in (
        ("t_us", int, cells[0]),
        *zip(COLUMNS[2:], (int, float), cells[2:], strict=False),
    ):
        try:
            values[name] = kind(cell) if cell else None
        except ValueError:
            refuse(f"{name} {cell!r} is no number")
    if values["t_us"] is None:
        refuse("t_us is missing")
    ticks = values.get("ticks")
    if ticks is not None and not math.isfinite(ticks):
        refuse(f"ticks {cells[3]!r} is no number")
    try:
        kind = TriggerKind(cells[1])
    except ValueError:
        refuse(f"kind {cells[1]!r} is none of {', '.join(each.value for each in TriggerKind)}")
    return Trigger(values["t_us"], kind, values.get("index"), ticks)  # pyright: ignore[reportArgumentType]
