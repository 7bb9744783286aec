"""Figures 7 and 8 of the paper, and plots of what the table does not show."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evqr.output.drawing import FALSE_DARK, FALSE_LIGHT, GREY, INK, figure_class
from evqr.paper.evaluate.cell import CellResult
from evqr.paper.evaluate.details import EDGE_BOUNDS, SINGLE
from evqr.paper.evaluate.metrics import Trial, binned, calibration, mode_of
from evqr.paper.methods.registry import METHODS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (
    "#868e96", "#e8590c", "#ffc078", "#2f9e44", "#1971c2", "#c2255c",
    "#f783ac", "#9c36b5", "#495057", "#f08c00", "#0b7285",
)  # fmt: skip
MARKERS = "oshD^vX*P<>"
"""Of the methods, in the order of the table."""

CONFIDENCE_BOUNDS = (0.0, 0.9, 0.99, 0.999, 1.0 - 1e-4, 1.0 - 1e-6, 1.0 - 1e-9, 1.0)

CERTAIN = 1e-16
"""Stated chances below this are stated as none: a confidence is a double precision number below 1."""

NEVER = 3.0
"""What did not happen in N tries has a chance below this over N, at 95 %."""


def figures_of(table: Sequence[CellResult], sweep: Sequence[CellResult]) -> Mapping[str, Figure]:
    """Draw all figures for which there are cells.

    Parameters
    ----------
    table : sequence of CellResult
        Cells of the table.
    sweep : sequence of CellResult
        Cells with other windows, or with fewer events.

    Raises
    ------
    MissingExtra
        Matplotlib is not installed.
    """
    everything, with_modules = [*table, *sweep], _with_modules(table)
    figures = {
        "figure7": _grid(table, _draw_picture, "estimated images"),
        "figure8": _grid(
            [r for r in table if r.cell.method in with_modules],
            _draw_modules,
            "modules by the mode over the windows: magenta dark, truly light; green light, truly dark",
        ),
        "read-rate-against-angle": _against_angle(table),
        "read-rate-against-motion": _against_motion(everything),
        "bits-against-events": _against_events(everything, _bits, "right bits where a code was found [%]"),
        "reads-against-events": _against_events(everything, _read, "read, of all windows [%]", (-3, 103)),
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


def _with_modules(results: Sequence[CellResult]) -> list[str]:
    """Give the methods that make modules, even where they made none."""
    return _methods([r for r in results if any(trial.best_accuracy is not None for trial in r.trials)])


def _panels(results: Sequence[CellResult], rows: int = 1) -> tuple[Figure, dict[str, NDArray[Any]]] | None:
    """Make a figure with a column of axes a scene: sensors differ, so that a line must not join them."""
    scenes = list(dict.fromkeys(r.entry.scene for r in results))
    if not scenes:
        return None
    figure = _figure(4.2 * len(scenes), 2.9 * rows + 1.5)
    all_axes = figure.subplots(rows, len(scenes), sharex="col", sharey=True, squeeze=False)
    for axes, scene in zip(all_axes[0], scenes, strict=True):
        axes.set_title(scene)
    return figure, dict(zip(scenes, all_axes.T, strict=True))


def _line(axes: Axes, x: Sequence[float], y: Sequence[float], method: str) -> None:
    """Draw a method's line; later ones are thinner, so that those below them are seen."""
    late = list(METHODS).index(method) / len(METHODS)
    axes.plot(
        x,
        y,
        "o-",
        color=_colour(method),
        linewidth=4.0 - 3.0 * late,
        markersize=9.0 - 5.0 * late,
        label=METHODS[method].title,
    )


