"""The picture of a reading: events, events with the motion taken out, estimated and true modules."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray
from evqr.output.drawing import (
    FALSE_DARK,
    FALSE_LIGHT,
    GAP,
    INK,
    LEGEND,
    MARGIN,
    OFF,
    ON,
    TITLE,
    WIDTH,
    Page,
    arrow,
    frame,
    legend,
    outline,
    require_drawable,
    save_figure,
    show_compensated,
    show_last_events,
)
from evqr.output.nothing_read import draw_nothing_read
from evqr.output.records import payload_text
from evqr.output.span import events_between
from evqr.results import CodeReading, ReadResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from typing_extensions import Unpack

    from evqr.recording import Recording, RecordingOptions

# Travel shown, in modules: little for the events as they came, where edges smear; more where the motion is
# taken out and they add up.
RAW_TRAVEL = 0.5
COMPENSATED_TRAVEL = 3.0


def span_us(reading: CodeReading, travel: float = COMPENSATED_TRAVEL) -> tuple[int, int]:
    """Return event times ``[start, end)`` [us] in which the code moves by ``travel`` modules.

    They end at ``t_read_us``, or later where the code was first seen too shortly before.
    """
    length = _travel_us(reading, travel)
    start = max(reading.t_first_us, reading.t_read_us - length)
    return start, start + length


def picture_events(recording: Recording, reading: CodeReading) -> EventArray:
    """Return the events of a recording that a picture of ``reading`` shows, in bounded memory."""
    return events_between(recording, span_us(reading))


def save_picture(
    path: str | PathLike[str],
    source: Any,
    reading: CodeReading | ReadResult,
    *,
    truth: NDArray[np.int8] | None = None,
    **opening: Unpack[RecordingOptions],
) -> None:
    """Draw a reading (see `draw_reading`) to a PNG, SVG or PDF file, by its ending.

    Raises
    ------
    MissingExtra
        Matplotlib is not installed.
    UsageError
        The ending names no picture format, or the file cannot be written.
    """
    draw_reading(source, reading, truth=truth, to=path, **opening)


def draw_reading(
    source: Any,
    reading: CodeReading | ReadResult,
    *,
    truth: NDArray[np.int8] | None = None,
    to: str | PathLike[str] | None = None,
    **opening: Unpack[RecordingOptions],
) -> Figure:
    """Draw how a code was read.

    Parameters
    ----------
    source : path, EventArray, Recording or arrays
        What `open_recording` takes, or a recording that is open already.  Of an EventArray, only what holds
        `span_us` of the reading is needed.
    reading : CodeReading or ReadResult
        What to show; of a result its first reading, or, where nothing was read, what came nearest.
    truth : (V, U) int8, optional
        True modules, -1 dark, +1 light; None: the modules as decoded.
    to : path, optional
        File to write the picture to, .png, .svg or .pdf.
    **opening : as for `open_recording`
        Such as ``sensor`` and ``time_unit``, for what is not open yet.

    Returns
    -------
    Figure
        Above: events as they came, and with the motion taken out, with the outline found.  Below: the
        estimate, its signs with the wrong modules in magenta (dark instead of light) and green (light instead
        of dark), the true modules.  Where nothing was read: events as they came, and with the motion taken
        out, with the best candidates; events over time.

    Raises
    ------
    MissingExtra
        Matplotlib is not installed, or what the source needs.
    RecordingError
        The source cannot be read.
    UsageError
        The file cannot be written, or its ending names no picture format.
    ValueError
        ``truth`` has another shape than the estimate.
    TypeError
        The source or the reading is none.
    """
    if not isinstance(reading, (CodeReading, ReadResult)):
        turned = isinstance(source, (CodeReading, ReadResult))
        raise TypeError(
            f"reading must be a CodeReading or a ReadResult, got {type(reading).__name__}"
            + (", and the source one: the source comes first" if turned else "")
        )
    if to is not None:
        require_drawable(to)  # before anything is computed
    if isinstance(reading, ReadResult) and not reading.readings:
        figure = draw_nothing_read(source, reading, **opening)
    else:
        shown = reading.readings[0] if isinstance(reading, ReadResult) else reading
        figure = _draw_code(source, shown, truth, **opening)
    if to is not None:
        save_figure(to, figure)
    return figure


def _draw_code(
    source: Any, reading: CodeReading, truth: NDArray[np.int8] | None, **opening: Unpack[RecordingOptions]
) -> Figure:
    """Draw how a code was read."""
    if truth is not None and truth.shape != reading.estimate.shape:
        raise ValueError(f"truth must have shape {reading.estimate.shape}, got {truth.shape}")
    events = events_between(source, span_us(reading), **opening)
    inside = WIDTH - 2 * MARGIN
    aspect = events.width / events.height
    above = (inside - GAP) / (aspect + 1)  # the view, and a square beside it
    below = (inside - 2 * GAP) / 3
    page = Page(TITLE + above + LEGEND + TITLE + below + LEGEND, payload_text(reading), _facts(reading))
    top = LEGEND + below + TITLE + LEGEND
    _draw_events(page.panel(MARGIN, top, aspect * above, above), events, reading)
    _draw_compensated(page.panel(MARGIN + aspect * above + GAP, top, above, above), events, reading)
    estimate, signs, true = (page.panel(MARGIN + i * (below + GAP), LEGEND, below, below) for i in range(3))
    _draw_estimate(estimate, reading)
    _draw_modules(signs, true, reading, truth)
    return page.figure


def _facts(reading: CodeReading) -> tuple[str, ...]:
    speed = float(np.hypot(*reading.motion_px_per_s))
    return (
        reading.symbol,
        f"{speed / 1000:.2f} px/ms = {speed / _module_px(reading):.0f} modules/s",
        f"chance 1e{reading.log10_chance:.0f}",
        f"print {reading.grade.letter}, windows {reading.windows}",
        f"error correction unused {reading.unused_correction:.0%}",
        f"computed in {reading.compute_ms.get('total', 0.0):.1f} ms",
    )


def _draw_events(axes: Axes, events: EventArray, reading: CodeReading) -> None:
    """Last event of each pixel, about when the code was read."""
    start, end = span_us(reading, RAW_TRAVEL)
    show_last_events(axes, events.between(start, end))
    outline(axes, reading.corners_px, linewidth=1.2)
    frame(axes, f"events of {(end - start) / 1000:.2f} ms")
    legend(axes, ((ON, "brighter"), (OFF, "darker")))


def _draw_compensated(axes: Axes, events: EventArray, reading: CodeReading) -> None:
    """Events moved to where they would be at ``t_read_us``, added up, around the code."""
    start, end = span_us(reading)
    low, high = reading.corners_px.min(axis=0), reading.corners_px.max(axis=0)
    half = float((high - low).max()) / 2 + 4 * _module_px(reading)  # the quiet zone is shown too
    (x0, y0), (x1, y1) = (low + high) / 2 - half, (low + high) / 2 + half
    velocity = reading.motion_px_per_s
    show_compensated(axes, events.between(start, end), velocity, reading.t_read_us, (x0, x1, y0, y1))
    outline(axes, reading.corners_px, linewidth=2.2)
    arrow(axes, velocity)
    frame(axes, f"motion taken out of {(end - start) / 1000:.2f} ms, and the outline found")


def _draw_estimate(axes: Axes, reading: CodeReading) -> None:
    scale = max(float(np.quantile(np.abs(reading.estimate), 0.9)), 1e-6)
    axes.imshow(reading.estimate, cmap="gray", vmin=-scale, vmax=scale, interpolation="nearest")
    frame(axes, "modules, estimated")


def _draw_modules(signs: Axes, true: Axes, reading: CodeReading, truth: NDArray[np.int8] | None) -> None:
    """Signs of the estimate with the wrong ones coloured, beside what they should be."""
    from matplotlib.colors import ListedColormap

    colours = ListedColormap([INK, "white", FALSE_DARK, FALSE_LIGHT])
    estimated_dark, truly_dark = reading.estimate < 0, (reading.modules if truth is None else truth) < 0
    kind = np.where(estimated_dark, 0, 1)
    kind[estimated_dark & ~truly_dark] = 2
    kind[~estimated_dark & truly_dark] = 3
    signs.imshow(kind, cmap=colours, vmin=-0.5, vmax=3.5, interpolation="nearest")
    known, word = ("wrong", "truly") if truth is not None else ("other than decoded", "decoded as")
    frame(signs, f"their signs: {int((kind > 1).sum())} of {kind.size} {known}")
    legend(signs, ((FALSE_DARK, f"dark, {word} light"), (FALSE_LIGHT, f"light, {word} dark")))

    true.imshow(np.where(truly_dark, 0, 1), cmap=colours, vmin=-0.5, vmax=3.5, interpolation="nearest")
    frame(true, "modules, as decoded" if truth is None else "modules, true")


def _module_px(reading: CodeReading) -> float:
    """Size of a module in the image: the root of its mean area [px]."""
    x, y = reading.corners_px.T
    area = abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())) / 2
    return max((area / (reading.rows * reading.columns)) ** 0.5, 1e-3)


def _travel_us(reading: CodeReading, modules: float) -> int:
    """Time in which the code moves so many modules [us]."""
    speed = max(float(np.hypot(*reading.motion_px_per_s)), 1.0)
    return max(1, round(modules * _module_px(reading) / speed * 1e6))
