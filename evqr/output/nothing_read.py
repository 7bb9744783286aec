"""The picture of a recording in which nothing was read: what came nearest, and what moved."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from evqr.output.drawing import (
    FOUND,
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
    show_compensated,
    show_last_events,
)
from evqr.output.span import Timeline, events_between, timeline_of
from evqr.results import ReadResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from typing_extensions import Unpack

    from evqr.recording import RecordingOptions

RAW_TRAVEL_PX, COMPENSATED_TRAVEL_PX = 2.0, 12.0
"""Travel shown of the events as they came, and with the motion taken out."""

STILL_US, LONGEST_US = 1_000, 200_000
"""Time shown where nothing moves, and at most [us]."""

TIMELINE = 1.1
"""Height of the events over time [inches]."""


def draw_nothing_read(source: Any, result: ReadResult, **opening: Unpack[RecordingOptions]) -> Figure:
    """Draw what there was where nothing was read.

    Parameters
    ----------
    source : path, EventArray, Recording or arrays
        What was read.
    result : ReadResult
        What came of it.
    **opening : as for `open_recording`
        For what is not open yet.

    Returns
    -------
    Figure
        Events as they came, and with the motion taken out, with the best candidates and how well they agree;
        events over time.
    """
    timeline = timeline_of(source, **opening)
    nearest = result.nearest
    if nearest is None:
        at_us, velocity, long_us = timeline.busiest_us, np.zeros(2), STILL_US
        short_us = STILL_US
    else:
        at_us, velocity = nearest.t_us, nearest.motion_px_per_s
        speed = max(float(np.hypot(*velocity)), 1.0)
        short_us, long_us = (
            max(1, min(round(travel / speed * 1e6), LONGEST_US))
            for travel in (RAW_TRAVEL_PX, COMPENSATED_TRAVEL_PX)
        )
    start_us = max(at_us - long_us // 2, timeline.start_us or 0)
    events = events_between(source, (start_us, start_us + long_us), **opening)

    inside = WIDTH - 2 * MARGIN
    side = (inside - GAP) / 2
    height = side * events.height / events.width
    title = f"nothing read: {result.reason}" if result.reason else "nothing read"
    page = Page(TITLE + height + LEGEND + TITLE + TIMELINE + LEGEND, title, _facts(result, velocity), size=11)
    bottom = LEGEND + TIMELINE + TITLE + LEGEND
    raw, compensated = (page.panel(MARGIN + i * (side + GAP), bottom, side, height) for i in range(2))
    short_from = max(at_us - short_us // 2, start_us)
    show_last_events(raw, events.between(short_from, short_from + short_us))
    frame(raw, f"events of {short_us / 1000:.2f} ms")
    legend(raw, ((ON, "brighter"), (OFF, "darker")))
    view = (-0.5, events.width - 0.5, -0.5, events.height - 0.5)
    show_compensated(compensated, events, velocity, at_us, view)
    if nearest is None:
        frame(compensated, f"events of {long_us / 1000:.2f} ms, added up: nothing moves")
    else:
        arrow(compensated, velocity)
        frame(compensated, f"motion taken out of {long_us / 1000:.2f} ms, and the best candidates")
        for axes in (raw, compensated):
            for candidate in nearest.candidates:
                outline(axes, candidate.corners_px, linewidth=1.4, dashed=True)
        for candidate in nearest.candidates:
            _label(compensated, candidate.corners_px, f"{candidate.symbol}? {candidate.score:.2f}")
        found = "taken for a code, with its agreement, 0 to 1"
        legend(compensated, [(FOUND, found if nearest.candidates else "nothing was taken for a code")])
    draw_timeline(page, timeline, at_us)
    return page.figure


def _facts(result: ReadResult, velocity: np.ndarray) -> tuple[str, ...]:
    seen = result.seen
    return (
        f"{seen.events:,} events in {seen.duration_us / 1000:.1f} ms",
        f"{float(np.hypot(*velocity)) / 1000:.2f} px/ms",
        f"windows {seen.windows}",
        f"searches {seen.searches}",
        f"codes not decoded {seen.codes_not_decoded}",
        f"computed in {result.compute_ms.get('total', 0.0):.0f} ms",
    )


_PALE = {"facecolor": "white", "alpha": 0.7, "linewidth": 0, "pad": 1}


def _label(axes: Axes, corners: np.ndarray, text: str) -> None:
    """Write beside an outline, inside the panel."""
    x, y = corners.min(axis=0)
    (x0, x1), (y1, y0) = sorted(axes.get_xlim()), sorted(axes.get_ylim(), reverse=True)
    place = float(np.clip(x, x0, x1)), float(np.clip(y, y0 + 0.06 * (y1 - y0), y1))
    axes.text(*place, text, size=9, color=FOUND, va="bottom", clip_on=True, parse_math=False, bbox=_PALE)


def draw_timeline(page: Page, timeline: Timeline, at_us: int) -> None:
    """Draw how many events there are over time, at the foot of a page, with a line at the time shown."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    room = 0.3  # for the numbers at its left [inches]
    axes = page.panel(MARGIN + room, LEGEND, WIDTH - 2 * MARGIN - room, TIMELINE)
    rates = timeline.per_ms
    start_ms, bin_ms = (timeline.start_us or 0) / 1000.0, timeline.bin_us / 1000.0
    times = start_ms + bin_ms * np.arange(len(rates) + 1)
    axes.stairs(rates, times, fill=True, color="#868e96")
    axes.set_xlim(times[0], times[-1])
    axes.set_ylim(0.0, max(float(rates.max()) * 1.08, 1.0))
    axes.axvline(at_us / 1000.0, color=FOUND, linewidth=1.5)
    frame(axes, "events a millisecond, over the time of the recording [ms]", ticks=True)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}"))
    axes.yaxis.set_major_locator(MaxNLocator(3, integer=True))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / 1000:,g}k" if value else "0"))
    axes.tick_params(labelcolor=INK)
