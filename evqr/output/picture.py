"""The picture of a reading: events, events with the motion taken out, estimated and true modules."""

from __future__ import annotations

import warnings
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evqr.errors import MissingExtra, UsageError
from evqr.events.array import EventArray
from evqr.output.records import payload_text
from evqr.results import CodeReading
from evqr_kernels.extras import install_command

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evqr.recording import Recording

ON, OFF, INK, GREY, FOUND = "#d9480f", "#1864ab", "#212529", "#adb5bd", "#2b8a3e"
FALSE_DARK, FALSE_LIGHT = "#e6009e", "#2fb344"  # magenta and green, as in Figure 8 of the paper

# Travel shown, in modules: little for the events as they came, where edges smear; more where the motion is
# taken out and they add up.
RAW_TRAVEL = 0.5
COMPENSATED_TRAVEL = 3.0

WIDTH, MARGIN, GAP, HEAD, TITLE, LEGEND = 12.0, 0.4, 0.35, 0.85, 0.3, 0.4  # layout [inches]


def span_us(reading: CodeReading, travel: float = COMPENSATED_TRAVEL) -> tuple[int, int]:
    """Return event times ``[start, end)`` [us] in which the code moves by ``travel`` modules.

    They end at ``t_read_us``, or later where the code was first seen too shortly before.
    """
    length = _travel_us(reading, travel)
    start = max(reading.t_first_us, reading.t_read_us - length)
    return start, start + length


def picture_events(recording: Recording, reading: CodeReading) -> EventArray:
    """Return the events of a recording that a picture of ``reading`` shows, in bounded memory."""
    start, end = span_us(reading)
    parts = []
    for chunk in recording.chunks():
        if chunk.t[0] >= end:
            break
        parts.append(chunk.between(start, end))
    t, x, y, p = (np.concatenate([getattr(part, name) for part in parts]) for name in "txyp")
    return EventArray(t, x, y, p, recording.width, recording.height)


