"""AEDAT4 (iniVation DV), decoded packet by packet by eventcv (extra ``formats``).

Only the events are read; frames, IMU samples and triggers are passed over.
"""

from __future__ import annotations

import shutil
import struct
import tempfile
from pathlib import Path

from .eventcv_source import EventcvFile, EventcvSource
from .source import Source, explained

MAGIC = b"#!AER-DAT4.0\r\n"
SUFFIX = ".aedat4"
ADDRESSES = 1 << 15, 1 << 15
TABLE_POSITION_SLOT = 6  # of dataTablePosition in the vtable of the IOHeader, a FlatBuffer


def open_aedat4(path: str) -> Source:
    """Open an AEDAT4 file."""
    file = EventcvFile(path, SUFFIX, "AEDAT4", ADDRESSES)
    try:
        with explained(path, "AEDAT4 file"):
            if file.reader(1).n_events == 0:
                file.close()
                file = _FileWithoutTable(path)
            sensor = file.sensor()
        return EventcvSource(file, path, "AEDAT4", sensor)
    except BaseException:
        file.close()
        raise


class _FileWithoutTable(EventcvFile):
    """A copy without the table of packets at the end.

    Some versions of DV wrote tables that count no events, and eventcv believes them.  Without a table it
    counts the events itself.
    """

    def __init__(self, path: str) -> None:
        folder = tempfile.TemporaryDirectory(prefix="evqr-")
        copy = Path(folder.name) / f"recording{SUFFIX}"
        try:
            shutil.copyfile(path, copy)
            with open(copy, "r+b") as file:
                file.truncate(_table_position(file.read(1 << 16), copy.stat().st_size))
            super().__init__(str(copy), SUFFIX, "AEDAT4", ADDRESSES)
        except BaseException:
            folder.cleanup()
            raise
        self._folder = folder


def _table_position(head: bytes, size: int) -> int:
    """Where the table of packets starts, by the IOHeader; ``size`` if there is none."""
    base = len(MAGIC) + 4  # after the length of the IOHeader
    table = base + struct.unpack_from("<I", head, base)[0]
    vtable = table - struct.unpack_from("<i", head, table)[0]
    (field,) = struct.unpack_from("<H", head, vtable + TABLE_POSITION_SLOT)
    position = struct.unpack_from("<q", head, table + field)[0] if field else -1
    return position if 0 < position < size else size
