"""Prophesee RAW (EVT2, EVT2.1, EVT3, EVT4) and DAT: the header lines, and which decoder the data are for.

Header lines are ``% key value``.  They end at ``% end``, or else before the first line that does not begin
with a percent sign and a blank; that is the rule of the vendor's own reader (openeb, ``GenericHeader``), and
binary data may begin with a percent sign.  Decoders get data without header.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from ..errors import RecordingError
from .declared import DeclaredSensor, DeclaredUnit, Unclear, find_sensor, sensor_of
from .extras import required
from .faults import Faults
from .options import Asked
from .prophesee_dat import DatSource
from .prophesee_words import EVT2, EVT4, EVT21, EVT21_LEGACY, Words, WordSource
from .source import RawChunks, RawColumns, Source, explained
from .triggers import Edge, Evt3Edges

MAX_HEADER_BYTES = 1 << 16
EVT3_WORD_BYTES = 2
AT_ONCE_WORDS = 1 << 20

IN_US = DeclaredUnit("us", "the format is in us")

# Encoding and size of cameras whose older headers name only the system (openeb, psee_raw_file_header.cpp).
_VGA, _HD = (640, 480), (1280, 720)
SYSTEMS: dict[int, tuple[str, tuple[int, int]]] = {
    **dict.fromkeys(
        (0x15, 0x17, 0x97, 0x19, 0x99, 0x1C, 0x1D, 0x21, 0xA1, 0x22, 0xA2, 0x23, 0x29), ("EVT2", _VGA)
    ),
    **dict.fromkeys((0x1A, 0x1F, 0x27), ("EVT2", _HD)),
    0x28: ("EVT3", _VGA),
    **dict.fromkeys((0x1E, 0x2E, 0x30, 0x31, 0x32), ("EVT3", _HD)),
}
EVT21_NEWER_SYSTEMS = 0x37  # systems before it write EVT2.1 with the halves of words exchanged

NO_CONVERTER = (
    "export it as HDF5, DAT or CSV with the vendor's metavision_file_to_hdf5, metavision_file_to_dat or"
    " metavision_file_to_csv"
)


class PropheseeHeader:
    """The header lines of a RAW or DAT file.

    Attributes
    ----------
    encoding : str
        "EVT2", "EVT21", "EVT3", "EVT4", "DAT", or what else the file says it is.
    sensor : DeclaredSensor | Unclear | None
        Its size if the file tells, or the camera is one of known size.
    note : str
        Which the camera is, if that tells the size; else "".
    version : int
        Of DAT.
    swapped : bool
        Whether the halves of 64-bit words are exchanged.
    size : int
        Bytes up to the data.
    """

    def __init__(self, head: bytes) -> None:
        fields, self.size = parse_header(head)
        format, *pairs = fields.get("format", "").split(";")
        options = dict(pair.split("=", 1) for pair in pairs if "=" in pair)
        system = fields.get("system_id", "")
        known = SYSTEMS.get(int(system)) if system.isdecimal() else None
        self.note = ""
        self.encoding = _encoding(format, fields) or (known[0] if known else "unknown")
        self.sensor = _sensor(fields, options)
        if self.sensor is None and known:
            self.sensor = DeclaredSensor(known[1])
            self.note = (
                f"the sensor is taken as {known[1][0]}x{known[1][1]}: that of system {system} in the header"
            )
        version = fields.get("version", "").split(".")[0]
        self.version = int(version) if version.isdecimal() else 1
        endianness = options.get("endianness", fields.get("endianness", ""))
        older = system.isdecimal() and 0 < int(system) < EVT21_NEWER_SYSTEMS
        self.swapped = endianness == "legacy" if endianness else older


def parse_header(head: bytes) -> tuple[dict[str, str], int]:
    """Return the fields of the header lines, the first of each name, and the bytes up to the data."""
    fields: dict[str, str] = {}
    at = 0
    while head.startswith(b"% ", at):
        end = head.find(b"\n", at)
        if end < 0:
            break  # data that happen to begin with a percent sign and a blank
        # Any bytes may stand in a comment: names of people and places are in all languages.
        key, _, value = head[at + 2 : end].decode("utf-8", "replace").strip().partition(" ")
        at = end + 1
        if key.lower() == "end":
            break
        fields.setdefault(key.lower(), value.strip().lower())
    return fields, at


def _encoding(format: str, fields: dict[str, str]) -> str:
    if format:
        return format.strip().upper().replace(".", "").removesuffix("_0")
    if "evt" in fields:
        return f"EVT{fields['evt'].removesuffix('.0').replace('.', '')}"
    return "DAT" if fields.keys() & {"version", "width", "height"} else ""


def _sensor(fields: dict[str, str], options: dict[str, str]) -> DeclaredSensor | Unclear | None:
    if "geometry" in fields:
        found = sensor_of(fields["geometry"], "geometry")
        if isinstance(found, Unclear):
            return Unclear(f"header says the sensor is {fields['geometry']!r}, no WxH")
        return found
    return find_sensor(options) or find_sensor(fields)


def open_prophesee(path: str, asked: Asked) -> Source:
    """Open RAW or DAT, whichever the header says it is."""
    with explained(path, "Prophesee header"), open(path, "rb") as file:
        header = PropheseeHeader(file.read(MAX_HEADER_BYTES))
    if header.encoding == "EVT3":
        return Evt3Source(path, header)
    if header.encoding == "DAT":
        return DatSource(path, header.size, header.version, header.sensor)
    words: dict[str, Words] = {
        "EVT2": EVT2,
        "EVT21": EVT21_LEGACY if header.swapped else EVT21,
        "EVT4": EVT4,
    }
    if header.encoding not in words:
        raise RecordingError(
            f"{path}: Prophesee encoding {header.encoding} is not supported (EVT2, EVT2.1, EVT3, EVT4 are);"
            f" {NO_CONVERTER}"
        )
    return WordSource(
        path, words[header.encoding], header.size, header.sensor, (header.note,) * bool(header.note)
    )


class Evt3Source(Source):
    """EVT3, decoded by the package evt3 (extra ``formats``) as the bytes come."""

    def __init__(self, path: str, header: PropheseeHeader) -> None:
        notes = (header.note,) * bool(header.note)
        super().__init__(path, "Prophesee EVT3", sensor=header.sensor, unit=IN_US, notes=notes)
        self._evt3 = required("evt3", path, self.format)
        self._start = header.size

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Decode a word an event, which is about what scenes take."""
        decoder = self._evt3.Decoder()
        rest = (os.path.getsize(self.name) - self._start) % EVT3_WORD_BYTES
        with open(self.name, "rb") as file:
            file.seek(self._start)
            while data := file.read(chunk_events * EVT3_WORD_BYTES):
                with explained(self.name, "EVT3 data"):
                    events = decoder.feed(data[: len(data) - len(data) % EVT3_WORD_BYTES])
                yield RawColumns(events.timestamp, events.x, events.y, events.polarity)
        if rest:
            faults.cut(f"{rest} byte{'s' * (rest != 1)} after the last whole word of {EVT3_WORD_BYTES}")

    def edges(self) -> Iterator[Edge]:
        """All triggers."""
        edges = Evt3Edges()
        with open(self.name, "rb") as file:
            file.seek(self._start)
            while data := file.read(AT_ONCE_WORDS * EVT3_WORD_BYTES):
                yield from edges.among(np.frombuffer(data, "<u2", len(data) // EVT3_WORD_BYTES))
