"""Smaller tables below Table 1: how the paper's method went, and what it takes to read."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evqr.paper.evaluate.cell import CellResult
from evqr.paper.evaluate.metrics import FEW_WRONG, binned
from evqr.paper.evaluate.paper import printed
from evqr.paper.evaluate.table import ordered, table_of, text_of
from evqr.paper.methods.registry import METHODS

EDGE_BOUNDS = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
"""Events per module edge: bounds of the intervals."""

SINGLE = ("without_qr", "descent", "evqr", "evqr_no_lag", "integrate")
"""Methods that take one window, so that its events are all they have."""


HARDER = ("without_qr", "descent")
"""The paper's rows that are compared on scenes made harder: one says how hard, one how long it takes."""


@dataclass(frozen=True, kw_only=True)
class Details:
    """A table.

    Attributes
    ----------
    caption : str
        What it is.
    rows : list of list of str
        Headings first.
    """

    caption: str
    rows: list[list[str]]

    @property
    def markdown(self) -> str:
        """The table in Markdown."""
        rows = [self.rows[0], ["---"] * len(self.rows[0]), *self.rows[1:]]
        return f"{self.caption}\n\n" + "".join(f"| {' | '.join(row)} |\n" for row in rows)


def details_of(table: Sequence[CellResult], sweep: Sequence[CellResult]) -> list[Details]:
    """Make the tables that the cells have something for."""
    parts = descents_of(table), harder_of([*table, *sweep]), events_of([*table, *sweep])
    return [part for part in parts if len(part.rows) > 1]


def descents_of(results: Sequence[CellResult]) -> Details:
    """Tabulate where the paper's method started, and its iterations."""
    heading = ["scene", "deg.", "N", "started as the paper does", "as the solver does", "not at all"]
    heading += ["iterations of m and W", "of q until it reads", "the paper's"]
    heading += [f"of q until {FEW_WRONG} codewords are wrong", "trials that get there"]
    rows = [heading]
    for line, result in zip(table_of(results), ordered(results), strict=True):
        starts = [trial.start for trial in result.trials]
        if not any(starts):
            continue
        first = [t.pose_iterations for t in result.trials if t.pose_iterations is not None]
        few = iterations_to_few(result)
        theirs = line.printed.iterations_to_read if line.printed else None
        rows.append([line.scene, f"{line.angle:g}", str(len(starts))])
        rows[-1] += [str(starts.count(start)) for start in ("paper", "solver", None)]
        rows[-1] += [text_of(float(np.median(first)) if first else None, ".3g", 1)]
        rows[-1] += [text_of(number, ".3g", 1) for number in (line.score.iterations_to_read, theirs)]
        rows[-1] += [text_of(float(np.mean(few)) if few else None, ".3g", 1), str(len(few))]
    caption = (
        f"{METHODS['descent'].title}: its start, and its iterations (median of the first step, means of the"
        f" second). The paper takes a code for readable up to about {FEW_WRONG} wrong codewords:"
    )
    return Details(caption=caption, rows=rows)


def harder_of(results: Sequence[CellResult]) -> Details:
    """Tabulate what becomes of two rows of the paper where fewer events make a scene harder."""
    found = {
        (result.entry.scene, result.entry.angle, result.cell.keep, result.cell.method): result
        for result in ordered(results)
        if result.cell.stretch == 1.0 and result.cell.method in HARDER
    }
    shares = sorted({share for _, _, share, _ in found}, reverse=True)
    rows = [["scene", "deg.", "the paper's", *(f"{100 * share:g} % of the events" for share in shares)]]
    for scene, angle in (
        dict.fromkeys((scene, angle) for scene, angle, *_ in found) if len(shares) > 1 else ()
    ):
        rated, counted = (printed(scene, method, angle) for method in HARDER)
        paper = f"{rated.read_rate:g} %; {counted.iterations_to_read:g}" if rated and counted else "-"
        pairs = [[found.get((scene, angle, share, method)) for method in HARDER] for share in shares]
        rows.append([scene, f"{angle:g}", paper, *(_harder(*pair) for pair in pairs)])
    hard, slow = (METHODS[method].title for method in HARDER)
    caption = (
        "Scenes made harder, where only a share of the events is kept, at random. Each entry: the read rate"
        f" of {hard}, as a measure of how hard they are; the mean iterations of q that {slow} takes until it"
        f" reads; and until {FEW_WRONG} codewords are wrong, with the number of trials that get there in"
        " brackets. With the paper's pair compare the share that has its read rate:"
    )
    return Details(caption=caption, rows=rows)


def _harder(rated: CellResult | None, counted: CellResult | None) -> str:
    if rated is None or counted is None:
        return "-"
    read = [t.iterations_to_read for t in counted.trials if t.iterations_to_read is not None]
    means = [f"{np.mean(n):.3g} ({len(n)})" if n else "-" for n in (read, iterations_to_few(counted))]
    return "; ".join([f"{text_of(rated.score.read_rate, '.0f', 100)} %", *means])


def iterations_to_few(result: CellResult) -> list[int]:
    """Give the iterations until few codewords are wrong, of the trials that get there."""
    return [t.iterations_to_few for t in result.trials if t.iterations_to_few is not None]


def events_of(results: Sequence[CellResult]) -> Details:
    """Tabulate read rate against events per module edge."""
    rows = [["events per edge", *(f"{a} to {b}" for a, b in itertools.pairwise(EDGE_BOUNDS))]]
    for method in SINGLE:
        trials = [
            (trial.events_per_edge, float(trial.text == result.truth.text))
            for result in results
            if result.cell.method == method
            for trial in result.trials
            if trial.events_per_edge is not None
        ]
        if trials:
            bins = {
                b.low: b for b in binned([e for e, _ in trials], [read for _, read in trials], EDGE_BOUNDS)
            }
            cells = [
                f"{100 * bins[a].value:.0f} % of {bins[a].count}" if a in bins else "-"
                for a in EDGE_BOUNDS[:-1]
            ]
            rows.append([METHODS[method].title, *cells])
    caption = "Read, of all windows, by a window's events on the code over the edges between its modules:"
    return Details(caption=caption, rows=rows)
