"""Events that are in memory already: structured arrays, tuples of columns, `EventArray`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray

from ..errors import RecordingError
from .columns import DEFAULT_ORDER, require_columns, require_equal_lengths, settle_order, unit_in_name
from .declared import PER_SECOND, DeclaredSensor, DeclaredUnit, TimeUnit, find_sensor
from .faults import Faults
from .options import Asked
from .source import RawChunks, RawColumns, Source

NAME = "arrays"
SAMPLE_ROWS = 4096


class ArraySource(Source):
    """Columns in memory."""

    def __init__(self, columns: RawColumns, format: str, **known: Any) -> None:
        lengths = {column: len(values) for column, values in columns._asdict().items()}
        super().__init__(NAME, format, n_events=require_equal_lengths(lengths, NAME), **known)
        self._columns = columns

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Yield views."""
        for i in range(0, len(self._columns.t), chunk_events):
            yield RawColumns(*(values[i : i + chunk_events] for values in self._columns))

    def raw_tail(self, count: int) -> RawColumns:
        """Return views."""
        return RawColumns(*(values[-count:] for values in self._columns))


def open_arrays(source: Any, asked: Asked | None = None) -> Source:
    """Wrap events in memory, whatever holds them; raises TypeError for what holds none."""
    asked = asked or Asked()
    if isinstance(source, EventArray):
        columns = RawColumns(source.t, source.x, source.y, source.p)
        unit = DeclaredUnit("us", "an EventArray holds microseconds")
        sensor = DeclaredSensor((source.width, source.height))
        return ArraySource(columns, "EventArray", sensor=sensor, unit=unit)
    if isinstance(source, np.ndarray):
        if source.dtype.names is not None:
            return _named({name: source[name] for name in source.dtype.names}, "structured array")
        return _matrix(source, asked)
    if isinstance(source, Mapping):
        return _named(source, "dict")
    if is_table(source):
        return _table(source)
    if isinstance(source, (tuple, list)):
        if len(source) == 4 and not _are_rows(source):
            columns = RawColumns(*(_column(values) for values in source))
            return _with_times(columns, "arrays t, x, y, p")
        try:
            return _matrix(np.asarray(source), asked)
        except ValueError:  # rows of different lengths
            pass
    raise TypeError(
        "source must be a path, EventArray, array, dict or DataFrame with columns t, x, y, p, or"
        f" (t, x, y, p), got {_kind_of(source)}"
    )


def is_table(source: Any) -> bool:
    """Tell whether something is a table of named columns, such as a DataFrame of pandas or Polars."""
    return hasattr(type(source), "columns") or hasattr(type(source), "column_names")


def _table(source: Any) -> Source:
    """Take the columns of a table, and its index where that has a name."""
    kind = type(source).__name__
    if not hasattr(source, "__len__"):
        raise TypeError(f"source must hold its events, got a {kind} that is not computed; pass .collect()")
    if getattr(getattr(source, "index", None), "name", None) is not None:
        source = source.reset_index()
    names = getattr(source, "column_names", source.columns)
    return _named({str(name): source[name] for name in names}, kind)


def _with_times(columns: RawColumns, kind: str, **known: Any) -> Source:
    """Take columns whose times may be dates or durations, which have a unit of their own."""
    if columns.t.dtype.kind not in "mM":
        return ArraySource(columns, kind, **known)
    unit, count = np.datetime_data(columns.t.dtype)
    if unit not in PER_SECOND or count != 1:
        unit, columns = "ns", columns._replace(t=columns.t.astype(f"{columns.t.dtype.kind}8[ns]"))
    said = DeclaredUnit(cast("TimeUnit", unit), f"its times are {columns.t.dtype}")
    return ArraySource(columns._replace(t=columns.t.astype(np.int64)), kind, **{**known, "unit": said})


def _named(values: Mapping[str, Any], kind: str) -> Source:
    """Take columns by their names; what else there is may tell the sensor's size."""
    found = require_columns(map(str, values), NAME, f"the {kind}")
    named = unit_in_name(found["t"])
    unit = DeclaredUnit(named, f"column {found['t']!r} says so") if named else None
    by_name = {str(name): each for name, each in values.items()}
    columns = RawColumns(*(_column(by_name[found[column]]) for column in "txyp"))
    others = {name: each for name, each in by_name.items() if name not in found.values()}
    sensor = find_sensor({name: each for name, each in others.items() if np.size(each) <= 2})
    return _with_times(columns, kind, unit=unit, sensor=sensor)


def _column(values: Any) -> NDArray[Any]:
    """Make an array of a column, whatever holds it."""
    array = np.atleast_1d(np.asarray(values))
    return np.array(array.tolist()) if array.dtype.hasobject and array.ndim == 1 else array


def _are_rows(values: Sequence[Any]) -> bool:
    """Whether four things are four events, not four columns: as many in each say nothing."""
    return isinstance(values, list) and all(isinstance(each, tuple) and len(each) == 4 for each in values)


def _kind_of(source: Any) -> str:
    if hasattr(source, "read") and not hasattr(source, "chunks"):
        return "an open file; pass its path"
    return type(source).__name__


def _matrix(array: NDArray[Any], asked: Asked) -> Source:
    """Take the columns of a matrix by what was asked for, or by what its values allow."""
    width = 4 if asked.columns is None else len(asked.columns)
    if array.ndim != 2 or array.shape[1] != width or array.dtype.kind not in "biuf":
        raise RecordingError(
            f"{NAME}: an array of {array.dtype} of shape {array.shape} without named columns leaves open"
            ' which is which; pass (t, x, y, p), or columns="t,x,y,p" for an array of four columns'
        )
    order, remark = asked.columns, ""
    if order is None and len(array):
        order, remark = settle_order(list(array[:SAMPLE_ROWS].T), asked.sensor, NAME, "the array")
    order = order or DEFAULT_ORDER
    columns = RawColumns(*(array[:, order.index(column)] for column in "txyp"))
    return ArraySource(columns, f"array N x {width} ({', '.join(order)})", notes=(remark,) * bool(remark))
