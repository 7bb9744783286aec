"""Open a recording: find out what it is, and who reads it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

from ..errors import RecordingError
from .arrays import open_arrays
from .declared import TimeUnit
from .options import DEFAULT_CHUNK_EVENTS, checked
from .recognise import reader_of
from .stream import Recording


def open_recording(
    source: Any,
    *,
    sensor: tuple[int, int] | str | None = None,
    time_unit: TimeUnit | None = None,
    stream: str | None = None,
    columns: str | Sequence[str] | None = None,
    strict: bool = False,
    start_us: int | None = None,
    end_us: int | None = None,
    chunk_events: int = DEFAULT_CHUNK_EVENTS,
) -> Recording:
    """Open a recording of any known format, or events in memory.

    Parameters
    ----------
    source : path, EventArray, array, tuple, list, dict or DataFrame
        A file, or a folder that is a ROS 2 bag; an `EventArray`; a structured array with fields t, x, y, p or
        usual aliases; an array of four columns; a tuple or a list (t, x, y, p); a dict or a DataFrame with
        columns of such names.
    sensor : (int, int) or str [px]
        Width and height, or "640x480"; needed where the source does not tell.
    time_unit : "s", "ms", "us" or "ns"
        Unit of the stored times; needed where neither source nor numbers tell.
    stream : str
        Which of several event streams to read; a message names them where there is more than one.
    columns : str or sequence of str
        What the columns of a table without names are, such as "x,y,p,t"; "-" for one that is not read.
    strict : bool
        Refuse at the first event that is wrong.  Else up to `faults.MAX_LEFT_OUT_SHARE` of the events are
        left out, a clock that was reset goes on rising, a file that is cut short is read up to there;
        `Recording.notes` tells.
    start_us, end_us : int [us]
        Give the events with ``start_us <= t < end_us`` only.
    chunk_events : int
        About so many events a chunk.

    Returns
    -------
    Recording
        To be closed; a context manager.

    Raises
    ------
    RecordingError
        Missing, empty, no event file, inconsistent, or wrong beyond what may be left out; one line that says
        what to do.
    MissingExtra
        The format needs the extra ``formats``; the message has the command that installs it.
    UsageError
        An unknown unit, a size that is none, columns that are not the four.
    TypeError
        A source, or a time, of another type.
    """
    asked = checked(
        sensor=sensor,
        time_unit=time_unit,
        stream=stream,
        columns=columns,
        strict=strict,
        start_us=start_us,
        end_us=end_us,
        chunk_events=chunk_events,
    )
    if isinstance(source, (str, os.PathLike)):
        path = os.fspath(source)
        opened = reader_of(path)(path, asked)
    else:
        path = ""
        opened = open_arrays(source, asked)
    try:
        if asked.stream is not None and not opened.streams:
            raise RecordingError(f"{opened.name}: {opened.format} holds one stream; leave out stream=")
        return Recording(opened, path=path, asked=asked)
    except BaseException:
        opened.close()
        raise
