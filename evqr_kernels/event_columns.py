"""Events as others keep them, made into what the operations take."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from evqr_kernels.checks import Floats

NAMES = {
    "x": ("x", "xs", "x_position", "column"),
    "y": ("y", "ys", "y_position", "row"),
    "t": ("t", "ts", "time", "timestamp", "timestamps", "t_us"),
    "weight": ("p", "ps", "pol", "polarity", "polarities", "on", "weight"),
}
"""What others call a column; the first that is there is taken."""


class Columns(NamedTuple):
    """Events by columns, in the order in which operations take them.

    Attributes
    ----------
    x, y : (E,) float [px]
        Column and row.
    t : (E,) float [s]
        Since ``t0``.
    weight : (E,) float [1]
        +1 of ON events, -1 of OFF events; or what was given, if that were floats.
    """

    x: Floats
    y: Floats
    t: Floats
    weight: Floats


def columns(events: Any, t0: Any = None, *, tick: float = 1e-6, dtype: DTypeLike = np.float32) -> Columns:
    """Make columns of floats of events in any form; a column that is one already is not copied.

    Parameters
    ----------
    events : object
        A structured array; a mapping, a DataFrame or a table (pandas, Polars, Arrow) with columns by name; or
        a tuple or list of four columns x, y, t and polarity.  Columns are arrays, or what `numpy.asarray` can
        read.
    t0 : object or None
        The window's reference time, in the clock's own unit; by default that of the first event.  It is
        subtracted before times become floats, which cannot hold those of a clock that has run for long.
    tick : float [s]
        What an integer of the clock stands for; times that are floats are in seconds, ``datetime64`` and
        ``timedelta64`` know their unit.
    dtype : dtype
        float32 or float64.

    Returns
    -------
    columns : Columns
        x, y, t and weight: ``bin_events(c.x, c.y, c.weight, ...)``, ``splat_events(*c, ...)``.

    Raises
    ------
    TypeError
        If ``events`` is none of these, a column is not of numbers, or ``dtype`` is another.
    ValueError
        If a column is not there, has more than one axis or another length than ``x``, or polarities are other
        integers than 0 and 1, or -1 and 1.
    """
    if np.dtype(dtype) not in (np.dtype(np.float32), np.dtype(np.float64)):
        raise TypeError(f"dtype must be float32 or float64, got {np.dtype(dtype)}")
    found = {name: _column(name, column) for name, column in _by_name(events).items()}
    for name, column in found.items():
        if len(column) != len(found["x"]):
            raise ValueError(f"{name} must have {len(found['x'])} events like x, got {len(column)}")
    made = (found["x"], found["y"], _times(found["t"], t0, tick), _weights(found["weight"]))
    return Columns(*(np.ascontiguousarray(column, dtype) for column in made))


def _by_name(events: Any) -> dict[str, Any]:
    if isinstance(events, (tuple, list)):
        if len(events) != 4:
            raise ValueError(f"events must be four columns x, y, t and polarity, got {len(events)}")
        return dict(zip(NAMES, events, strict=True))
    known = _names_in(events)
    found = {}
    for name, others in NAMES.items():
        there = next((other for other in others if other in known), None)
        if there is None:
            raise ValueError(
                f"events must have a column {name} ({', '.join(others)}), got {', '.join(map(str, known))}"
            )
        found[name] = events[there]
    return found


def _names_in(events: Any) -> list[Any]:
    if isinstance(events, np.ndarray) and events.dtype.names:
        return list(events.dtype.names)
    if isinstance(events, Mapping):
        return list(events)
    for attribute in ("column_names", "columns"):  # Arrow; pandas and Polars
        if not isinstance(events, np.ndarray) and hasattr(events, attribute):
            return list(getattr(events, attribute))
    raise TypeError(
        f"events must be a structured array, columns by name or a tuple of four, got {type(events).__name__}"
    )


def _column(name: str, column: Any) -> NDArray[Any]:
    made = np.asarray(column)
    if made.ndim != 1:
        raise ValueError(f"{name} must have shape (E,), got {made.shape}")
    if made.dtype.kind not in ("biufmM" if name == "t" else "biuf"):
        raise TypeError(f"{name} must be numbers, got {made.dtype}")
    return made


def _times(t: NDArray[Any], t0: Any, tick: float) -> NDArray[Any]:
    """Seconds since t0, the difference made in the clock's own numbers."""
    if t0 is None and len(t):
        t0 = t[0]
    if t0 is None:
        return t.astype(np.float64) if t.dtype.kind in "mM" else t
    if t.dtype.kind in "mM":
        return (t - np.asarray(t0, t.dtype)) / np.timedelta64(1, "s")
    if t.dtype.kind == "f":
        return t - t.dtype.type(t0) if t0 else t
    return np.subtract(t, np.int64(t0), dtype=np.int64, casting="unsafe") * tick


def _weights(polarity: NDArray[Any]) -> NDArray[Any]:
    """+1 of ON events, -1 of OFF events."""
    if polarity.dtype.kind == "f":
        return polarity
    if polarity.dtype.kind == "b":
        return 2.0 * polarity - 1.0
    least, most = int(polarity.min(initial=1)), int(polarity.max(initial=0))
    if least < -1 or most > 1 or (least == -1 and not polarity.all()):
        raise ValueError(f"polarities must be 0 and 1, or -1 and 1, got {least} to {most}")
    return polarity if least == -1 else 2.0 * polarity - 1.0