def _legend(figure: Figure, all_axes: Iterable[Axes]) -> None:
    """Put every label once below the panels."""
    lines = {
        label: line
        for axes in all_axes
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(list(lines.values()), list(lines), loc="outside lower center", ncols=4, fontsize=8)


def _against_angle(table: Sequence[CellResult]) -> Figure | None:
    panels = _panels(table)
    if panels is None:
        return None
    figure, columns = panels
    for scene, (axes,) in columns.items():
        for method in _methods(table):
            cells = sorted(
                (r for r in table if (r.entry.scene, r.cell.method) == (scene, method)),
                key=lambda r: r.entry.angle,
            )
            rates = [100.0 * (r.score.yield_rate or 0.0) for r in cells]
            _line(axes, [r.entry.angle for r in cells], rates, method)
        axes.set(xlabel="angle of the code [deg]", ylim=(-3, 103))
    next(iter(columns.values()))[0].set_ylabel("read, of all windows [%]")
    _legend(figure, [axes for (axes,) in columns.values()])
    return figure


def _against_motion(results: Sequence[CellResult]) -> Figure | None:
    """Draw read rate against the motion in a window; the mean where cells share it."""
    cells = [r for r in results if r.cell.keep == 1.0 and r.speed_px_ms > 0.0 and r.cell.method in SINGLE]
    panels = _panels(cells)
    if panels is None:
        return None
    figure, columns = panels
    for scene, (axes,) in columns.items():
        for method in _methods(cells):
            rates: dict[float, list[float]] = {}
            for r in (r for r in cells if (r.entry.scene, r.cell.method) == (scene, method)):
                travel = r.cell.stretch * r.entry.window_us / 1000.0 * r.speed_px_ms
                rates.setdefault(round(travel, 2), []).append(100.0 * (r.score.yield_rate or 0.0))
            travels = sorted(rates)
            _line(axes, travels, [float(np.mean(rates[at])) for at in travels], method)
        axes.set(xlabel="motion per window [px]", ylim=(-3, 103))
    next(iter(columns.values()))[0].set_ylabel("read, of all windows [%]")
    _legend(figure, [axes for (axes,) in columns.values()])
    return figure


def _with_events(results: Sequence[CellResult], method: str) -> list[tuple[float, Trial, CellResult]]:
    return [
        (trial.events_per_edge, trial, result)
        for result in results
        if result.cell.method == method
        for trial in result.trials
        if trial.events_per_edge is not None
    ]


def _bits(trial: Trial, result: CellResult) -> float | None:
    return None if trial.best_accuracy is None else 100.0 * trial.best_accuracy


def _read(trial: Trial, result: CellResult) -> float | None:
    return 100.0 * (trial.text == result.truth.text)


def _against_events(
    results: Sequence[CellResult],
    value: Callable[[Trial, CellResult], float | None],
    title: str,
    limits: tuple[float, float] | None = None,
) -> Figure | None:
    """Draw something against events per module edge, for methods that take one window.

    A row of axes an angle and a column a scene: how much an event tells depends on both, so that a line over
    angles mixed would go up and down with what angle its points happen to be of.
    """
    cells = [r for r in results if r.cell.method in SINGLE and _with_events([r], r.cell.method)]
    angles = sorted({r.entry.angle for r in cells})
    panels = _panels(cells, len(angles))
    if panels is None:
        return None
    figure, columns = panels
    for scene, column in columns.items():
        for axes, angle in zip(column, angles, strict=True):
            of_axes = [r for r in cells if (r.entry.scene, r.entry.angle) == (scene, angle)]
            for method in _methods(of_axes):
                points = [(events, value(t, r)) for events, t, r in _with_events(of_axes, method)]
                points = [(events, y) for events, y in points if y is not None]
                bins = binned([events for events, _ in points], [y for _, y in points], EDGE_BOUNDS)
                if bins:
                    _line(axes, [b.key for b in bins], [b.value for b in bins], method)
        column[-1].set_xlabel("events per module edge")
    first = next(iter(columns.values()))
    for axes, angle in zip(first, angles, strict=True):
        axes.set_ylabel(f"{angle:g}°")
    first[0].set_ylim(limits)  # of all, which share it
    figure.supylabel(title)
    _legend(figure, [axes for column in columns.values() for axes in column])
    return figure


def _time_against_events(results: Sequence[CellResult]) -> Figure | None:
    """Draw the time of every trial, a marker of its own for each method."""
    methods = [m for m in _methods(results) if _with_events(results, m)]
    if not methods:
        return None
    figure = _figure(8.0, 5.0)
    axes = figure.subplots()
    for method in methods:
        trials = _with_events(results, method)
        axes.plot(
            [events for events, _, _ in trials],
            [1e3 * trial.seconds for _, trial, _ in trials],
            MARKERS[list(METHODS).index(method) % len(MARKERS)],
            markersize=4,
            alpha=0.6,
            color=_colour(method),
            label=METHODS[method].title,
        )
    axes.set(
        xlabel="events per module edge", ylabel="computing time of a trial [ms]", xscale="log", yscale="log"
    )
    figure.legend(loc="outside lower center", ncols=4, fontsize=8, markerscale=2)
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
    stated = np.array([max(1.0 - b.key, CERTAIN) for b in bins])
    wrong = np.array([1.0 - b.value for b in bins])
    bound = np.array([NEVER / b.count for b in bins])
    axes.bar(places - 0.2, stated, 0.4, label="stated chance to be wrong", color=GREY)
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
    axes.set_xticks(places, [f"{1.0 - b.low:.0e} and less\n{b.count} readings" for b in bins], size=8)
    count = int(sum(1.0 - right for _, right in readings))
    axes.set(
        title=f"{len(readings)} readings, {count} wrong"
        + ("" if count else f": a chance of at most {NEVER / len(readings):.1g}, at 95 %")
        + f"\nmean distance of stated and true {error:.1g}",
        xlabel="stated chance to be wrong",
        ylabel="chance to be wrong",
        yscale="log",
        ylim=(CERTAIN / 10.0, 1.0),
    )
    axes.legend(fontsize=8)
    return figure
