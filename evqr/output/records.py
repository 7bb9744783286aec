"""Readings as records for JSON lines, and as text for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from evqr.results import CodeReading, ReadResult, ReadStatus, WindowReading, symbol_name

if TYPE_CHECKING:
    from evqr.recording import RecordingInfo


def result_records(result: ReadResult) -> list[dict[str, Any]]:
    """Give what `evqr read --json` prints of one recording.

    Parameters
    ----------
    result : ReadResult
        Of a recording.

    Returns
    -------
    records : list of dict
        One a reading, which tells what was odd about the recording too; for a result without readings, one
        that says why.
    """
    if result.readings:
        records = [reading.to_dict() for reading in result.readings]
        return [{**record, "warnings": [*record["warnings"], *result.warnings]} for record in records]
    record = result.to_dict()
    keys = ["status", "reason", "reason_code"]
    if result.status is not ReadStatus.ERROR:
        keys += ["seen", "compute_ms", "warnings"]
    return [{key: record[key] for key in keys}]


def reading_text(reading: CodeReading) -> str:
    """Describe a reading in a few lines; the first is the text of the code and nothing else."""
    vx, vy = reading.motion_px_per_s
    corners = "  ".join(f"({x:.1f}, {y:.1f})" for x, y in reading.corners_px)
    return "\n".join(
        (
            printable(reading.text),
            f"  symbol      {_symbol(reading)}, codewords corrected: {reading.errors_corrected}",
            f"  confidence  {reading.confidence:.3f}",
            f"  time        seen {reading.t_first_us} to {reading.t_last_us} us, "
            f"read at {reading.t_read_us} us, windows used: {reading.windows}",
            f"  motion      {float(np.hypot(vx, vy)):.0f} px/s ({vx:+.0f}, {vy:+.0f})",
            f"  corners     {corners} px",
            f"  computed    {_milliseconds_text(reading.compute_ms)}",
        )
    )


def result_text(result: ReadResult) -> str:
    """Describe the readings of one recording, or why there are none."""
    if result.readings:
        return "\n".join(reading_text(reading) for reading in result.readings)
    if result.status is ReadStatus.ERROR:
        return f"error: {result.reason}"
    seen = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in result.seen.items())
    return f"nothing read: {result.reason}" + (f"\n  seen     {seen}" if seen else "")


def window_text(window: WindowReading) -> str:
    """Describe a window in one line."""
    outcome = printable(window.text) if window.text is not None else window.reason
    total = window.compute_ms.get("total", 0.0)
    return (
        f"{window.window:5d}  {window.t_start_us}..{window.t_end_us} us  {window.n_events:7d} events  "
        f"{total:6.1f} ms  {window.status.value:7s}  {outcome}"
    )


def info_record(info: RecordingInfo) -> dict[str, Any]:
    """Return what `evqr info --json` tells."""
    return {**asdict(info), "duration_us": info.duration_us}


def info_text(info: RecordingInfo) -> str:
    """Describe a recording in a few lines."""
    return "\n".join(
        (
            f"format      {printable(info.format)}",
            *(f"streams     {printable(', '.join(info.streams))}" for _ in info.streams[1:2]),
            f"sensor      {info.width}x{info.height}",
            f"events      {info.events:,}: {info.on:,} brighter, {info.off:,} darker",
            f"duration    {info.duration_us / 1000:.3f} ms: from {info.t_first_us} to {info.t_last_us} us",
            f"time unit   {info.time_unit}: {info.time_unit_reason}",
            f"rate        {info.mean_rate:,.0f} events/s, {info.peak_rate:,.0f} in the busiest millisecond",
            *(f"note        {printable(line)}" for line in info.notes),
            *(f"suspicious  {printable(line)}" for line in info.suspicious or ("nothing",)),
        )
    )


def streams_text(streams: Sequence[str]) -> str:
    """Name the event streams of a recording that holds several."""
    return "\n".join((*(f"stream      {printable(name)}" for name in streams), "tell of one: --stream NAME"))


def printable(text: str) -> str:
    """Escape control characters: what a code says must not drive the terminal that shows it."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def _symbol(reading: CodeReading) -> str:
    name = f"{reading.symbology} {symbol_name(reading.version, reading.ec_level)}"
    return name if reading.mask is None else f"{name}, mask {reading.mask}"


def _milliseconds_text(stages: Mapping[str, float]) -> str:
    parts = ", ".join(f"{stage} {ms:.1f}" for stage, ms in stages.items() if stage != "total")
    return f"{stages.get('total', sum(stages.values())):.1f} ms" + (f" ({parts})" if parts else "")
