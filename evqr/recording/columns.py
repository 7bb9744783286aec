"""The one place where stored columns are named, checked and brought to the form of `EventArray`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray

from ..errors import RecordingError, UsageError
from .declared import PER_SECOND, DeclaredSensor, TimeUnit, Unclear, split_unit
from .faults import Faults
from .source import RawColumns

ALIASES: dict[str, tuple[str, ...]] = {
    "t": (
        "t",
        "ts",
        "time",
        "times",
        "timestamp",
        "timestamps",
        "time_stamp",
        "time_stamps",
        "stamp",
        "stamps",
    ),
    "x": ("x", "xs", "x_coordinate", "x_coordinates", "x_pos", "x_position", "col", "column"),
    "y": ("y", "ys", "y_coordinate", "y_coordinates", "y_pos", "y_position", "row"),
    "p": ("p", "ps", "pol", "pols", "polarity", "polarities", "on", "is_on", "sign"),
}
_PREFIX = re.compile(r"(?:events?|ev)_")

Columns = tuple[str, ...]
"""What the columns of a table are, in their order: each of "t", "x", "y", "p" once, "-" what is not read."""

DEFAULT_ORDER: Columns = ("t", "x", "y", "p")

# All orders but those that are mirrored: nothing but its name tells x from y.
ORDERS: tuple[Columns, ...] = tuple(o for o in permutations(DEFAULT_ORDER) if o.index("x") < o.index("y"))

FIT = 0.99  # share of a sample that must be possible as what it is taken for
MAX_FALLS = 0.25  # share of steps back in a column of times; of one that is no time it is about a half

MAX_SENSOR_SIDE = 1 << 16  # coordinates are uint16


def find_columns(names: Iterable[str]) -> dict[str, str]:
    """Map those of "t", "x", "y", "p" that are there to the names they go by."""
    by_base: dict[str, str] = {}
    for name in names:
        base, _ = split_unit(name)
        by_base.setdefault(base, name)
        by_base.setdefault(_PREFIX.sub("", base, count=1), name)
    found = {}
    for column, aliases in ALIASES.items():
        match = next((by_base[alias] for alias in aliases if alias in by_base), None)
        if match is not None:
            found[column] = match
    return found


def unit_in_name(name: str) -> TimeUnit | None:
    """Return the unit that the name of a column of times tells, as in "t [us]"."""
    return split_unit(name)[1]


def parse_columns(columns: str | Sequence[str]) -> Columns:
    """Read what a user says the columns are, such as "x,y,p,t" or "-,t,x,y,p"; raises `UsageError`."""
    words = re.split(r"[\s,;]+", columns.strip()) if isinstance(columns, str) else [str(c) for c in columns]
    if len(words) == 1 and len(words[0]) > 1:
        words = list(words[0])  # "xypt"
    order = tuple("-" if w in ("-", "_", "") else next(iter(find_columns([w])), w) for w in words)
    if sorted(c for c in order if c != "-") != sorted(DEFAULT_ORDER):
        raise UsageError(
            f"columns {columns!r} must name each of t, x, y and p once, in their order, and - for any other;"
            " for example x,y,p,t"
        )
    return order


def fitting_orders(table: Sequence[NDArray], sensor: tuple[int, int] | None) -> list[Columns]:
    """Return the orders of t, x, y, p that four columns of values allow.

    Polarities are of two values; coordinates are whole and inside the sensor; times do not fall, or, where no
    column never falls, do so seldom.

    Parameters
    ----------
    table : four (E,) arrays
        Some first events.
    sensor : (width, height) | None [px]
        Its size, if known.
    """
    values = [np.asarray(column, np.float64) for column in table]
    width, height = sensor or (MAX_SENSOR_SIDE, MAX_SENSOR_SIDE)
    signs = [np.isin(v, (-1.0, 0.0, 1.0)) for v in values]

    def inside(v: NDArray, size: int) -> bool:
        return bool(np.mean((v == np.rint(v)) & (v >= 0) & (v < size)) >= FIT)

    def time(i: int, most_falls: float) -> bool:
        v = values[i]
        if np.mean(np.isfinite(v) & (v >= 0)) < FIT:
            return False
        return len(v) < 2 or float(np.mean(np.diff(v) < 0)) <= most_falls

    def polarity(i: int) -> bool:
        # both 0 and -1 for darker is a mixture, which is no polarity
        v = values[i]
        return bool(
            np.mean(signs[i]) >= FIT and not (np.mean(v == 0) > 1 - FIT and np.mean(v == -1) > 1 - FIT)
        )

    roles = {
        "p": [polarity(i) for i in range(4)],
        "x": [inside(v, width) for v in values],
        "y": [inside(v, height) for v in values],
    }
    for most_falls in (0.0, MAX_FALLS):
        roles["t"] = [time(i, most_falls) for i in range(4)]
        orders = [o for o in ORDERS if all(roles[column][i] for i, column in enumerate(o))]
        if orders:
            return orders
    return []


def settle_order(
    table: Sequence[NDArray], sensor: tuple[int, int] | None, name: str, what: str
) -> tuple[Columns, str]:
    """Return the order of four columns without names, and a note where it is not the usual one.

    Raises
    ------
    RecordingError
        When no order or several fit, and t, x, y, p, which is taken first, is not among them.
    """
    orders = fitting_orders(table, sensor)
    if DEFAULT_ORDER in orders:
        return DEFAULT_ORDER, ""
    if len(orders) == 1:
        taken = ", ".join(orders[0])
        return orders[0], f"columns are taken as {taken}: {what} has no names, and no other order fits"
    if orders:
        possible = " or ".join(",".join(order) for order in orders)
        problem = f"could be {possible}"
        advice = f'say which: columns="{",".join(orders[0])}"'
    else:
        first = ", ".join(f"{column[0]:.10g}" for column in table)
        problem = f"fits no order of t, x, y, p (first: {first})"
        advice = 'say what the columns are, for example columns="x,y,p,t"'
    raise RecordingError(f"{name}: {what} has no column names and {problem}; {advice}")


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
        counts = ", ".join(f"{column} has {length:,}" for column, length in lengths.items())
        raise RecordingError(f"{name}: columns of different length: {counts}; export the recording again")
    return next(iter(lengths.values()))


def settle_sensor(
    asked: tuple[int, int] | None, said: DeclaredSensor | Unclear | None, name: str
) -> tuple[tuple[int, int], str]:
    """Sensor size, what was asked for before what the file says, and a note on it or "".

    Raises
    ------
    RecordingError
        When it is unknown or impossible.
    """
    size = asked or (said.size if isinstance(said, DeclaredSensor) else None)
    if size is None:
        problem = said.said if isinstance(said, Unclear) else "sensor size unknown"
        raise RecordingError(f'{name}: {problem}: pass sensor="WxH"')
    width, height = size
    if not (0 < width <= MAX_SENSOR_SIDE and 0 < height <= MAX_SENSOR_SIDE):
        raise RecordingError(
            f'{name}: sensor size {width}x{height} is impossible; pass the right one: sensor="WxH"'
        )
    if asked is None or said is None:
        return size, said.odd if isinstance(said, DeclaredSensor) else ""
    if isinstance(said, Unclear):
        return size, f"{said.said}; {width}x{height} was asked for"
    if said.size != asked:
        stated = f"{said.size[0]}x{said.size[1]}"
        return size, f"the file says the sensor is {stated}; {width}x{height} was asked for"
    return size, ""


def usable_times(t: NDArray, name: str) -> NDArray[np.bool_]:
    """Which stored times are finite numbers and not negative; raises where they are no numbers at all."""
    _require_kind(t, "t", "iuf", name)
    good = np.ones(len(t), bool) if t.dtype.kind != "f" else np.isfinite(t)
    return good if t.dtype.kind == "u" else good & (t >= 0)


class ColumnChecker:
    """Checks raw columns and brings them to int64 us, uint16, uint16, int8 -1/+1.

    It numbers the events that it met, for messages, and keeps to the polarity convention that it meets first:
    {0, 1} and {-1, 1} both are fine, a mixture is not.  Events that are wrong are told to ``faults`` and left
    out.
    """

    def __init__(
        self,
        name: str,
        sensor: tuple[int, int],
        unit: TimeUnit,
        t_offset_us: int,
        faults: Faults,
        *,
        first: int = 0,
    ) -> None:
        self.name = name
        self.width, self.height = sensor
        self.unit: TimeUnit = unit
        self.t_offset_us = t_offset_us
        self._faults = faults
        self._first = first
        self._dark_value: int | None = None
        self._wrong: NDArray[np.bool_] | None = None

    def __call__(self, raw: RawColumns) -> EventArray:
        """Check and convert; raises `RecordingError` where more is wrong than may be left out."""
        count = require_equal_lengths({c: len(v) for c, v in raw._asdict().items()}, self.name)
        self._wrong = None
        self._faults.met += count
        t, p = self._times(raw.t), self._polarities(raw.p)
        x = self._coordinates(raw.x, "x", self.width)
        y = self._coordinates(raw.y, "y", self.height)
        self._first += count
        if self._wrong is not None:
            good = ~self._wrong
            t, x, y, p = t[good], x[good], y[good], p[good]
        return EventArray(t, x, y, p, self.width, self.height)

    def _times(self, t: NDArray) -> NDArray[np.int64]:
        _require_kind(t, "t", "iuf", self.name)
        if t.dtype.kind == "f":
            t = self._leave_out(~np.isfinite(t), t, "time", "is not a finite number")
        if t.dtype.kind != "u":
            t = self._leave_out(t < 0, t, "time", "is negative")
        per_second = PER_SECOND[self.unit]
        limit_us = np.iinfo(np.int64).max - max(self.t_offset_us, 0)
        too_late = t > limit_us // 1_000_000 * per_second
        t = self._leave_out(too_late, t, "time", f"overflows 64-bit microseconds if in {self.unit}")
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
            problem = f"is negative with the file's offset {self.t_offset_us}"
            t_us = self._leave_out(t_us < 0, t_us, "time", problem)
        return t_us

    def _coordinates(self, values: NDArray, column: str, size: int) -> NDArray[np.uint16]:
        _require_kind(values, column, "iuf", self.name)
        if values.dtype.kind == "f":
            fraction = ~(values == np.rint(values))
            values = self._leave_out(fraction, values, column, "is no whole number of pixels")
        outside = values >= size
        if values.dtype.kind != "u":
            outside |= values < 0
        problem = f"is outside the {self.width}x{self.height} sensor"
        advice = 'if that is not its size, pass sensor="WxH"'
        return self._leave_out(outside, values, column, problem, advice).astype(np.uint16, copy=False)

    def _polarities(self, p: NDArray) -> NDArray[np.int8]:
        _require_kind(p, "p", "biuf", self.name)
        bright = p == 1
        dark = ~bright
        if np.any(dark):
            if self._dark_value is None:
                self._dark_value = -1 if p[np.argmax(dark)] == -1 else 0
            wrong = dark & (p != self._dark_value)
            self._leave_out(wrong, p, "polarity", "fits neither {0, 1} nor {-1, 1}")
        return np.where(bright, np.int8(1), np.int8(-1))

    def _leave_out(
        self,
        wrong: NDArray[np.bool_],
        values: NDArray,
        what: str,
        problem: str,
        advice: str = "repair or export the recording again",
    ) -> NDArray:
        """Mark events as wrong, telling of the first; return the values with zeros for these."""
        if not np.any(wrong):
            return values
        at = int(np.argmax(wrong))
        fresh = wrong if self._wrong is None else wrong & ~self._wrong
        self._wrong = wrong if self._wrong is None else wrong | self._wrong
        if np.any(fresh):
            value = values[at]
            if values.dtype.kind == "f" and abs(value) < 1e15 and value == np.rint(value):
                value = int(value)  # as the file has it, be it parsed as a float
            fault = f"{what} {value} of event {self._first + at:,} {problem}"
            self._faults.leave_out(int(np.count_nonzero(fresh)), fault, advice)
        return np.where(wrong, values.dtype.type(0), values)


def _require_kind(values: NDArray, column: str, kinds: str, name: str) -> None:
    if values.ndim != 1 or values.dtype.kind not in kinds:
        raise RecordingError(
            f"{name}: column {column} must be one-dimensional numbers, got {values.dtype} of shape"
            f" {values.shape}; export the recording again"
        )
