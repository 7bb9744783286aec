"""Events that are in memory already: structured arrays, tuples of columns, `EventArray`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray

from ..errors import RecordingError
from .columns import DEFAULT_ORDER, require_columns, require_equal_lengths, settle_order, unit_in_name
from .declared import DeclaredSensor, DeclaredUnit
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


def open_arrays(
    source: EventArray | NDArray[Any] | tuple[Any, Any, Any, Any], asked: Asked | None = None
) -> Source:
    """Wrap an `EventArray`, an array or ``(t, x, y, p)``; raises TypeError for anything else."""
    asked = asked or Asked()
    if isinstance(source, EventArray):
        columns = RawColumns(source.t, source.x, source.y, source.p)
        unit = DeclaredUnit("us", "an EventArray holds microseconds")
        sensor = DeclaredSensor((source.width, source.height))
        return ArraySource(columns, "EventArray", sensor=sensor, unit=unit)
    if isinstance(source, np.ndarray):
        if source.dtype.names is None:
            return _matrix(source, asked)
        found = require_columns(source.dtype.names, NAME, "the structured array")
        named = unit_in_name(found["t"])
        unit = DeclaredUnit(named, f"column {found['t']!r} says so") if named else None
        columns = RawColumns(*(source[found[column]] for column in "txyp"))
        return ArraySource(columns, "structured array", unit=unit)
    if isinstance(source, tuple) and len(source) == 4:
        return ArraySource(RawColumns(*(np.atleast_1d(values) for values in source)), "arrays t, x, y, p")
    raise TypeError(
        f"source must be a path, EventArray, structured array or (t, x, y, p), got {type(source).__name__}"
    )


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
