"""Readings as records for JSON lines, and as text for people."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import asdict
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evqr.results import CodeReading, ReadResult, ReadStatus, WindowReading

if TYPE_CHECKING:
    from evqr.recording import RecordingInfo


def json_line(record: Mapping[str, Any]) -> str:
    """Write one JSON object on one line, in ASCII, so that any terminal and any pipe carries it."""
    return json.dumps(record, default=_plain, allow_nan=False)


def reading_record(reading: CodeReading) -> dict[str, Any]:
    """Return keys and order of a reading in `evqr read --json`."""
    return {
        "status": ReadStatus.READ.value,
        "text": reading.text,
        "bytes_base64": base64.b64encode(reading.data).decode("ascii"),
        "symbology": reading.symbology,
        "version": reading.version,
        "ec_level": reading.ec_level,
        "mask": reading.mask,
        "t_first_us": reading.t_first_us,
        "t_last_us": reading.t_last_us,
        "t_read_us": reading.t_read_us,
        "windows": reading.windows,
        "corners_px": _rounded(reading.corners_px, 3),
        "motion_px_per_s": _rounded(reading.motion_px_per_s, 2),
        "confidence": round(float(reading.confidence), 4),
        "errors_corrected": reading.errors_corrected,
        "compute_ms": _milliseconds(reading.compute_ms),
    }


def result_records(result: ReadResult) -> list[dict[str, Any]]:
    """Return one record a reading; for a result without readings, one that says why."""
    if result.readings:
        return [reading_record(reading) for reading in result.readings]
    record: dict[str, Any] = {"status": result.status.value, "reason": result.reason}
    if result.status is not ReadStatus.ERROR:
        record |= {"seen": dict(result.seen), "compute_ms": _milliseconds(result.compute_ms)}
    return [record]


def window_record(window: WindowReading) -> dict[str, Any]:
    """Return keys and order of a window in `evqr read --each-window --json`."""
    return {
        "status": window.status.value,
        "reason": window.reason,
        "window": window.window,
        "t_start_us": window.t_start_us,
        "t_end_us": window.t_end_us,
        "n_events": window.n_events,
        "text": window.text,
        "version": window.version,
        "modules": None if window.modules is None else module_rows(window.modules),
        "motion_px_per_s": None if window.motion_px_per_s is None else _rounded(window.motion_px_per_s, 2),
        "affine": None if window.affine is None else _rounded(np.ravel(window.affine), 8),
        "stage_one_iterations": window.stage_one_iterations,
        "stage_two_iterations": window.stage_two_iterations,
        "compute_ms": _milliseconds(window.compute_ms),
    }


def module_rows(modules: NDArray[np.floating] | NDArray[np.integer]) -> list[str]:
    """Write a grid, negative dark, as rows of "0" and "1", 1 dark."""
    return ["".join("1" if dark else "0" for dark in row) for row in modules < 0]


def reading_text(reading: CodeReading) -> str:
    """Describe a reading in a few lines; the first is the text of the code and nothing else."""
    vx, vy = reading.motion_px_per_s
    corners = "  ".join(f"({x:.1f}, {y:.1f})" for x, y in reading.corners_px)
    return "\n".join(
        (
            printable(reading.text),
            f"  symbol      {reading.symbology} {reading.version}-{reading.ec_level}, mask {reading.mask}, "
            f"codewords corrected: {reading.errors_corrected}",
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
            f"sensor      {info.width}x{info.height}",
            f"events      {info.events:,}: {info.on:,} brighter, {info.off:,} darker",
            f"duration    {info.duration_us / 1000:.3f} ms: from {info.t_first_us} to {info.t_last_us} us",
            f"time unit   {info.time_unit}: {info.time_unit_reason}",
            f"rate        {info.mean_rate:,.0f} events/s, {info.peak_rate:,.0f} in the busiest millisecond",
            *(f"suspicious  {printable(line)}" for line in info.suspicious or ("nothing",)),
        )
    )


def printable(text: str) -> str:
    """Escape control characters: what a code says must not drive the terminal that shows it."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def _rounded(values: NDArray[np.floating], digits: int) -> list[Any]:
    return np.round(np.asarray(values, np.float64), digits).tolist()


def _milliseconds(stages: Mapping[str, float]) -> dict[str, float]:
    return {stage: round(float(ms), 3) for stage, ms in stages.items()}


def _milliseconds_text(stages: Mapping[str, float]) -> str:
    parts = ", ".join(f"{stage} {ms:.1f}" for stage, ms in stages.items() if stage != "total")
    return f"{stages.get('total', sum(stages.values())):.1f} ms" + (f" ({parts})" if parts else "")


def _plain(value: Any) -> Any:
    """Convert what ``json`` does not know: NumPy scalars and arrays, enums."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"cannot write {type(value).__name__} as JSON")
