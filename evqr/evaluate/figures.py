"""Figures 7 and 8 of the paper, and plots of what the table does not show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from evqr.baselines.registry import METHODS
from evqr.evaluate.cell import CellResult
from evqr.evaluate.details import EDGE_BOUNDS, SINGLE
from evqr.evaluate.metrics import Trial, binned, calibration, mode_of
from evqr.picture import FALSE_DARK, FALSE_LIGHT, GREY, INK, figure_class

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#868e96", "#e8590c", "#2f9e44", "#1971c2", "#c2255c", "#f783ac", "#9c36b5", "#f08c00", "#0b7285")
CONFIDENCE_BOUNDS = (0.0, 0.9, 0.99, 0.999, 1.0 - 1e-4, 1.0 - 1e-6, 1.0 - 1e-9, 1.0)

NEVER = 3.0
"""What did not happen in N tries has a chance below this over N, at 95 %."""


def figures_of(table: Sequence[CellResult], sweep: Sequence[CellResult]) -> Mapping[str, Figure]:
    """Draw all figures for which there are cells.

    Parameters
    ----------
    table   cells of the table
    sweep   cells with other windows, or with fewer events

    Raises
    ------
    MissingExtra   matplotlib is not installed
    """
    everything = [*table, *sweep]
    figures = {
        "figure7": _grid(table, _draw_picture, "estimated images"),
        "figure8": _grid(
            [r for r in table if any(trial.best_accuracy is not None for trial in r.trials)],
            _draw_modules,
            "modules by the mode over the windows: magenta dark, truly light; green light, truly dark",
        ),
        "read-rate-against-angle": _against_angle(table),
        "read-rate-against-motion": _against(
            [r for r in everything if r.cell.keep == 1.0],
            lambda r: r.cell.stretch * r.entry.window_us / 1000.0 * r.speed_px_ms,
            "motion per window [px]",
        ),
        "bits-and-reads-against-events": _against_events(everything),
        "time-against-events": _time_against_events(everything),
        "confidence": _confidence(everything),
    }
    return {name: figure for name, figure in figures.items() if figure is not None}


def _figure(width: float, height: float, *, dpi: int = 100) -> Figure:
    return figure_class()(figsize=(width, height), dpi=dpi, facecolor="white", layout="constrained")


def _colour(method: str) -> str:
    return COLOURS[list(METHODS).index(method) % len(COLOURS)]


def _grid(table: Sequence[CellResult], draw: Callable[[Axes, CellResult], bool], title: str) -> Figure | None:
    """Draw a picture a cell: a scene and an angle a row, a method a column."""
    rows = list(dict.fromkeys((r.entry.scene, r.entry.angle) for r in table))
    columns = [m for m in METHODS if any(r.cell.method == m for r in table)]
    if not rows or not columns:
        return None
    figure = _figure(1.7 * len(columns) + 1.0, 1.75 * len(rows) + 0.5, dpi=75)
    figure.suptitle(title, color=INK)
    all_axes = np.atleast_2d(figure.subplots(len(rows), len(columns), squeeze=False))
    for axes in all_axes.ravel():
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_color(GREY)
    for result in table:
        row = rows.index((result.entry.scene, result.entry.angle))
        axes = all_axes[row, columns.index(result.cell.method)]
        if not draw(axes, result):
            axes.text(
                0.5,
                0.5,
                "none converged",
                ha="center",
                va="center",
                size=8,
                color=GREY,
                transform=axes.transAxes,
            )
    for column, method in enumerate(columns):
        all_axes[0, column].set_title(
            METHODS[method].title.replace(", ", ",\n").replace(" + ", "\n+ "), size=8
        )
    for row, (scene, angle) in enumerate(rows):
        all_axes[row, 0].set_ylabel(f"{scene}, {angle:g}°", size=8)
    return figure


def _draw_picture(axes: Axes, result: CellResult) -> bool:
    if result.picture is None:
        return False
    axes.imshow(result.picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    return True


def _draw_modules(axes: Axes, result: CellResult) -> bool:
    from matplotlib.colors import ListedColormap

    grids = [t.modules for t in result.trials if t.converged and t.modules is not None]
    if not grids:
        return False
    dark, truly_dark = mode_of(grids) < 0, result.truth.modules < 0
    kind = np.where(dark, np.where(truly_dark, 0, 2), np.where(truly_dark, 3, 1))
    colours = ListedColormap([INK, "white", FALSE_DARK, FALSE_LIGHT])
    axes.imshow(kind, cmap=colours, vmin=-0.5, vmax=3.5, interpolation="nearest")
    return True


def _methods(results: Sequence[CellResult]) -> list[str]:
    return [m for m in METHODS if any(r.cell.method == m for r in results)]


def _against_angle(table: Sequence[CellResult]) -> Figure | None:
    scenes = list(dict.fromkeys(r.entry.scene for r in table))
    if not scenes:
        return None
    figure = _figure(4.2 * len(scenes), 4.4)
    all_axes = figure.subplots(1, len(scenes), sharey=True, squeeze=False)[0]
    for axes, scene in zip(all_axes, scenes, strict=True):
        for method in _methods(table):
            cells = sorted(
                (r for r in table if (r.entry.scene, r.cell.method) == (scene, method)),
                key=lambda r: r.entry.angle,
            )
            rates = [100.0 * (r.score.yield_rate or 0.0) for r in cells]
            axes.plot(
                [r.entry.angle for r in cells],
                rates,
                "o-",
                color=_colour(method),
                label=METHODS[method].title,
            )
        axes.set(title=scene, xlabel="angle of the code [deg]", ylim=(-3, 103))
    all_axes[0].set_ylabel("read, of all windows [%]")
    figure.legend(*all_axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    return figure


def _against(results: Sequence[CellResult], key: Callable[[CellResult], float], label: str) -> Figure | None:
    """Draw read rate against what is the same for a cell's trials; the mean where cells share it."""
    cells = [r for r in results if r.speed_px_ms > 0.0 and r.cell.method != "image"]
    if not cells:
        return None
    figure = _figure(7.0, 4.4)
    axes = figure.subplots()
    for method in _methods(cells):
        rates: dict[float, list[float]] = {}
        for result in (r for r in cells if r.cell.method == method):
            rates.setdefault(round(key(result), 3), []).append(100.0 * (result.score.yield_rate or 0.0))
        axes.plot(
            sorted(rates),
            [np.mean(rates[at]) for at in sorted(rates)],
            "o-",
            alpha=0.8,
            color=_colour(method),
            label=METHODS[method].title,
        )
    axes.set(xlabel=label, ylabel="read, of all windows [%]", xscale="log", ylim=(-3, 103))
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    return figure


