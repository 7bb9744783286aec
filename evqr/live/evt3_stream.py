"""EVT3 as a camera sends it, header and words: events by the package evt3, triggers beside them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from evqr.errors import RecordingError
from evqr.live.pieces import Events, Piece, Sensor, TriggerSeen
from evqr.recording.declared import DeclaredSensor
from evqr.recording.extras import required
from evqr.recording.prophesee import MAX_HEADER_BYTES, PropheseeHeader, parse_header
from evqr.recording.source import RawColumns, explained
from evqr.recording.triggers import Evt3Edges

WORD = np.dtype("<u2")
HEADER_END = b"% end\n"


class Evt3Decoder:
    """Decodes a stream as its bytes come.

    Parameters
    ----------
    name : str
        The source, for messages.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._evt3 = required("evt3", name, "EVT3")
        self._decoder = self._evt3.Decoder()
        self._head: bytes | None = b""  # until it is whole
        self._rest = b""
        self._edges = Evt3Edges()

    def feed(self, data: bytes) -> Iterator[Piece]:
        """Take bytes; give what is whole.

        Raises
        ------
        RecordingError
            They are no EVT3, or do not say of which sensor.
        """
        if self._head is not None:
            self._head += data
            found = self._header(self._head)
            if found is None:
                return
            sensor, data = found
            self._head = None
            yield sensor
        data = self._rest + data
        whole = len(data) - len(data) % WORD.itemsize
        data, self._rest = data[:whole], data[whole:]
        if not data:
            return
        for edge in self._edges.among(np.frombuffer(data, WORD)):
            yield TriggerSeen(*edge)
        with explained(self._name, "EVT3 data", "see what sends it"):
            events = self._decoder.feed(data)
        if len(events.timestamp):
            yield Events(RawColumns(events.timestamp, events.x, events.y, events.polarity))

    def _header(self, head: bytes) -> tuple[Sensor, bytes] | None:
        """Read the header; None while it is not whole."""
        if HEADER_END not in head:
            if len(head) > MAX_HEADER_BYTES:
                raise RecordingError(f"{self._name}: no end of the header in {len(head)} bytes; send '% end'")
            return None
        header = PropheseeHeader(head)
        _, size = parse_header(head)
        if header.encoding != "EVT3":
            said = header.encoding if header.encoding.isprintable() else ascii(header.encoding)
            raise RecordingError(f"{self._name}: sends {said}; only EVT3 can be read from a stream")
        if not isinstance(header.sensor, DeclaredSensor):
            raise RecordingError(f"{self._name}: its header has no size of the sensor; send '% geometry WxH'")
        width, height = header.sensor.size
        return Sensor(width, height), head[size:]
