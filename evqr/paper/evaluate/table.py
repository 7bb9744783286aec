"""Table 1, in the paper's layout, with the paper's own numbers beside ours."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from evqr.paper.evaluate.cell import CellResult
from evqr.paper.evaluate.metrics import Score
from evqr.paper.evaluate.paper import Printed, printed
from evqr.paper.methods.registry import METHODS

TIMES = ("seconds_to_read", "median_seconds_to_read", "median_search_seconds", "seconds")
"""Columns that differ from run to run; all others are the same wherever a cell is computed."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """One line of the table.

    Attributes
    ----------
    scene : str
        Name of the scene.
    method : str
        Name of the method, in `METHODS`.
    title : str
        What the table calls the method.
    angle : float [deg]
        Of the code against the direction of travel.
    score : Score
        Ours.
    printed : Printed, optional
        The paper's; None where it has no such line.
    """

    scene: str
    method: str
    title: str
    angle: float
    score: Score
    printed: Printed | None

    def record(self, *, times: bool = True) -> dict[str, Any]:
        """Give the line flat; the paper's columns begin with "paper_"."""
        record = {"scene": self.scene, "method": self.method, "angle": self.angle, **asdict(self.score)}
        if not times:
            record = {name: value for name, value in record.items() if name not in TIMES}
        paper = asdict(self.printed) if self.printed else dict.fromkeys(Printed.__annotations__)
        return {**record, **{f"paper_{name}": value for name, value in paper.items()}}


def ordered(results: Sequence[CellResult]) -> list[CellResult]:
    """Order results: scenes as they come, methods as in the paper, then angles."""
    scenes = list(dict.fromkeys(result.entry.scene for result in results))
    methods = list(METHODS)
    return sorted(
        results,
        key=lambda r: (scenes.index(r.entry.scene), methods.index(r.cell.method), r.entry.angle),
    )


def table_of(results: Sequence[CellResult]) -> list[Line]:
    """Make the table, in order."""
    return [
        Line(
            scene=result.entry.scene,
            method=result.cell.method,
            title=METHODS[result.cell.method].title,
            angle=result.entry.angle,
            score=result.score,
            printed=printed(result.entry.scene, result.cell.method, result.entry.angle),
        )
        for result in ordered(results)
    ]


COLUMNS = (
    ("N", "trials", "d", 1),
    ("mode acc. [%]", "mode_accuracy", ".1f", 100),
    ("time to read [s]", "seconds_to_read", ".3g", 1),
    ("median time [s]", "median_seconds_to_read", ".3g", 1),
    ("of it search [s]", "median_search_seconds", ".3g", 1),
    ("iterations to read", "iterations_to_read", ".3g", 1),
    ("max acc. [%]", "max_accuracy", ".1f", 100),
    ("read rate [%]", "read_rate", ".1f", 100),
    ("ZXing from image [%]", "image_read_rate", ".1f", 100),
    ("read, of all N [%]", "yield_rate", ".1f", 100),
    ("false reads [%]", "false_read_rate", ".2g", 100),
    ("windows to read", "windows", ".3g", 1),
)
"""Heading, field of `Score`, format, factor."""


def rows_of(lines: Sequence[Line]) -> list[list[str]]:
    """Give the table as text, headings first: ours, and the paper's in brackets where it has a number."""
    rows = [["scene", "method", "deg.", *(heading for heading, *_ in COLUMNS)]]
    for line in lines:
        rows.append([line.scene, line.title, f"{line.angle:g}"])
        for _, name, form, factor in COLUMNS:
            ours = text_of(getattr(line.score, name), form, factor)
            paper = text_of(getattr(line.printed, name, None), "g", 1) if line.printed else "-"
            rows[-1].append(ours if paper == "-" else f"{ours} ({paper})")
    return rows


def text_of(value: float | None, form: str, factor: float) -> str:
    """Write a number, "-" where there is none."""
    return "-" if value is None else format(factor * value, form)


def markdown_of(lines: Sequence[Line]) -> str:
    """Give the table in Markdown; a scene and a method are named where they begin."""
    rows = rows_of(lines)
    before = ["", ""]
    shown = [rows[0], ["---"] * len(rows[0])]
    for row in rows[1:]:
        fresh = [name if row[: k + 1] != before[: k + 1] else "" for k, name in enumerate(row[:2])]
        before = row[:2]
        shown.append([*fresh, *row[2:]])
    return "".join(f"| {' | '.join(row)} |\n" for row in shown)


def csv_of(lines: Sequence[Line]) -> str:
    """Give the table as CSV, shares 0 to 1 and the paper's numbers as printed."""
    file = io.StringIO()
    records = [line.record() for line in lines]
    writer = csv.DictWriter(file, list(records[0]) if records else ["scene"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return file.getvalue()
