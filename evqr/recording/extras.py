"""The packages of the extra ``formats``, imported when a file needs them; what formats share of eventcv."""

from __future__ import annotations

import os
import tempfile
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from ..errors import MissingExtra, RecordingError
from .source import RawColumns


def required(module: str, path: str, what: str) -> ModuleType:
    """Import a package, or raise with the command that installs it."""
    try:
        return import_module(module)
    except ImportError as error:
        package = module.split(".")[0]
        raise MissingExtra(
            f'{path}: {what} needs the package {package}: pip install "evqr[formats]" ({error})'
        ) from error


class EventcvFile:
    """A file for eventcv, which goes by the suffix where we go by the content.

    eventcv drops events outside the sensor it is told.  So it is told the whole address range of the format,
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
            os.symlink(os.path.abspath(path), self.path)

    def open(self, chunk_events: int) -> Any:
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


def slice_columns(reader: Any, index: int, expected: int, path: str) -> RawColumns:
    """Decode one slice of an ``eventcv.EventReader``; refuse when events got lost on the way."""
    events = reader.slice(index).numpy()  # (E, 4): x, y, t, p
    if len(events) != expected:
        raise RecordingError(
            f"{path}: {expected - len(events):,} of {expected:,} events are undecodable or off any sensor;"
            " the file is damaged, copy it again"
        )
    return RawColumns(events[:, 2], events[:, 0], events[:, 1], events[:, 3])
