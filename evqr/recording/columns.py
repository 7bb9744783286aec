"""The one place where stored columns are named, checked and brought to the form of `EventArray`."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray

from ..errors import RecordingError
from .source import RawColumns, TimeUnit
from .time_unit import PER_SECOND

ALIASES: dict[str, tuple[str, ...]] = {
    "t": ("t", "ts", "time", "times", "timestamp", "timestamps"),
    "x": ("x", "xs", "x_coordinate", "x_coordinates"),
    "y": ("y", "ys", "y_coordinate", "y_coordinates"),
    "p": ("p", "ps", "pol", "pols", "polarity", "polarities"),
}

MAX_SENSOR_SIDE = 1 << 16  # coordinates are uint16


def find_columns(names: Iterable[str]) -> dict[str, str]:
    """Map those of "t", "x", "y", "p" that are there to the names they go by."""
    by_lower = {name.lower(): name for name in names}
    found = {}
    for column, aliases in ALIASES.items():
        match = next((by_lower[alias] for alias in aliases if alias in by_lower), None)
        if match is not None:
            found[column] = match
    return found


def require_columns(names: Iterable[str], name: str, where: str) -> dict[str, str]:
    """`find_columns`, with an error when one of the four is missing."""
    names = list(names)
    found = find_columns(names)
    missing = [column for column in ALIASES if column not in found]
    if missing:
        has = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
        raise RecordingError(
            f"{name}: {where} lacks column {', '.join(missing)} (has {has or 'nothing'});"
            " an event recording needs t, x, y and p"
        )
    return found


def require_equal_lengths(lengths: dict[str, int], name: str) -> int:
    """Length of all columns, with an error when they differ."""
    if len(set(lengths.values())) != 1:
        told = ", ".join(f"{column} has {length:,}" for column, length in lengths.items())
        raise RecordingError(f"{name}: columns of different length: {told}; export the recording again")
    return next(iter(lengths.values()))


def check_sensor(sensor: tuple[int, int] | None, name: str) -> tuple[int, int]:
    """Sensor size as two ints, with an error when it is unknown or impossible."""
    if sensor is None:
        raise RecordingError(f"{name}: sensor size unknown: pass --sensor WxH")
    width, height = int(sensor[0]), int(sensor[1])
    if not (0 < width <= MAX_SENSOR_SIDE and 0 < height <= MAX_SENSOR_SIDE):
        raise RecordingError(
            f"{name}: sensor size {width}x{height} is impossible; pass the right one with --sensor WxH"
        )
    return width, height


def check_times(t: NDArray, name: str, first: int = 0) -> None:
    """Refuse stored times that are no finite numbers, or negative."""
    _require_kind(t, "t", "iuf", name)
    if t.dtype.kind == "f":
        _refuse(~np.isfinite(t), t, "time", "is not a finite number", name, first)
    if t.dtype.kind != "u":
        _refuse(t < 0, t, "time", "is negative", name, first)


class ColumnChecker:
    """Checks raw columns and brings them to int64 us, uint16, uint16, int8 -1/+1.

    It keeps count of the events seen (messages give the event's number in the file) and of the polarity
    convention: {0, 1} and {-1, 1} both are fine, a mixture is not.
    """

    def __init__(
        self, name: str, sensor: tuple[int, int], unit: TimeUnit, t_offset_us: int, *, seen: int = 0
    ) -> None:
        self.name = name
        self.width, self.height = sensor
        self.unit: TimeUnit = unit
        self.t_offset_us = t_offset_us
        self.seen = seen
        self._dark_value: int | None = None

    def __call__(self, raw: RawColumns) -> EventArray:
        """Check and convert; raises `RecordingError` at the first thing that is wrong."""
        require_equal_lengths({c: len(v) for c, v in raw._asdict().items()}, self.name)
        events = EventArray(
            t=self._times(raw.t),
            x=self._coordinates(raw.x, "x", self.width),
            y=self._coordinates(raw.y, "y", self.height),
            p=self._polarities(raw.p),
            width=self.width,
            height=self.height,
        )
        self.seen += len(events)
        return events

    def _times(self, t: NDArray) -> NDArray[np.int64]:
        check_times(t, self.name, self.seen)
        per_second = PER_SECOND[self.unit]
        limit_us = np.iinfo(np.int64).max - max(self.t_offset_us, 0)
        too_late = t > limit_us // 1_000_000 * per_second
        _refuse(too_late, t, "time", f"overflows 64-bit microseconds if in {self.unit}", self.name, self.seen)
        if t.dtype.kind == "f":
            # Rounded: decimal seconds have binary tails (0.6367649989999999), and truncation would lose 1 us.
            t_us = np.rint(t.astype(np.float64) * (1_000_000 / per_second)).astype(np.int64)
        elif self.unit == "ns":
            t_ns = t.astype(np.uint64)  # stamps of 64 bits without sign fit once they are divided
            t_us = (t_ns // 1000 + (t_ns % 1000 >= 500)).astype(np.int64)
        else:
            t_us = t.astype(np.int64, copy=False)
            if per_second != 1_000_000:
                t_us = t_us * (1_000_000 // per_second)
        if self.t_offset_us:
            t_us = t_us + self.t_offset_us
            _refuse(
                t_us < 0,
                t_us,
                "time",
                f"is negative with the file's offset {self.t_offset_us}",
                self.name,
                self.seen,
            )
        return t_us

    def _coordinates(self, values: NDArray, column: str, size: int) -> NDArray[np.uint16]:
        _require_kind(values, column, "iuf", self.name)
        if values.dtype.kind == "f":
            _refuse(
                ~(values == np.rint(values)),
                values,
                column,
                "is no whole number of pixels",
                self.name,
                self.seen,
            )
        outside = values >= size
        if values.dtype.kind != "u":
            outside |= values < 0
        problem = (
            f"is outside the {self.width}x{self.height} sensor; if that is not its size, pass --sensor WxH"
        )
        _refuse(outside, values, column, problem, self.name, self.seen)
        return values.astype(np.uint16, copy=False)

    def _polarities(self, p: NDArray) -> NDArray[np.int8]:
        _require_kind(p, "p", "biuf", self.name)
        bright = p == 1
        dark = ~bright
        if np.any(dark):
            if self._dark_value is None:
                self._dark_value = -1 if p[np.argmax(dark)] == -1 else 0
            wrong = dark & (p != self._dark_value)
            _refuse(wrong, p, "polarity", "fits neither {0, 1} nor {-1, 1}", self.name, self.seen)
        return np.where(bright, np.int8(1), np.int8(-1))


def _require_kind(values: NDArray, column: str, kinds: str, name: str) -> None:
    if values.ndim != 1 or values.dtype.kind not in kinds:
        raise RecordingError(
            f"{name}: column {column} must be one-dimensional numbers, got {values.dtype} of shape"
            f" {values.shape}; export the recording again"
        )


def _refuse(bad: NDArray[np.bool_], values: NDArray, what: str, problem: str, name: str, first: int) -> None:
    """Raise for the first event that is bad, naming its number and value."""
    if np.any(bad):
        at = int(np.argmax(bad))
        advice = "" if "pass --" in problem else "; repair or export the recording again"
        raise RecordingError(f"{name}: {what} {values[at]} of event {first + at:,} {problem}{advice}")
