"""The picture of a recording: what the camera saw, whether or not a code is in it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from evqr.output.drawing import (
    GAP,
    LEGEND,
    MARGIN,
    OFF,
    ON,
    TITLE,
    WIDTH,
    Page,
    frame,
    legend,
    show_last_events,
)
from evqr.output.nothing_read import TIMELINE, draw_timeline
from evqr.output.records import printable
from evqr.output.span import Timeline, events_between
from evqr.recording import Recording, RecordingInfo, open_recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from typing_extensions import Unpack

    from evqr.recording import RecordingOptions

BUSIEST_EVENTS = 20_000
"""About so many events are shown of the busiest time."""


def draw_recording(source: Any, info: RecordingInfo, **opening: Unpack[RecordingOptions]) -> Figure:
    """Draw what a camera saw.

    Parameters
    ----------
    source : path, Recording or arrays
        What was recorded.
    info : RecordingInfo
        As `summarise` gives it.
    **opening : as for `open_recording`
        For what is not open yet.

    Returns
    -------
    Figure
        Events of the busiest time, how many each pixel gave, events over time.
    """
    if not isinstance(source, Recording):
        with open_recording(source, **opening) as recording:
            return draw_recording(recording, info)
    timeline, per_pixel = Timeline(), np.zeros((source.height, source.width), np.int64)
    for chunk in source.chunks():
        timeline.add(chunk)
        np.add.at(per_pixel, (chunk.y, chunk.x), 1)
    peak = max(float(timeline.per_ms.max()), 1e-3)
    length = max(1, min(round(BUSIEST_EVENTS / peak * 1000.0), info.duration_us + 1))
    start = max(timeline.busiest_us - length // 2, info.t_first_us)
    events = events_between(source, (start, start + length))

    inside = WIDTH - 2 * MARGIN
    side = (inside - GAP) / 2
    height = side * source.height / source.width
    facts = (
        printable(info.format),
        f"{info.width}x{info.height}",
        f"{info.events:,} events in {info.duration_us / 1000:.1f} ms",
        f"{info.mean_rate:,.0f} events/s",
        f"{info.on / max(info.events, 1):.0%} brighter",
    )
    page = Page(TITLE + height + LEGEND + TITLE + TIMELINE + LEGEND, printable(info.path or "events"), facts)
    bottom = LEGEND + TIMELINE + TITLE + LEGEND
    raw, counts = (page.panel(MARGIN + i * (side + GAP), bottom, side, height) for i in range(2))
    show_last_events(raw, events)
    frame(raw, f"events of the busiest {length / 1000:.2f} ms")
    legend(raw, ((ON, "brighter"), (OFF, "darker")))
    counts.imshow(np.log1p(per_pixel), cmap="gray_r", interpolation="nearest")
    frame(counts, f"events a pixel, by their logarithm: at most {int(per_pixel.max()):,}")
    draw_timeline(page, timeline, start + length // 2)
    return page.figure
