"""What every format hands over: raw columns as stored, in the order of the file, a piece at a time."""

from __future__ import annotations

import errno
import os
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

from numpy.typing import NDArray

from ..errors import EvqrError, RecordingError, StreamChoice
from .declared import DeclaredSensor, DeclaredUnit, Unclear
from .faults import Faults
from .triggers import Edge


class RawColumns(NamedTuple):
    """Some consecutive events as stored: unchecked.

    Attributes
    ----------
    t : (E,) number
        Times, in any unit.
    x, y : (E,) number
        Column and row.
    p : (E,) number
        Polarity, in any convention.
    """

    t: NDArray[Any]
    x: NDArray[Any]
    y: NDArray[Any]
    p: NDArray[Any]


RawChunks = Generator[RawColumns, None, None]
"""All events, a piece at a time; a generator, to be closed by who stops early."""


class Source(ABC):
    """One opened file of one format.

    Attributes
    ----------
    name : str
        What error messages call it: the path, or "arrays".
    format : str
        The format in words.
    sensor : DeclaredSensor | Unclear | None
        What the file says of the sensor's size.
    n_events : int | None
        Events in the file if it tells.
    unit : DeclaredUnit | Unclear | None
        What the file or its format says of the unit of the stored times.
    t_offset_us : int [us]
        To be added to every time stamp.
    stream : str
        Name of the event stream that was opened, "" where a file can hold but one.
    streams : tuple of str
        Names of all event streams in the file.
    notes : tuple of str
        What had to be decided to read the file, each in one line.
    """

    def __init__(
        self,
        name: str,
        format: str,
        *,
        sensor: DeclaredSensor | Unclear | None = None,
        n_events: int | None = None,
        unit: DeclaredUnit | Unclear | None = None,
        t_offset_us: int = 0,
        stream: str = "",
        streams: Sequence[str] = (),
        notes: Sequence[str] = (),
    ) -> None:
        self.name = name
        self.format = format
        self.sensor = sensor
        self.n_events = n_events
        self.unit = unit
        self.t_offset_us = t_offset_us
        self.stream = stream
        self.streams = tuple(streams)
        self.notes = tuple(notes)

    @abstractmethod
    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """All events from the first on, about ``chunk_events`` at a time; can be called again.

        What cannot be decoded, and where the file ends too early, is told to ``faults``.
        """

    def raw_tail(self, count: int) -> RawColumns | None:
        """Return the last ``count`` events, where they can be had without reading all before them."""
        return None

    def edges(self) -> Iterator[Edge]:
        """All triggers, in a way through of its own.

        Raises
        ------
        RecordingError
            Such files have none, or none that are read.
        """
        raise RecordingError(f"{self.name}: no triggers are read from {self.format}; name a file of triggers")

    def close(self) -> None:  # noqa: B027  (most sources hold nothing open between chunks)
        """Release files; harmless when called twice."""


def choose_stream(names: Sequence[str], wanted: str | None, name: str, what: str) -> str:
    """Return the one of several event streams to read.

    Parameters
    ----------
    names : sequence of str
        The event streams of the file, at least one.
    wanted : str | None
        What the user asked for: a name, or its last part where that is unique ("left" for "davis/left"), or
        else any part ("left" for "davis/left/events").
    name, what : str
        The recording, and what the format calls its streams, for the message.

    Raises
    ------
    StreamChoice
        When nothing was asked for and there are several.
    RecordingError
        When what was asked for is not there.
    """
    listed = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    if wanted is None:
        if len(names) == 1:
            return names[0]
        message = f'{name}: holds several event {what}s ({listed}); choose one of them: stream="{names[0]}"'
        raise StreamChoice(message, tuple(names))
    if wanted in names:
        return wanted
    parts = _parts(wanted)
    ends = [each for each in names if _parts(each)[-len(parts) :] == parts]
    within = ends or [
        each
        for each in names
        if any(_parts(each)[i : i + len(parts)] == parts for i in range(len(_parts(each))))
    ]
    if len(within) == 1:
        return within[0]
    problem = "fits several" if within else "is not among the"
    raise RecordingError(f"{name}: stream {wanted!r} {problem} event {what}s of this file ({listed})")


def _parts(name: str) -> list[str]:
    return name.strip("/").casefold().split("/")


@contextmanager
def explained(name: str, what: str, advice: str = "copy or export it again") -> Iterator[None]:
    """Turn whatever a decoder raises on damaged bytes into a `RecordingError` of one line.

    The decoders below us (HDF5, zip, NumPy headers, native vendor readers) raise nearly every kind of
    exception when bytes are damaged, so the net is as wide as theirs.  What the system refuses is told apart.
    """
    try:
        yield
    except EvqrError:
        raise
    except BaseException as error:
        # A panic of a native reader is no Exception (pyo3 makes it a BaseException), but damage all the same.
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        if refused := refusal(error):
            raise RecordingError(f"{name}: {refused}") from error
        detail = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{name}: {what} is damaged or truncated ({detail}); {advice}") from error


def refusal(error: BaseException) -> str | None:
    """Tell what the system says no to, with what helps; None for an error of any other kind."""
    if isinstance(error, MemoryError):
        return "needs more memory than there is; close other programs, or cut the recording"
    if not isinstance(error, OSError):
        return None
    text, code = str(error), error.errno
    if "unable to lock file" in text or code in (errno.EAGAIN, errno.EBUSY, errno.ETXTBSY, errno.EDEADLK):
        return (
            "is in use by another program, which locks it; close it there, or copy the file and read the copy"
        )
    if "already open for write" in text or "h5clear" in text:
        return (
            "is marked as being written: close it in the program that writes it, or, if that has died, clear"
            " the mark with h5clear -s FILE"
        )
    if getattr(error, "winerror", None) in (32, 33):
        return "is in use by another program; close it there"
    if code in (errno.EACCES, errno.EPERM):
        return "cannot be read (Permission denied); check its permissions"
    if code == errno.ENOSPC:
        return f"needs a temporary file, and the disk of {_folder()} is full; make room, or set TMPDIR"
    if code in (errno.EMFILE, errno.ENFILE):
        return "cannot be opened: too many files are open; close some"
    if code in (errno.EIO, errno.ESTALE, errno.ENODEV, errno.ENXIO):
        return (
            f"cannot be read from its disk or share ({os.strerror(code)}); check the device or the connection"
        )
    if code == errno.ENOENT and error.filename:
        return f"file {os.fsdecode(error.filename)} is not there any more; check the path"
    return None


def _folder() -> str:
    import tempfile

    return tempfile.gettempdir()
