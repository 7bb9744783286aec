"""What a run of the table leaves behind: tables, figures, and one HTML page with all of it."""

from __future__ import annotations

import base64
import html
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evqr.paper.dataset.manifest import write_atomically
from evqr.paper.evaluate.cell import CellResult, source
from evqr.paper.evaluate.details import Details, details_of
from evqr.paper.evaluate.figures import figures_of
from evqr.paper.evaluate.table import Line, csv_of, markdown_of, ordered, rows_of, table_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NOTES = """
Numbers in brackets are those that the paper prints for the same cell (WACV 2020, Table 1). The paper's scenes
were real (faster, slower) and its code was MATLAB on another machine, so its times are no yardstick for ours:
compare rows within one column.

- **Read rate** is of the trials that converged, as in the paper; *read, of all N* counts every trial.
- **Time and iterations to read** are means over the trials that read at some iterate, converged or not, as in
  the paper; the **median** of the same times is what to compare where a machine does other work too, as being
  stopped for a while moves the mean. Time includes searching and decoding that one iterate; *of it search* is
  the median of what finding the code takes, for the methods that find it in a step of its own. Images are
  searched at iterations 1, 2, 3, 4 and then at steps of a half. For evqr the iterations are those of
  conjugate gradients; for the two rows with zxing-cpp there are none.
- **Mode and max accuracy** are of the modules outside the function patterns, before error correction.
- All modules are decoded by the same decoder with the same effort (erasures included), whichever method made
  them. The rows *Image*, *Bardow* and *w/o QR* get their modules by the pattern matching of section 4.4.
- *Ours (the paper's)* starts from principal components and 1:1:3:1:1 as the paper does, and from our motion
  and finder patterns where those find nothing; *Image*, *Bardow*, *w/o QR* are matched by a finder that
  checks known modules, which the paper's did not: all to the rivals' favour. Against them: *Bardow* runs at
  half the resolution unless the row says full, from zero, for at most 60 iterations; and the tolerances by
  which it and *w/o QR* end are ours.
- evqr is told neither version nor motion, nor anything of the sensor; *Image*, *Bardow*, *w/o QR* and *Ours
  (the paper's)* are told the version.
"""

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #212529; margin: 2rem auto; max-width: 1200px }
table { border-collapse: collapse; font-size: 12.5px; width: 100% }
th, td { padding: .2rem .45rem; text-align: right; border-bottom: 1px solid #e9ecef; white-space: nowrap }
th { white-space: normal; vertical-align: bottom; border-bottom: 2px solid #868e96 }
td:nth-child(-n+2), th:nth-child(-n+2) { text-align: left }
tr.block td { border-top: 2px solid #adb5bd } tr.own { background: #f1f8ff }
img { max-width: 100% } .paper { color: #868e96 } code { background: #f1f3f5; padding: 0 .25em }
"""


@dataclass(frozen=True, kw_only=True)
class About:
    """Where results come from.

    Attributes
    ----------
    command : str
        That made them.
    dataset : str
        One line.
    """

    command: str
    dataset: str


def write_report(
    folder: Path, table: Sequence[CellResult], sweep: Sequence[CellResult], about: About
) -> list[Path]:
    """Write ``table1.md``, ``.csv`` and ``.json``, the figures as PNG, and ``report.html``.

    Returns
    -------
    paths : list of Path
        Of what was written.

    Raises
    ------
    MissingExtra
        Matplotlib is not installed.
    """
    lines = table_of(table)
    facts = _facts(table, about)
    listed = "".join(f"- {name}: {value}\n" for name, value in facts.items())
    details = details_of(table, sweep)
    written = {
        "table1.md": "\n".join(
            [
                f"# Table 1\n\n{listed}\n{markdown_of(lines)}\n{NOTES.strip()}\n",
                *(part.markdown for part in details),
            ]
        ),
        "table1.csv": csv_of(lines),
        "table1.json": json.dumps(_record(lines, details, sweep, facts), indent=1) + "\n",
    }
    figures = figures_of(table, sweep)
    pictures = {name: _png(figure) for name, figure in figures.items()}
    written["report.html"] = _html(lines, details, facts, pictures)
    for name, text in written.items():
        write_atomically(folder / name, text)
    for name, png in pictures.items():
        (folder / f"{name}.png").write_bytes(png)
    return [folder / name for name in (*written, *(f"{name}.png" for name in pictures))]


def _record(
    lines: Sequence[Line],
    details: Sequence[Details],
    sweep: Sequence[CellResult],
    facts: Mapping[str, str],
) -> dict[str, Any]:
    """Give all numbers: facts, the table, the tables below it, and the cells with other windows or events."""
    return {
        "about": facts,
        "lines": [line.record() for line in lines],
        "details": [asdict(part) for part in details],
        "sweep": [
            {"stretch": result.cell.stretch, "keep": result.cell.keep, **line.record()}
            for result, line in zip(ordered(sweep), table_of(sweep), strict=True)
        ],
    }


def _facts(table: Sequence[CellResult], about: About) -> dict[str, str]:
    return {
        "made": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        "cells computed by": "; ".join(sorted({result.source for result in table})),
        "page drawn by": source(),
        "command": about.command,
        "scenes": about.dataset,
        "machine": "; ".join(sorted({result.machine for result in table})),
    }


def _png(figure: Figure) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _html(
    lines: Sequence[Line],
    details: Sequence[Details],
    facts: Mapping[str, str],
    pictures: Mapping[str, bytes],
) -> str:
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8><title>evqr: Table 1</title>",
        f"<style>{_STYLE}</style><h1>Table 1</h1>",
        "<ul>",
        *(
            f"<li>{html.escape(name)}: <code>{html.escape(value)}</code></li>"
            for name, value in facts.items()
        ),
        "</ul>",
        _html_table(lines),
        _html_notes(),
        *(_html_details(part) for part in details),
    ]
    for name, png in pictures.items():
        data = base64.b64encode(png).decode("ascii")
        heading = html.escape(re.sub(r"(\D)(\d)", r"\1 \2", name).replace("-", " ").capitalize())
        parts.append(f'<h2>{heading}</h2><img alt="{heading}" src="data:image/png;base64,{data}">')
    return "\n".join(parts) + "</html>\n"


def _html_table(lines: Sequence[Line]) -> str:
    rows = rows_of(lines)
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in rows[0])
    body = []
    before: list[str] = []
    for line, row in zip(lines, rows[1:], strict=True):
        kinds = ["block"] if row[:2] != before else []
        kinds += ["own"] if line.method.startswith("evqr") else []
        before = row[:2]
        cells = "".join(f"<td>{_grey(html.escape(cell))}</td>" for cell in row)
        body.append(f'<tr class="{" ".join(kinds)}">{cells}</tr>')
    return f"<table><tr>{head}</tr>{''.join(body)}</table>"


def _html_details(details: Details) -> str:
    head, *body = (
        "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row)
        for tag, row in zip(["th", *["td"] * len(details.rows)], details.rows, strict=False)
    )
    rows = "".join(f"<tr>{row}</tr>" for row in body)
    return f"<p>{html.escape(details.caption)}</p><table><tr>{head}</tr>{rows}</table>"


def _grey(cell: str) -> str:
    ours, bracket, paper = cell.partition(" (")
    return f'{ours} <span class="paper">({paper}</span>' if bracket and paper[:1].isdigit() else cell


def _html_notes() -> str:
    """Give the notes, whose Markdown is paragraphs, one list and emphasis."""
    import re

    text = html.escape(NOTES.strip())
    text = re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", text)
    text = re.sub(r"\*(.+?)\*", r"<i>\1</i>", text, flags=re.DOTALL)
    paragraph, _, points = text.partition("\n- ")
    items = "".join(f"<li>{point}</li>" for point in points.split("\n- "))
    return f"<p>{paragraph}</p><ul>{items}</ul>"
