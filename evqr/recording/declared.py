"""What files say of themselves in words: the unit of the times, the size of the sensor.

All spellings in use are understood here and nowhere else.  What is said but not understood is no error yet:
who opens the recording may have told it, and the user's word goes first.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

TimeUnit = Literal["s", "ms", "us", "ns"]

PER_SECOND: dict[TimeUnit, int] = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}

_SPELLINGS: dict[TimeUnit, tuple[str, ...]] = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "msecs", "millis", "millisec", "millisecs", "millisecond", "milliseconds"),
    "us": ("us", "usec", "usecs", "micros", "microsec", "microsecs", "microsecond", "microseconds", "mus",
           "µs", "µsec", "µsecs", "μs", "μsec", "μsecs"),  # micro sign and Greek mu
    "ns": ("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"),
}  # fmt: skip
UNIT_NAMES: dict[str, TimeUnit] = {name: unit for unit, names in _SPELLINGS.items() for name in names}

_UNIT_KEYS = ("unit", "units", "timeunit", "timeunits", "tunit", "tunits", "timestampunit", "timestampunits",
              "timescale", "timeresolution")  # fmt: skip

_PREFIXES = ("sensor", "image", "img", "frame", "camera")
_WIDTHS = ("width", "w", "sizex", "xsize", "resx", "xres", "resolutionx", "xresolution", "cols")
_HEIGHTS = ("height", "h", "sizey", "ysize", "resy", "yres", "resolutiony", "yresolution", "rows")
_PAIRS = ("geometry", "resolution", "", "size", "shape", "dimension", "dimensions")
_SURE_PAIRS = ("geometry", "resolution")
"""Names of which a value that is no pair of numbers is worth a word."""

TIMES = "\N{MULTIPLICATION SIGN}"
"""Between the sides of a sensor, beside the letter."""

_NUMBER = r"(\d+)(?:\.0*)?\s*(?:px|pixels?)?"
_SIZE = re.compile(rf"[^\d-]*?{_NUMBER}\s*(?:[x{TIMES}*,;/ ]|by)\s*{_NUMBER}\W*", re.IGNORECASE)
_NAMED_WIDTH = re.compile(r"width\W*(\d+)", re.IGNORECASE)
_NAMED_HEIGHT = re.compile(r"height\W*(\d+)", re.IGNORECASE)


class DeclaredUnit(NamedTuple):
    """The unit of the time stamps as the file or its format states it.

    Attributes
    ----------
    unit : "s", "ms", "us" or "ns"
        As stated.
    reason : str
        Where it is, in words.
    """

    unit: TimeUnit
    reason: str


class DeclaredSensor(NamedTuple):
    """The size of the sensor as the file states it.

    Attributes
    ----------
    size : (int, int) [px]
        Width and height.
    odd : str
        What had to be decided, or "".
    """

    size: tuple[int, int]
    odd: str = ""


class Unclear(NamedTuple):
    """Something a file says that is not understood.

    Attributes
    ----------
    said : str
        What, and where, in words.
    """

    said: str


def parse_unit(value: Any) -> TimeUnit | None:
    """Return the unit that a text or a number of seconds names, or None.

    >>> parse_unit("usecs"), parse_unit("[ms]"), parse_unit("1e-9 s"), parse_unit("seconds since 1970-01-01")
    ('us', 'ms', 'ns', 's')
    """
    value = plain(value)
    if value is None or isinstance(value, bool):
        return None
    text = str(value).casefold().strip().strip("[](){}<>'\" .").split(" since ")[0].strip()
    if text in UNIT_NAMES:
        return UNIT_NAMES[text]
    scale = re.fullmatch(r"([\d.]+(?:e[+-]?\d+)?)\s*([^\d\s]*)", text.replace("10^", "1e"))
    if scale is None or (scale[2] and scale[2] not in UNIT_NAMES):
        return None
    try:
        seconds = float(scale[1]) / PER_SECOND[UNIT_NAMES.get(scale[2], "s")]
    except ValueError:
        return None
    return next((u for u, n in PER_SECOND.items() if abs(seconds * n - 1.0) < 1e-6), None)


def parse_size(value: Any) -> tuple[int, int] | None:
    """(width, height) that a text or a pair of numbers names, or None.

    >>> parse_size("640 x 480"), parse_size("height=48;width=64"), parse_size("(346, 260)")
    ((640, 480), (64, 48), (346, 260))
    """
    value = plain(value)
    if isinstance(value, str):
        wide, high = _NAMED_WIDTH.search(value), _NAMED_HEIGHT.search(value)
        if wide and high:
            return int(wide[1]), int(high[1])
        size = _SIZE.fullmatch(value.strip())
        return (int(size[1]), int(size[2])) if size else None
    sides = np.asarray(value).ravel()
    if sides.size != 2:
        return None
    first, second = whole(sides[0]), whole(sides[1])
    return None if first is None or second is None else (first, second)


def unit_of(value: Any, where: str) -> DeclaredUnit | Unclear:
    """Return the unit that a value states, with the place where it stands for the reason."""
    unit, text = parse_unit(value), plain(value)
    if unit is None:
        return Unclear(f"{where} is {_short(text)}, no known unit")
    return DeclaredUnit(unit, f"{where} says {text}")


def sensor_of(value: Any, where: str, *, rows_first: bool = False) -> DeclaredSensor | Unclear:
    """Size that a value states.

    Two numbers without names are (width, height), or (height, width) in what is called a shape.  Cameras are
    wider than high, so where the numbers say the opposite they are taken in the other order, which is told.
    """
    size = parse_size(value)
    if size is None or min(size) < 1:
        return Unclear(f"sensor size {_short(plain(value))} in {where} is no pair of whole numbers")
    if isinstance(plain(value), str):
        return DeclaredSensor(size)
    if rows_first:
        size = size[1], size[0]
    if size[0] >= size[1]:
        return DeclaredSensor(size)
    size = size[1], size[0]
    odd = f"the sensor is taken as {size[0]}x{size[1]}: of {where} the larger number as the width"
    return DeclaredSensor(size, odd)


def find_sensor(said: Mapping[str, Any]) -> DeclaredSensor | Unclear | None:
    """Size among named values, whatever the usual names they go by."""
    values = {_key(name): (name, value) for name, value in said.items()}
    sides = [next((values[k] for k in names if k in values), None) for names in (_WIDTHS, _HEIGHTS)]
    if sides[0] and sides[1]:
        width, height = whole(sides[0][1]), whole(sides[1][1])
        if width is None or height is None:
            pair = plain(sides[0][1]), plain(sides[1][1])
            names = f"{sides[0][0]} and {sides[1][0]}"
            return Unclear(f"sensor size {_short(pair)} in {names} is no pair of whole numbers")
        return DeclaredSensor((width, height))
    for key in _PAIRS:
        if key in values:
            name, value = values[key]
            found = sensor_of(value, name, rows_first=key == "shape")
            if isinstance(found, DeclaredSensor) or key in _SURE_PAIRS:
                return found
    return None


def find_unit(said: Mapping[str, Any], where: str) -> DeclaredUnit | Unclear | None:
    """Find the unit among named values of one place."""
    for name, value in said.items():
        if _squeezed(name) in _UNIT_KEYS and (found := unit_of(value, f"{name} of {where}")):
            return found
    return None


def plain(value: Any) -> Any:
    """Value without its wrapping: text of bytes, the item of an array of one, None of nothing.

    netCDF4, rhdf5 and HDFView write attributes as arrays of one.
    """
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").strip("\0 ")
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, (np.ndarray, list, tuple)) and np.size(value) == 1:
        return plain(np.asarray(value).reshape(-1)[0])
    if value is None or type(value).__name__ == "Empty":  # h5py.Empty
        return None
    return value.strip("\0 ") if isinstance(value, str) else value


def whole(value: Any) -> int | None:
    """Whole number that a value is, be it written as a float or as text, or None."""
    try:
        number = float(plain(value))
    except (TypeError, ValueError):
        return None
    return int(number) if number == number and number.is_integer() else None


def split_unit(name: str) -> tuple[str, TimeUnit | None]:
    """Name of a column without its unit, and the unit.

    >>> split_unit("t [us]"), split_unit("timestamp_ns"), split_unit("Time (s)"), split_unit("polarity")
    (('t', 'us'), ('timestamp', 'ns'), ('time', 's'), ('polarity', None))
    """
    text = " ".join(name.casefold().strip().strip("\"'`").split())
    bracketed = re.fullmatch(r"(.*?)\s*[\[({<]\s*([^\])}>]*)\s*[\])}>]", text)
    if bracketed:
        return _underscored(bracketed[1]), parse_unit(bracketed[2])
    for separator in ("_", "/", " in ", " ", "-", "."):
        head, found, tail = text.rpartition(separator)
        if found and head and (tail in UNIT_NAMES or tail in ("px", "pixel", "pixels")):
            return _underscored(head), UNIT_NAMES.get(tail)
    return _underscored(text), None


def _underscored(text: str) -> str:
    return text.strip().replace(" ", "_").replace("-", "_")


def _squeezed(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.casefold())


def _key(name: str) -> str:
    key = _squeezed(name)
    return next((key.removeprefix(prefix) for prefix in _PREFIXES if key.startswith(prefix)), key)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def first_of(found: Iterable[Any]) -> Any:
    """First that is not None, with what is understood before what is unclear."""
    every = [thing for thing in found if thing is not None]
    return next((thing for thing in every if not isinstance(thing, Unclear)), every[0] if every else None)
