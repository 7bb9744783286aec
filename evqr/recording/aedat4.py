"""AEDAT4 (iniVation DV), decoded packet by packet by eventcv (extra ``formats``)."""

from __future__ import annotations

import shutil
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path

from .extras import EventcvFile, slice_columns
from .source import DeclaredUnit, RawColumns, Source, explained

MAGIC = b"#!AER-DAT4.0\r\n"
ADDRESSES = 1 << 15, 1 << 15
DATA_TABLE_SLOT = 6  # of dataTablePosition in the FlatBuffers vtable of the IOHeader


class Aedat4Source(Source):
    """The event stream of an AEDAT4 file; frames, IMU and triggers are passed over."""

    def __init__(self, path: str) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._file = EventcvFile(path, ".aedat4", "AEDAT4", ADDRESSES)
        try:
            with explained(path, "AEDAT4 file"):
                n_events = self._file.open(1).n_events
                if n_events == 0:
                    self._leave_out_table(path)
                    n_events = self._file.open(1).n_events
                super().__init__(
                    path,
                    "AEDAT4",
                    sensor=self._file.sensor(),
                    n_events=n_events,
                    unit=DeclaredUnit("us", "the format is in us"),
                )
        except BaseException:
            self.close()
            raise

    def _leave_out_table(self, path: str) -> None:
        """Go on with a copy without the table of packets at the end of the file.

        Some versions of DV wrote tables that count no events.  Without a table eventcv counts them itself.
        """
        self._file.close()
        self._folder = tempfile.TemporaryDirectory(prefix="evqr-")
        copy = Path(self._folder.name) / "recording.aedat4"
        shutil.copyfile(path, copy)
        with open(copy, "r+b") as file:
            file.truncate(_table_position(file.read(1 << 16), copy.stat().st_size))
        self._file = EventcvFile(str(copy), ".aedat4", "AEDAT4", ADDRESSES)

    def raw_chunks(self, chunk_events: int) -> Iterator[RawColumns]:
        """Decode slices."""
        left = self.n_events or 0
        with explained(self.name, "AEDAT4 file"):
            reader = self._file.open(chunk_events)
        for i in range(reader.n_slices):
            with explained(self.name, "AEDAT4 file"):
                raw = slice_columns(reader, i, min(chunk_events, left), self.name)
            left -= len(raw.t)
            yield raw

    def close(self) -> None:
        """Remove link and copy, if any."""
        self._file.close()
        if self._folder is not None:
            self._folder.cleanup()


def _table_position(head: bytes, size: int) -> int:
    """Where the table of packets starts, by the IOHeader; ``size`` if there is none."""
    base = len(MAGIC) + 4  # after the length of the IOHeader
    table = base + struct.unpack_from("<I", head, base)[0]
    vtable = table - struct.unpack_from("<i", head, table)[0]
    (field,) = struct.unpack_from("<H", head, vtable + DATA_TABLE_SLOT)
    position = struct.unpack_from("<q", head, table + field)[0] if field else -1
    return position if 0 < position < size else size
