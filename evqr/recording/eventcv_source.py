"""What EVT2, DAT and AEDAT4 share: files that eventcv indexes once and decodes slice by slice."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from ..errors import RecordingError
from .extras import required
from .source import DeclaredUnit, RawChunks, RawColumns, Source, explained

IN_US = DeclaredUnit("us", "the format is in us")


class EventcvFile:
    """A file as eventcv wants it.

    eventcv goes by the suffix where we go by the content, so the file may need a link with the right suffix.
    And it drops events outside the sensor it is told, so it is told all addresses that the format can hold,
    and it is `columns.ColumnChecker` that meets the events outside the sensor.
    """

    def __init__(self, path: str, suffix: str, what: str, addresses: tuple[int, int]) -> None:
        self._eventcv = required("eventcv", path, what)
        self._addresses = addresses
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self.path = path
        if Path(path).suffix != suffix:
            self._folder = tempfile.TemporaryDirectory(prefix="evqr-")
            self.path = os.path.join(self._folder.name, f"recording{suffix}")
            try:
                os.symlink(os.path.abspath(path), self.path)
            except OSError:  # Windows lets only some users link
                shutil.copyfile(path, self.path)

    def reader(self, chunk_events: int) -> Any:
        """Return an ``eventcv.EventReader`` with slices of so many events."""
        return self._eventcv.open(
            self.path, time_unit="us", sensor_size=self._addresses, max_events=chunk_events
        )

    def sensor(self) -> tuple[int, int]:
        """Sensor size by the file's own header."""
        width, height = self._eventcv.open(self.path, time_unit="us").sensor_size
        return width, height

    def close(self) -> None:
        """Remove the link, if there is one."""
        if self._folder is not None:
            self._folder.cleanup()


class EventcvSource(Source):
    """Slices of an `EventcvFile`, which is closed with it."""

    def __init__(self, file: EventcvFile, name: str, format: str, sensor: tuple[int, int] | None) -> None:
        self._file = file
        with explained(name, f"{format} data"):
            n_events = file.reader(1).n_events
        super().__init__(name, format, sensor=sensor, n_events=n_events, unit=IN_US)

    def raw_chunks(self, chunk_events: int) -> RawChunks:
        """Decode slices of ``chunk_events``."""
        left = self.n_events or 0
        with explained(self.name, f"{self.format} data"):
            reader = self._file.reader(chunk_events)
        for i in range(reader.n_slices):
            with explained(self.name, f"{self.format} data"):
                raw = slice_columns(reader, i, min(chunk_events, left), self.name)
            left -= len(raw.t)
            yield raw

    def raw_tail(self, count: int) -> RawColumns | None:
        """Decode the last slice, which may be shorter than ``count``."""
        if not self.n_events:
            return None
        with explained(self.name, f"{self.format} data"):
            reader = self._file.reader(count)
            return slice_columns(reader, reader.n_slices - 1, (self.n_events - 1) % count + 1, self.name)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def slice_columns(reader: Any, index: int, expected: int, path: str) -> RawColumns:
    """Decode one slice of an ``eventcv.EventReader``; refuse when events got lost on the way."""
    events = reader.slice(index).numpy()  # (E, 4): x, y, t, p
    if len(events) != expected:
        raise RecordingError(
            f"{path}: {expected - len(events):,} of {expected:,} events are undecodable or off any sensor;"
            " the file is damaged, copy it again"
        )
    return RawColumns(events[:, 2], events[:, 0], events[:, 1], events[:, 3])