def _with_events(results: Sequence[CellResult], method: str) -> list[tuple[float, Trial, CellResult]]:
    return [
        (trial.events_per_edge, trial, result)
        for result in results
        if result.cell.method == method
        for trial in result.trials
        if trial.events_per_edge is not None
    ]


def _against_events(results: Sequence[CellResult]) -> Figure | None:
    """Draw bits and read rate against events per module edge, for methods that take one window."""
    single = [method for method in _methods(results) if method in SINGLE]
    if not any(_with_events(results, method) for method in single):
        return None
    figure = _figure(10.0, 4.2)
    bits, reads = figure.subplots(1, 2)
    for method in single:
        trials = _with_events(results, method)
        found = [(e, t.best_accuracy) for e, t, _ in trials if t.best_accuracy is not None]
        for axes, points in (
            (bits, found),
            (reads, [(e, float(t.text == r.truth.text)) for e, t, r in trials]),
        ):
            if points:
                bins = binned([e for e, _ in points], [value for _, value in points], EDGE_BOUNDS)
                axes.plot(
                    [b.key for b in bins],
                    [100.0 * b.value for b in bins],
                    "o-",
                    color=_colour(method),
                    label=METHODS[method].title,
                )
    bits.set(xlabel="events per module edge", ylabel="right bits where a code was found [%]")
    reads.set(xlabel="events per module edge", ylabel="read, of all windows [%]", ylim=(-3, 103))
    figure.legend(*reads.get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
    return figure


def _time_against_events(results: Sequence[CellResult]) -> Figure | None:
    methods = [m for m in _methods(results) if _with_events(results, m)]
    if not methods:
        return None
    figure = _figure(7.0, 4.4)
    axes = figure.subplots()
    for method in methods:
        trials = _with_events(results, method)
        edges = [events for events, _, _ in trials]
        axes.plot(
            edges,
            [1e3 * trial.seconds for _, trial, _ in trials],
            ".",
            alpha=0.5,
            color=_colour(method),
            label=METHODS[method].title,
        )
    axes.set(
        xlabel="events per module edge", ylabel="computing time of a trial [ms]", xscale="log", yscale="log"
    )
    figure.legend(loc="outside right upper", fontsize=8)
    return figure


def _confidence(results: Sequence[CellResult]) -> Figure | None:
    """Draw stated confidence against the share of readings that are right."""
    readings = [
        (trial.confidence, float(trial.text == result.truth.text))
        for result in results
        for trial in result.trials
        if trial.text is not None and trial.confidence is not None
    ]
    if not readings:
        return None
    bins, error = calibration([c for c, _ in readings], [right for _, right in readings], CONFIDENCE_BOUNDS)
    figure = _figure(7.0, 4.2)
    axes = figure.subplots()
    places = np.arange(len(bins))
    wrong = np.array([1.0 - b.value for b in bins])
    bound = np.array([NEVER / b.count for b in bins])
    axes.bar(
        places - 0.2,
        [max(1.0 - b.key, 1e-15) for b in bins],
        0.4,
        label="stated chance to be wrong",
        color=GREY,
    )
    axes.bar(
        places + 0.2, np.where(wrong > 0.0, wrong, 0.0), 0.4, label="share that is wrong", color=FALSE_DARK
    )
    axes.bar(
        places + 0.2,
        np.where(wrong > 0.0, 0.0, bound),
        0.4,
        label="none is wrong: bound at 95 %",
        fill=False,
        edgecolor=FALSE_DARK,
        linestyle=":",
    )
    axes.set_xticks(places, [f"1 - {1.0 - b.low:.0e} and more\n{b.count} readings" for b in bins], size=8)
    axes.set(
        title=f"{len(readings)} readings, {int(sum(1.0 - right for _, right in readings))} wrong; "
        f"mean distance {error:.1g}",
        xlabel="stated confidence",
        yscale="log",
        ylim=(1e-15, 1.0),
    )
    axes.legend(fontsize=8)
    return figure
