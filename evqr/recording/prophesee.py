"""Prophesee RAW (EVT2, EVT3) and DAT, decoded by the packages evt3 and eventcv (extra ``formats``).

All start with header lines ``% key value``, which are read here: the decoders would take EVT2 words for EVT3
without an error, or go by the name of the file.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from ..errors import RecordingError
from .eventcv_source import IN_US, EventcvFile, EventcvSource, slice_columns
from .extras import required
from .source import RawChunks, RawColumns, Source, explained

MAX_HEADER_BYTES = 1 << 16

EVT3_WORD_BYTES = 2
EVT2_WORD_BYTES = 4
DAT_RECORD_BYTES = 8
DAT_TYPE_BYTES = 2  # event type and event size, between header and records

EVT2_ADDRESSES = 1 << 11, 1 << 11
DAT_ADDRESSES = 1 << 14, 1 << 14


class PropheseeHeader:
    """The header lines of a RAW or DAT file.

    Attributes
    ----------
    encoding   "EVT2", "EVT3", "DAT", or what else the file says it is
    sensor     (width, height) if the file tells, else None
    size       bytes up to the data
    """

    def __init__(self, path: str) -> None:
        with open(path, "rb") as file:
            head = file.read(MAX_HEADER_BYTES)
        fields: dict[str, str] = {}
        self.size = 0
        while head.startswith(b"%", self.size):
            end = head.find(b"\n", self.size)
            if end < 0 or not head[self.size : end].isascii():
                break  # data, whose first byte happens to be a "%"
            key, _, value = head[self.size + 1 : end].decode("ascii").strip().partition(" ")
            fields.setdefault(key.lower(), value.strip().lower())
            self.size = end + 1
            if key == "end":
                break
        self.encoding = _encoding(fields)
        self.sensor = _sensor(fields, path)


def _encoding(fields: dict[str, str]) -> str:
    if "format" in fields:
        return fields["format"].split(";")[0].upper()
    if "evt" in fields:
        return f"EVT{fields['evt'].removesuffix('.0')}"
    return "DAT" if fields.keys() & {"version", "width", "height"} else "unknown"


def _sensor(fields: dict[str, str], path: str) -> tuple[int, int] | None:
    parts = (option.partition("=") for option in fields.get("format", "").split(";"))
    options = {key: value for key, _, value in parts}
    if "geometry" in fields:
        sides = fields["geometry"].split("x")
    elif {"width", "height"} <= options.keys():
        sides = [options["width"], options["height"]]
    elif {"width", "height"} <= fields.keys():
        sides = [fields["width"], fields["height"]]
    else:
        return None
    if len(sides) != 2 or not all(side.isdecimal() for side in sides):
        raise RecordingError(
            f"{path}: header says the sensor is {'x'.join(sides)!r}, no WxH; copy the file again"
        )
    return int(sides[0]), int(sides[1])


def open_prophesee(path: str) -> Source:
    """Open RAW or DAT, whichever the header says it is."""
    with explained(path, "Prophesee header"):
        header = PropheseeHeader(path)
    openers = {"EVT3": Evt3Source, "EVT2": open_evt2, "DAT": DatSource}
    if header.encoding not in openers:
        raise RecordingError(
            f"{path}: Prophesee encoding {header.encoding} is not supported; convert the recording to EVT3"
        )
    return openers[header.encoding](path, header)


def _words(path: str, start: int, word_bytes: int) -> int:
    """How many words there are from ``start`` to the end, with an error when the last one is cut."""
    words, rest = divmod(os.path.getsize(path) - start, word_bytes)
    if rest or words < 0:
        raise RecordingError(
            f"{path}: truncated: {rest} bytes after the last whole word of {word_bytes}; copy the file again"
        )
    return words


class Evt3Source(Source):
    """EVT3, decoded as the bytes come."""

    def __init__(self, path: str, header: PropheseeHeader) -> None:
        super().__init__(path, "Prophesee EVT3", sensor=header.sensor, unit=IN_US)
        self._evt3 = required("evt3", path, self.format)
        self._start = header.size
        _words(path, self._start, EVT3_WORD_BYTES)

    def raw_chunks(self, chunk_events: int) -> RawChunks:
        """Decode a word an event, which is about what scenes take."""
        decoder = self._evt3.Decoder()
        with open(self.name, "rb") as file:
            file.seek(self._start)
            while data := file.read(chunk_events * EVT3_WORD_BYTES):
                with explained(self.name, "EVT3 data"):
                    events = decoder.feed(data)
                yield RawColumns(events.timestamp, events.x, events.y, events.polarity)


def open_evt2(path: str, header: PropheseeHeader) -> Source:
    """Open EVT2: mapped into memory by eventcv, decoded a slice at a time."""
    _words(path, header.size, EVT2_WORD_BYTES)
    file = EventcvFile(path, ".raw", "Prophesee EVT2", EVT2_ADDRESSES)
    try:
        return EventcvSource(file, path, "Prophesee EVT2", header.sensor)
    except BaseException:
        file.close()
        raise


class DatSource(Source):
    """DAT version 2.

    eventcv reads a DAT file as a whole.  The records being alike and independent, it is given pieces of the
    file, each with the header before it, and memory stays bounded.
    """

    def __init__(self, path: str, header: PropheseeHeader) -> None:
        self._start = header.size + DAT_TYPE_BYTES
        n_events = _words(path, self._start, DAT_RECORD_BYTES)
        super().__init__(path, "Prophesee DAT", sensor=header.sensor, n_events=n_events, unit=IN_US)
        required("eventcv", path, self.format)
        self._folder = tempfile.TemporaryDirectory(prefix="evqr-")

    def raw_chunks(self, chunk_events: int) -> RawChunks:
        """Decode pieces of ``chunk_events`` records."""
        piece = Path(self._folder.name) / "piece.dat"
        with open(self.name, "rb") as file:
            head = file.read(self._start)
            while records := file.read(chunk_events * DAT_RECORD_BYTES):
                piece.write_bytes(head + records)
                with explained(self.name, "DAT data"):
                    reader = EventcvFile(str(piece), ".dat", self.format, DAT_ADDRESSES).reader(chunk_events)
                    raw = slice_columns(reader, 0, len(records) // DAT_RECORD_BYTES, self.name)
                yield raw

    def close(self) -> None:
        """Remove the last piece."""
        self._folder.cleanup()
