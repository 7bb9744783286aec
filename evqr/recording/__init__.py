"""Open, check, stream and save event recordings.

`open_recording` recognises the format by its content, never by the name.  Data flow: a `source.Source` of one
format family gives raw columns, `columns` checks and converts them, `ordering` puts them in order of time,
`stream.Recording` hands them out.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from evqr.events.array import EventArray

from ..errors import RecordingError, UsageError
from .arrays import open_arrays
from .source import Source, TimeUnit
from .stream import Recording
from .summary import RecordingInfo, summarise
from .time_unit import PER_SECOND
from .writing import save_recording

__all__ = ["Recording", "RecordingInfo", "TimeUnit", "open_recording", "save_recording", "summarise"]

DEFAULT_CHUNK_EVENTS = 1 << 20
HEAD_BYTES = 4096

UNSUPPORTED = {
    b"#!AER-DAT": "AEDAT before version 4 is not read (its readers disagree on orientation); convert it",
    b"\x89MCAP0\r\n": "ROS 2 bags are not read; convert it to a ROS 1 bag",
    b"SQLite format 3\0": "ROS 2 bags are not read; convert it to a ROS 1 bag",
    b"\x1f\x8b": "the file is compressed with gzip; unpack it first",
}


def open_recording(
    source: str | os.PathLike[str] | EventArray | NDArray[Any] | tuple[Any, Any, Any, Any],
    *,
    sensor: tuple[int, int] | None = None,
    time_unit: TimeUnit | None = None,
    chunk_events: int = DEFAULT_CHUNK_EVENTS,
) -> Recording:
    """Open a recording of any known format, or events in memory.

    Parameters
    ----------
    source        path; `EventArray`; structured array with fields t, x, y, p or usual aliases; (t, x, y, p)
    sensor        (width, height) [px]; needed where the source does not tell
    time_unit     unit of the stored times; needed where neither source nor numbers tell
    chunk_events  about so many events a chunk

    Returns
    -------
    Recording     to be closed; a context manager

    Raises
    ------
    RecordingError   missing, empty, truncated, no event file, or inconsistent; one line that says what to do
    MissingExtra     the format needs ``pip install "evqr[formats]"``
    UsageError       an unknown unit
    TypeError        a source of another type
    """
    if time_unit is not None and time_unit not in PER_SECOND:
        raise UsageError(f"time unit {time_unit!r} is unknown; pass one of {', '.join(PER_SECOND)}")
    if chunk_events < 1:
        raise ValueError(f"chunk_events must be at least 1, got {chunk_events}")
    if isinstance(source, (str, os.PathLike)):
        path = os.fspath(source)
        opened = _open_file(path)
    else:
        path = ""
        opened = open_arrays(source)
    try:
        return Recording(opened, path=path, sensor=sensor, time_unit=time_unit, chunk_events=chunk_events)
    except BaseException:
        opened.close()
        raise


def _open_file(path: str) -> Source:
    return _recognise(path, _head(path))(path)


def _head(path: str) -> bytes:
    """First bytes of a file, with an error for whatever is no file with bytes in it."""
    place = Path(path)
    if not place.exists():
        raise RecordingError(f"{path}: no such file; check the path")
    if place.is_dir():
        raise RecordingError(f"{path}: is a directory; name a recording in it")
    if not place.is_file():
        raise RecordingError(f"{path}: is a pipe or a device, and files are read; save it to a file first")
    try:
        with open(path, "rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot be read ({error.strerror or error}); check its permissions"
        ) from error
    if not head:
        raise RecordingError(f"{path}: the file is empty (0 bytes); copy or record it again")
    return head


def _recognise(path: str, head: bytes) -> Callable[[str], Source]:
    """Which reader takes a file that starts like this; readers are imported only when needed."""
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        from .hdf5 import Hdf5Source as reader
    elif head.startswith(b"PK\x03\x04"):
        from .numpy_files import NpzSource as reader
    elif head.startswith(b"\x93NUMPY"):
        from .numpy_files import NpySource as reader
    elif head.startswith(b"#!AER-DAT4.0\r\n"):
        from .aedat4 import open_aedat4 as reader
    elif head.startswith(b"#ROSBAG V2.0\n"):
        from .rosbag import BagSource as reader
    elif advice := next((told for magic, told in UNSUPPORTED.items() if head.startswith(magic)), None):
        raise RecordingError(f"{path}: {advice}")
    elif _is_text(head):
        from .text import TextSource as reader
    elif _is_prophesee(head):
        from .prophesee import open_prophesee as reader
    else:
        raise RecordingError(
            f"{path}: not an event recording (starts with {head[:16]!r}); known are HDF5, npz, npy, text,"
            ' and with pip install "evqr[formats]" Prophesee RAW and DAT, AEDAT4, ROS 1 bag'
        )
    return reader


def _is_text(head: bytes) -> bool:
    """Whether it is printable, and its lines no longer than lines are."""
    printable = all(byte >= 0x20 or byte in b"\t\r\n" for byte in head)
    return printable and (b"\n" in head or len(head) < HEAD_BYTES)


def _is_prophesee(head: bytes) -> bool:
    """Whether there are header lines such as ``% evt 3.0`` before the data."""
    lines = [line[1:].strip().lower() for line in head.split(b"\n") if line.startswith(b"%")]
    keys = (b"evt", b"format", b"geometry", b"version", b"width", b"height")
    return head.startswith(b"%") and any(line.startswith(keys) for line in lines)
