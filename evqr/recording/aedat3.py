"""AEDAT 3.0 and 3.1 (cAER, DV before 2019), decoded here: no package on PyPI that was tried reads them.

Text lines up to ``#!END-HEADER``, then packets: a header of 28 bytes and events of one type from one source.
A polarity event is two words: validity (1 bit), polarity (1), y (15) and x (15), from the upper left corner;
and the lower 31 bits of the time [us], whose upper ones the packet's header has.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import RecordingError
from .declared import DeclaredSensor, DeclaredUnit
from .faults import Faults
from .options import Asked
from .source import RawChunks, RawColumns, Source, choose_stream, explained

END_OF_HEADER = b"#!END-HEADER\r\n"
MAX_HEADER_BYTES = 1 << 16
MAX_PACKET_BYTES = 1 << 28
PACKET = struct.Struct("<hhiiiiii")
POLARITY = 1
EVENT = np.dtype([("place", "<u4"), ("t", "<i4")])

SENSORS = {"DVS128": (128, 128), "DAVIS128": (128, 128), "DAVIS208": (208, 192), "DAVIS240": (240, 180),
           "DAVIS346": (346, 260), "DAVIS640": (640, 480), "DAVISHET640": (640, 480)}  # fmt: skip


class _Packet(NamedTuple):
    kind: int
    source: int
    size: int
    ts_offset: int
    ts_overflow: int
    capacity: int
    number: int
    valid: int


class Aedat3Source(Source):
    """The polarity events of one source of an AEDAT 3 file."""

    def __init__(self, path: str, asked: Asked) -> None:
        with open(path, "rb") as file:
            head = file.read(MAX_HEADER_BYTES)
        text, end, _ = head.partition(END_OF_HEADER)
        lines = text.decode("latin-1")
        self._start = len(text) + len(end)
        format = re.search(r"^#\s*Format:\s*(\S+)", lines, re.MULTILINE)
        if not end or (format and format[1] != "RAW"):
            problem = f"its packets are {format[1]}" if end and format else "its header does not end"
            raise RecordingError(f"{path}: AEDAT 3 is read as cAER writes it in format RAW, and {problem}")
        named = dict(re.findall(r"^#\s*Source (\d+):\s*(\S+)", lines, re.MULTILINE))
        with explained(path, "AEDAT 3 file"):
            sources = sorted(
                {p.source for p, _ in self._packets(path, None) if p.kind == POLARITY and p.number}
            )
        if not sources:
            raise RecordingError(f"{path}: no event stream in this file: it has no packet of polarity events")
        names = {str(source): source for source in sources}
        stream = choose_stream(list(names), asked.stream, path, "source")
        self._source = names[stream]
        chip = named.get(stream, "")
        size = next((size for name, size in SENSORS.items() if chip.upper().startswith(name)), None)
        super().__init__(
            path,
            "AEDAT 3",
            sensor=None if size is None else DeclaredSensor(size),
            unit=DeclaredUnit("us", "the format is in us"),
            stream=stream,
            streams=list(names),
        )

    def _packets(self, path: str, faults: Faults | None) -> Iterator[tuple[_Packet, bytes]]:
        """Give the packets; without ``faults`` their headers alone, and a cut end is passed over."""
        with open(path, "rb") as file:
            file.seek(self._start)
            while head := file.read(PACKET.size):
                if len(head) == PACKET.size:
                    packet = _Packet(*PACKET.unpack(head))
                    length = packet.size * packet.capacity
                    if not (0 <= packet.number <= packet.capacity and 0 < length <= MAX_PACKET_BYTES):
                        raise ValueError(f"a packet of {packet.number} events of {packet.size} bytes")
                    data = file.read(length)
                    if len(data) == length:
                        yield packet, data
                        continue
                if faults is not None:
                    faults.cut("its last packet is not whole")
                return

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Give packets joined until there are ``chunk_events``."""
        parts: list[RawColumns] = []
        with explained(self.name, "AEDAT 3 file"):
            for packet, data in self._packets(self.name, faults):
                if packet.kind == POLARITY and packet.source == self._source:
                    if packet.size != EVENT.itemsize:
                        raise ValueError(f"polarity events of {packet.size} bytes")
                    parts.append(_columns(np.frombuffer(data, EVENT, packet.number), packet.ts_overflow))
                    if sum(len(part.t) for part in parts) >= chunk_events:
                        yield from _joined(parts, chunk_events)
                        parts = []
        if parts:
            yield from _joined(parts, chunk_events)


def _columns(events: NDArray[Any], ts_overflow: int) -> RawColumns:
    events = events[events["place"] & 1 == 1]  # those that a filter took out are marked as not valid
    place = events["place"]
    t = events["t"].astype(np.int64) + (ts_overflow << 31)
    x, y = (place >> 17).astype(np.uint16), (place >> 2 & 0x7FFF).astype(np.uint16)
    return RawColumns(t, x, y, (place >> 1 & 1).astype(np.uint8))


def _joined(parts: list[RawColumns], chunk_events: int) -> Iterator[RawColumns]:
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    for i in range(0, len(joined[0]), chunk_events):
        yield RawColumns(*(column[i : i + chunk_events] for column in joined))