def save_picture(
    path: str | PathLike[str],
    events: EventArray,
    reading: CodeReading,
    *,
    truth: NDArray[np.int8] | None = None,
) -> None:
    """Draw a reading (see `draw_reading`) to a PNG, SVG or PDF file, by its ending.

    Raises
    ------
    MissingExtra
        Matplotlib is not installed.
    UsageError
        The ending names no picture format, or the file cannot be written.
    """
    require_drawable(path)
    figure = draw_reading(events, reading, truth=truth)
    try:
        with warnings.catch_warnings():
            # A text in a script that the font lacks shows boxes here; the reading itself has it.
            warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
            figure.savefig(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot write the picture: {error.strerror or error}") from error


def require_drawable(path: str | PathLike[str]) -> None:
    """Raise what `save_picture` raises for this path whatever it is to draw, before anything is computed."""
    path = Path(path)
    ending = path.suffix.removeprefix(".").lower()
    if ending not in figure_class()().canvas.get_supported_filetypes():
        raise UsageError(f"{path}: unknown picture format {ending!r}: end the name in .png, .svg or .pdf")
    if not path.parent.is_dir():
        raise UsageError(f"{path}: cannot write the picture: no such folder")


def draw_reading(
    events: EventArray,
    reading: CodeReading,
    *,
    truth: NDArray[np.int8] | None = None,
) -> Figure:
    """Draw how a code was read.

    Parameters
    ----------
    events : EventArray
        Events that hold `span_us` of the reading; others are not shown.
    reading : CodeReading
        What to show.
    truth : (r, r) int8, optional
        True modules, -1 dark, +1 light; None: the modules as decoded.

    Returns
    -------
    Figure
        Above: events as they came, and with the motion taken out, with the outline found.  Below: the
        estimate, its signs with the wrong modules in magenta (dark, truly light) and green (light, truly
        dark), the true modules.

    Raises
    ------
    MissingExtra
        Matplotlib is not installed.
    ValueError
        ``truth`` has another shape than the estimate.
    """
    make_figure = figure_class()
    if truth is not None and truth.shape != reading.estimate.shape:
        raise ValueError(f"truth must have shape {reading.estimate.shape}, got {truth.shape}")

    inside = WIDTH - 2 * MARGIN
    aspect = events.width / events.height
    above = (inside - GAP) / (aspect + 1)  # the view, and a square beside it
    below = (inside - 2 * GAP) / 3
    figure = make_figure(
        figsize=(WIDTH, HEAD + TITLE + above + LEGEND + TITLE + below + LEGEND), dpi=110, facecolor="white"
    )

    def axes_at(left: float, bottom: float, width: float, height: float) -> Axes:
        across, up = figure.get_size_inches()
        return figure.add_axes((left / across, bottom / up, width / across, height / up))

    top = LEGEND + below + TITLE + LEGEND
    _draw_heading(figure, reading)
    _draw_events(axes_at(MARGIN, top, aspect * above, above), events, reading)
    _draw_compensated(axes_at(MARGIN + aspect * above + GAP, top, above, above), events, reading)
    estimate, signs, true = (axes_at(MARGIN + i * (below + GAP), LEGEND, below, below) for i in range(3))
    _draw_estimate(estimate, reading)
    _draw_modules(signs, true, reading, truth)
    return figure


def figure_class() -> type[Figure]:
    """Return matplotlib's `Figure`; raise MissingExtra where it is not installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtra(f"drawing a picture needs matplotlib: {install_command('plot')}") from error
    return Figure


def _draw_heading(figure: Figure, reading: CodeReading) -> None:
    text = payload_text(reading)
    text = text if len(text) <= 60 else text[:59] + "\N{HORIZONTAL ELLIPSIS}"
    speed = float(np.hypot(*reading.motion_px_per_s))
    facts = (
        reading.symbol,
        f"{speed / 1000:.2f} px/ms = {speed / _module_px(reading):.0f} modules/s",
        f"confidence {reading.confidence:.3f}",
        f"windows {reading.windows}",
        f"codewords corrected {reading.errors_corrected}",
        f"computed in {reading.compute_ms.get('total', 0.0):.1f} ms",
    )
    height = figure.get_size_inches()[1]
    left = MARGIN / WIDTH
    figure.text(left, 1 - 0.5 / height, text, size=19, weight="bold", color=INK, parse_math=False)
    figure.text(left, 1 - 0.8 / height, "     ".join(facts), size=10.5, color="#495057")


def _draw_events(axes: Axes, events: EventArray, reading: CodeReading) -> None:
    """Last event of each pixel, about when the code was read."""
    start, end = span_us(reading, RAW_TRAVEL)
    shown = events.between(start, end)
    image = np.zeros((events.height, events.width), np.int8)
    image[shown.y, shown.x] = shown.p
    axes.imshow(image, cmap=_event_colours(), vmin=-1, vmax=1, interpolation="nearest")
    _draw_outline(axes, reading, linewidth=1.2)
    _frame(axes, f"events of {(end - start) / 1000:.2f} ms")
    _draw_legend(axes, ((ON, "brighter"), (OFF, "darker")))


def _draw_compensated(axes: Axes, events: EventArray, reading: CodeReading) -> None:
    """Events moved to where they would be at ``t_read_us``, added up, around the code."""
    start, end = span_us(reading)
    shown = events.between(start, end)
    age_s = (shown.t - reading.t_read_us) * 1e-6
    vx, vy = reading.motion_px_per_s
    low, high = reading.corners_px.min(axis=0), reading.corners_px.max(axis=0)
    half = float((high - low).max()) / 2 + 4 * _module_px(reading)  # the quiet zone is shown too
    (x0, y0), (x1, y1) = (low + high) / 2 - half, (low + high) / 2 + half
    cells = min(2 * int(np.ceil(2 * half)), 2000)  # two a pixel: transported events lie between the pixels
    image, _, _ = np.histogram2d(
        shown.y - vy * age_s,
        shown.x - vx * age_s,
        bins=cells,
        range=((y0, y1), (x0, x1)),
        weights=shown.p.astype(np.float64),
    )
    image = _blur(image)
    scale = max(float(np.quantile(np.abs(image), 0.98)), 1e-6)
    axes.imshow(
        image,
        cmap=_event_colours(),
        vmin=-scale,
        vmax=scale,
        extent=(x0, x1, y1, y0),
        interpolation="bilinear",
    )
    _draw_outline(axes, reading, linewidth=2.2)
    _draw_arrow(axes, reading)
    _frame(axes, f"motion taken out of {(end - start) / 1000:.2f} ms, and the outline found")


def _draw_estimate(axes: Axes, reading: CodeReading) -> None:
    scale = max(float(np.quantile(np.abs(reading.estimate), 0.9)), 1e-6)
    axes.imshow(reading.estimate, cmap="gray", vmin=-scale, vmax=scale, interpolation="nearest")
    _frame(axes, "modules, estimated")


def _draw_modules(signs: Axes, true: Axes, reading: CodeReading, truth: NDArray[np.int8] | None) -> None:
    """Signs of the estimate with the wrong ones coloured, beside what they should be."""
    from matplotlib.colors import ListedColormap

    colours = ListedColormap([INK, "white", FALSE_DARK, FALSE_LIGHT])
    estimated_dark, truly_dark = reading.estimate < 0, (reading.modules if truth is None else truth) < 0
    kind = np.where(estimated_dark, 0, 1)
    kind[estimated_dark & ~truly_dark] = 2
    kind[~estimated_dark & truly_dark] = 3
    signs.imshow(kind, cmap=colours, vmin=-0.5, vmax=3.5, interpolation="nearest")
    _frame(signs, f"their signs: {int((kind > 1).sum())} of {kind.size} wrong")
    _draw_legend(signs, ((FALSE_DARK, "dark, truly light"), (FALSE_LIGHT, "light, truly dark")))

    true.imshow(np.where(truly_dark, 0, 1), cmap=colours, vmin=-0.5, vmax=3.5, interpolation="nearest")
    _frame(true, "modules, as decoded" if truth is None else "modules, true")


def _draw_outline(axes: Axes, reading: CodeReading, *, linewidth: float) -> None:
    """Outer edge of the symbol; a dot at the corner where its rows and columns begin."""
    from matplotlib.patches import Polygon

    axes.add_patch(Polygon(reading.corners_px, closed=True, fill=False, edgecolor=FOUND, linewidth=linewidth))
    axes.plot(*reading.corners_px[0], "o", color=FOUND, markersize=3 * linewidth)


def _draw_arrow(axes: Axes, reading: CodeReading) -> None:
    """Direction of travel, in the lower left corner."""
    vx, vy = reading.motion_px_per_s / max(float(np.hypot(*reading.motion_px_per_s)), 1e-9)
    x, y, half = 0.085, 0.085, 0.05  # fractions of the square axes; y upwards
    axes.annotate(
        "",
        xy=(x + half * vx, y - half * vy),
        xytext=(x - half * vx, y + half * vy),
        xycoords="axes fraction",
        arrowprops={
            "arrowstyle": "-|>",
            "color": INK,
            "linewidth": 2,
            "mutation_scale": 16,
            "shrinkA": 0,
            "shrinkB": 0,
        },
    )


def _draw_legend(axes: Axes, entries: tuple[tuple[str, str], ...]) -> None:
    """Coloured squares with their meaning, under the axes."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=colour, marker="s", linestyle="", label=label) for colour, label in entries
    ]
    axes.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0, 0),
        ncols=len(handles),
        frameon=False,
        borderpad=0.4,
        borderaxespad=0,
        handletextpad=0.1,
        fontsize=9.5,
        labelcolor=INK,
    )


def _frame(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", size=11, color=INK, pad=5)
    axes.set(xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_color(GREY)


def _event_colours():
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("events", [OFF, "white", ON])


def _blur(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Binomial blur, three cells wide."""
    for axis in (0, 1):
        image = (np.roll(image, 1, axis) + 2 * image + np.roll(image, -1, axis)) / 4
    return image


def _module_px(reading: CodeReading) -> float:
    """Size of a module in the image: the root of its mean area [px]."""
    x, y = reading.corners_px.T
    area = abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())) / 2
    return max((area / (reading.rows * reading.columns)) ** 0.5, 1e-3)


def _travel_us(reading: CodeReading, modules: float) -> int:
    """Time in which the code moves so many modules [us]."""
    speed = max(float(np.hypot(*reading.motion_px_per_s)), 1.0)
    return max(1, round(modules * _module_px(reading) / speed * 1e6))
