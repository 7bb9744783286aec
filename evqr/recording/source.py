"""What every format hands over: raw columns as stored, in the order of the file, a piece at a time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple

from numpy.typing import NDArray

from ..errors import EvqrError, RecordingError

TimeUnit = Literal["s", "ms", "us", "ns"]


class RawColumns(NamedTuple):
    """Some consecutive events as stored: any numeric dtype, any unit, any polarity convention, unchecked."""

    t: NDArray[Any]
    x: NDArray[Any]
    y: NDArray[Any]
    p: NDArray[Any]


RawChunks = Generator[RawColumns, None, None]
"""All events, a piece at a time; a generator, to be closed by who stops early."""


class DeclaredUnit(NamedTuple):
    """The unit of the time stamps as the file or its format states it, and where it does so."""

    unit: TimeUnit
    reason: str


class Source(ABC):
    """One opened file of one format.

    Attributes
    ----------
    name           what error messages call it: the path, or "arrays"
    format         the format in words
    sensor         (width, height) if the file tells, else None
    n_events       events in the file if it tells, else None
    unit           unit of the stored times if the file or format tells, else None
    t_offset_us    to be added to every time stamp [us]
    """

    def __init__(
        self,
        name: str,
        format: str,
        *,
        sensor: tuple[int, int] | None = None,
        n_events: int | None = None,
        unit: DeclaredUnit | None = None,
        t_offset_us: int = 0,
    ) -> None:
        self.name = name
        self.format = format
        self.sensor = sensor
        self.n_events = n_events
        self.unit = unit
        self.t_offset_us = t_offset_us

    @abstractmethod
    def raw_chunks(self, chunk_events: int) -> RawChunks:
        """All events from the first on, about ``chunk_events`` at a time; can be called again."""

    def raw_tail(self, count: int) -> RawColumns | None:
        """Return the last ``count`` events, where they can be had without reading all before them."""
        return None

    def close(self) -> None:  # noqa: B027  (most sources hold nothing open between chunks)
        """Release files; harmless when called twice."""


@contextmanager
def explained(name: str, what: str) -> Iterator[None]:
    """Turn whatever a decoder raises on damaged bytes into a `RecordingError` of one line.

    The decoders below us (HDF5, zip, NumPy headers, native vendor readers) raise nearly every kind of
    exception when bytes are damaged, so the net is as wide as theirs.
    """
    try:
        yield
    except EvqrError:
        raise
    except BaseException as error:
        # A panic of a native reader is no Exception (pyo3 makes it a BaseException), but damage all the same.
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        detail = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(
            f"{name}: {what} is damaged or truncated ({detail}); copy or export it again"
        ) from error
