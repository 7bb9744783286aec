"""Events that are in memory already: structured arrays, tuples of columns, `EventArray`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.events.array import EventArray

from ..errors import RecordingError
from .columns import require_columns, require_equal_lengths
from .source import DeclaredUnit, RawChunks, RawColumns, Source

NAME = "arrays"


class ArraySource(Source):
    """Columns in memory."""

    def __init__(self, columns: RawColumns, format: str, **known: Any) -> None:
        lengths = {column: len(values) for column, values in columns._asdict().items()}
        super().__init__(NAME, format, n_events=require_equal_lengths(lengths, NAME), **known)
        self._columns = columns

    def raw_chunks(self, chunk_events: int) -> RawChunks:
        """Yield views."""
        for i in range(0, len(self._columns.t), chunk_events):
            yield RawColumns(*(values[i : i + chunk_events] for values in self._columns))

    def raw_tail(self, count: int) -> RawColumns:
        """Return views."""
        return RawColumns(*(values[-count:] for values in self._columns))


def open_arrays(source: EventArray | NDArray[Any] | tuple[Any, Any, Any, Any]) -> Source:
    """Wrap an `EventArray`, a structured array or ``(t, x, y, p)``; raises TypeError for anything else."""
    if isinstance(source, EventArray):
        columns = RawColumns(source.t, source.x, source.y, source.p)
        unit = DeclaredUnit("us", "an EventArray holds microseconds")
        return ArraySource(columns, "EventArray", sensor=(source.width, source.height), unit=unit)
    if isinstance(source, np.ndarray):
        if source.dtype.names is None:
            raise RecordingError(
                f"{NAME}: an array of {source.dtype} without named columns leaves open which is which;"
                " pass (t, x, y, p)"
            )
        found = require_columns(source.dtype.names, NAME, "the structured array")
        return ArraySource(RawColumns(*(source[found[column]] for column in "txyp")), "structured array")
    if isinstance(source, tuple) and len(source) == 4:
        return ArraySource(RawColumns(*(np.atleast_1d(values) for values in source)), "arrays t, x, y, p")
    raise TypeError(
        f"source must be a path, EventArray, structured array or (t, x, y, p), got {type(source).__name__}"
    )
