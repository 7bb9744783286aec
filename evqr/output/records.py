"""Readings as records for JSON lines, and as text for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from evqr.results import CodeReading, ReadResult, ReadStatus, WindowReading
from evqr.seen import Nearest
from evqr.symbol.gs1 import SEPARATOR
from evqr.symbol.messages import Message
from evqr.symbol.payload import ContentType, Payload
from evqr.values import plain

if TYPE_CHECKING:
    from evqr.recording import RecordingInfo

GS = "<GS>"
"""How the separator of GS1 messages is shown."""


def result_records(result: ReadResult) -> list[dict[str, Any]]:
    """Give what `evqr read --json` prints of one recording.

    Parameters
    ----------
    result : ReadResult
        Of a recording.

    Returns
    -------
    records : list of dict
        One a reading, which tells what was odd about the recording too, and the message that it is a part of;
        for a result without readings, one that says why.
    """
    if result.readings:
        messages = result.messages
        return [_reading_record(reading, messages, result.warnings) for reading in result.readings]
    record = result.to_dict()
    keys = ["status", "reason", "reason_code"]
    if result.status is not ReadStatus.ERROR:
        keys += ["seen", "compute_ms", "warnings", "nearest"]
    return [{key: record[key] for key in keys}]


def _reading_record(
    reading: CodeReading, messages: Sequence[Message], warnings: Sequence[str]
) -> dict[str, Any]:
    record = reading.to_dict()
    mine = next((each for each in messages if any(part.same_content(reading) for part in each.parts)), None)
    return {**record, "warnings": [*record["warnings"], *warnings], "message": plain(mine)}


def reading_text(reading: CodeReading) -> str:
    """Describe a reading in a few lines; the first is the text of the code and nothing else."""
    vx, vy = reading.motion_px_per_s
    mask = "" if reading.mask is None else f", mask {reading.mask}"
    corners = "  ".join(f"({x:.1f}, {y:.1f})" for x, y in reading.corners_px)
    return "\n".join(
        (
            payload_text(reading),
            f"  symbol      {reading.symbol}{mask}, codewords corrected: {reading.errors_corrected}",
            f"  content     {_content(reading)}",
            *(f"  element     {printable(str(element))}" for element in reading.gs1),
            *(f"  message     {part}" for part in [reading.structured_append] if part),
            f"  confidence  {reading.confidence:.3f} (chance 1e{reading.log10_chance:.0f}), "
            f"error correction unused: {reading.unused_correction:.0%}",
            f"  print       {reading.grade}",
            f"  time        seen {reading.t_first_us} to {reading.t_last_us} us, "
            f"read at {reading.t_read_us} us, windows used: {reading.windows}",
            f"  motion      {float(np.hypot(vx, vy)):.0f} px/s ({vx:+.0f}, {vy:+.0f})",
            f"  corners     {corners} px",
            f"  computed    {_milliseconds_text(reading.compute_ms)}",
        )
    )


def payload_text(payload: Payload) -> str:
    """Return the text of a code for a terminal, on one line: ``<GS>`` is a separator of a GS1 message."""
    if payload.content_type is ContentType.GS1:
        return GS.join(map(printable, payload.text.split(SEPARATOR)))
    return printable(payload.text)


def message_record(message: Message, names: Sequence[str]) -> dict[str, Any]:
    """Give the record of a message, with the names of the recordings that its parts are from, in order."""
    return {"recording": None, "status": "message", "recordings": list(names), **message.to_dict()}


def message_text(message: Message) -> str:
    """Describe a message of several codes in one line."""
    return printable(str(message))


def result_text(result: ReadResult) -> str:
    """Describe the readings of one recording, or why there are none."""
    if result.readings:
        return "\n".join((*map(reading_text, result.readings), *map(message_text, result.messages)))
    if result.status is ReadStatus.ERROR:
        return f"error: {result.reason}"
    seen = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in result.seen.items())
    lines = [f"nothing read: {result.reason}", *([f"  seen     {seen}"] if seen else [])]
    return "\n".join((*lines, *_nearest_lines(result.nearest)))


def _nearest_lines(nearest: Nearest | None) -> Iterator[str]:
    if nearest is None:
        return
    vx, vy = nearest.motion_px_per_s
    yield f"  motion   {float(np.hypot(vx, vy)):.0f} px/s ({vx:+.0f}, {vy:+.0f}) at {nearest.t_us} us"
    for candidate in nearest.candidates:
        x, y = candidate.corners_px.mean(axis=0)
        yield f"  nearest  {candidate.symbol} at ({x:.0f}, {y:.0f}) px, agreement {candidate.score:.2f}"


def window_text(window: WindowReading) -> str:
    """Describe a window in one line."""
    codes = (payload_text(code.payload) if code.payload else code.reason for code in window.codes)
    outcome = ", ".join(codes) or window.reason
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


def _content(reading: CodeReading) -> str:
    source = reading.charset_source.value
    if reading.eci:
        source += f" {', '.join(map(str, reading.eci))}"
    unnamed = "bytes" if reading.content_type is ContentType.UNKNOWN_ECI else "several character sets"
    charset = f"{reading.charset or unnamed} ({source})"
    return f"{reading.content_type}, {reading.symbology_identifier or 'no identifier'}, {charset}"


def _milliseconds_text(stages: Mapping[str, float]) -> str:
    parts = ", ".join(f"{stage} {ms:.1f}" for stage, ms in stages.items() if stage != "total")
    return f"{stages.get('total', sum(stages.values())):.1f} ms" + (f" ({parts})" if parts else "")
