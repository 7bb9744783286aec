"""AEDAT4 (iniVation DV), decoded packet by packet by the package aedat (extra ``formats``).

Events and triggers are read; frames and IMU samples are passed over.  A file may hold several event
streams, of several cameras or of steps of a filter; which is which only the XML in its header tells.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..errors import RecordingError
from .declared import DeclaredSensor, DeclaredUnit
from .extras import required
from .faults import Faults
from .options import Asked
from .source import RawChunks, RawColumns, Source, choose_stream, explained
from .triggers import AEDAT4_SOURCES, Edge

MAGIC_BYTES = 14  # "#!AER-DAT4.0\r\n"
MAX_HEADER_BYTES = 1 << 20
CUT_SHORT = "failed to fill whole buffer"  # what aedat says of a packet that ends with the file


class Aedat4Source(Source):
    """One event stream of an AEDAT4 file."""

    def __init__(self, path: str, asked: Asked) -> None:
        self._aedat = required("aedat", path, "AEDAT4")
        with explained(path, "AEDAT4 file"):
            outputs = _outputs(path)  # before the decoder, which panics at damaged XML
            streams: dict[int, Any] = self._aedat.Decoder(path).id_to_stream()
            names = _names(outputs, sorted(n for n, stream in streams.items() if stream["type"] == "events"))
        if not names:
            has = ", ".join(sorted({stream["type"] for stream in streams.values()})) or "nothing"
            raise RecordingError(f"{path}: no event stream in this file (it has: {has}); record events too")
        stream = choose_stream(list(names), asked.stream, path, "stream")
        self._id = names[stream]
        size = streams[self._id]["width"], streams[self._id]["height"]
        super().__init__(
            path,
            "AEDAT4",
            sensor=DeclaredSensor(size),
            unit=DeclaredUnit("us", "the format is in us"),
            stream=stream,
            streams=list(names),
        )

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Join packets until there are ``chunk_events``."""
        parts: list[Any] = []
        held = 0
        for events in self._packets(faults):
            parts.append(events)
            held += len(events)
            while held >= chunk_events:
                joined = np.concatenate(parts)
                yield _columns(joined[:chunk_events])
                parts, held = [joined[chunk_events:]], held - chunk_events
        if held:
            yield _columns(np.concatenate(parts))

    def edges(self) -> Iterator[Edge]:
        """All triggers of external signals, of whichever stream."""
        for packet in self._all_packets(Faults(self.name)):
            if "triggers" in packet:
                for t_us, source in packet["triggers"][["t", "source"]].tolist():
                    if source in AEDAT4_SOURCES:
                        yield Edge(t_us, AEDAT4_SOURCES[source])

    def _packets(self, faults: Faults) -> Iterator[Any]:
        for packet in self._all_packets(faults):
            if packet["stream_id"] == self._id and "events" in packet:
                yield packet["events"]

    def _all_packets(self, faults: Faults) -> Iterator[Any]:
        with explained(self.name, "AEDAT4 file"):
            packets = iter(self._aedat.Decoder(self.name))
            while True:
                try:
                    packet = next(packets, None)
                except RuntimeError as error:
                    if CUT_SHORT not in str(error):
                        raise
                    faults.cut("its last packet is not whole")
                    return
                if packet is None:
                    return
                yield packet


def _columns(events: Any) -> RawColumns:
    return RawColumns(events["t"].astype(np.int64), events["x"], events["y"], events["on"])


def _outputs(path: str) -> dict[int, tuple[str, str]]:
    """Camera and output of each stream by the XML in the header; raises ValueError or ParseError without."""
    with open(path, "rb") as file:
        head = file.read(MAX_HEADER_BYTES)
    (length,) = struct.unpack_from("<I", head, MAGIC_BYTES)
    head = head[: MAGIC_BYTES + 4 + length]
    start, end = head.find(b"<dv"), head.rfind(b"</dv>")
    if not 0 <= start < end:
        raise ValueError("its header does not describe its streams")
    outputs = {}
    for node in ElementTree.fromstring(head[start : end + 5]).iterfind("./node[@name='outInfo']/node"):
        output = node.findtext("./attr[@key='originalOutputName']") or ""
        source = node.findtext("./node[@name='info']/attr[@key='source']") or ""
        if str(node.get("name")).isdecimal():
            outputs[int(str(node.get("name")))] = source, output
    return outputs


def _names(outputs: dict[int, tuple[str, str]], ids: list[int]) -> dict[str, int]:
    """Name event streams by their outputs; where these are alike by camera and output, or else by number."""
    names = [outputs.get(number, ("", ""))[1] for number in ids]
    if len(set(names)) < len(names) or not all(names):
        names = ["/".join(outputs.get(number, ("", ""))) for number in ids]
    if len(set(names)) < len(names):
        names = [str(number) for number in ids]
    return dict(zip(names, ids, strict=True))
