"""ROS 1 bags with event_camera_msgs/EventPacket (EVT3) or dvs_msgs/EventArray messages.

The bag is taken apart by the package rosbags, EVT3 packets by evt3 (extra ``formats``).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import RecordingError
from .extras import required
from .source import DeclaredUnit, RawChunks, RawColumns, Source, explained

PACKET_TYPE = "event_camera_msgs/msg/EventPacket"
ARRAY_TYPE = "dvs_msgs/msg/EventArray"

ARRAY_EVENT = np.dtype([("x", "<u2"), ("y", "<u2"), ("s", "<u4"), ("ns", "<u4"), ("p", "u1")])


class _Message(NamedTuple):
    """What both message types share, taken from their ROS 1 serialisation."""

    width: int
    height: int
    encoding: str  # "" for an EventArray
    data: bytes


class BagSource(Source):
    """All messages of the one event topic of a bag, in the order of the bag."""

    def __init__(self, path: str) -> None:
        self._rosbag1 = required("rosbags.rosbag1", path, "ROS bag")
        with explained(path, "ROS bag"), self._rosbag1.Reader(Path(path)) as bag:
            topics = [c for c in bag.connections if c.msgtype in (PACKET_TYPE, ARRAY_TYPE)]
            if len(topics) != 1:
                told = ", ".join(f"{c.topic} ({c.msgtype})" for c in topics or bag.connections) or "nothing"
                need = "one to read; filter the bag" if topics else "EventPacket or EventArray messages"
                raise RecordingError(f"{path}: bag has {told}; needs {need}")
            self._packets = topics[0].msgtype == PACKET_TYPE
            first = next(self._messages(bag), None)
        if first is None:
            raise RecordingError(f"{path}: the recording is empty: no message on {topics[0].topic}")
        if self._packets and first.encoding != "evt3":
            raise RecordingError(
                f"{path}: packets are encoded as {first.encoding!r}; only evt3 is read, convert the bag"
            )
        if self._packets:
            self._evt3 = required("evt3", path, "ROS bag with EVT3 packets")
        super().__init__(
            path,
            f"ROS bag {topics[0].msgtype.replace('/msg/', '/')} on {topics[0].topic}",
            sensor=(first.width, first.height),
            unit=DeclaredUnit("us", "EVT3 is in us")
            if self._packets
            else DeclaredUnit("ns", "ROS time is in ns"),
        )

    def _messages(self, bag: Any) -> Iterator[_Message]:
        for connection, _, raw in bag.messages():
            if connection.msgtype in (PACKET_TYPE, ARRAY_TYPE):
                yield _parse_packet(raw) if self._packets else _parse_array(raw)

    def raw_chunks(self, chunk_events: int) -> RawChunks:
        """Join messages until there are ``chunk_events``."""
        decoder = self._evt3.Decoder() if self._packets else None
        parts: list[RawColumns] = []
        with explained(self.name, "ROS bag"), self._rosbag1.Reader(Path(self.name)) as bag:
            for message in self._messages(bag):
                if decoder is None:
                    parts.append(_array_columns(np.frombuffer(message.data, ARRAY_EVENT)))
                else:
                    events = decoder.feed(message.data)
                    parts.append(RawColumns(events.timestamp, events.x, events.y, events.polarity))
                if sum(len(part.t) for part in parts) >= chunk_events:
                    yield _joined(parts)
                    parts = []
        if parts:
            yield _joined(parts)


def _joined(parts: list[RawColumns]) -> RawColumns:
    return RawColumns(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _array_columns(events: NDArray[Any]) -> RawColumns:
    t_ns = events["s"].astype(np.int64) * 1_000_000_000 + events["ns"]
    return RawColumns(t_ns, events["x"], events["y"], events["p"])


def _after_header(raw: bytes) -> int:
    """Offset after std_msgs/Header: seq, stamp, and a frame_id of any length."""
    return 16 + struct.unpack_from("<I", raw, 12)[0]


def _parse_packet(raw: bytes) -> _Message:
    """Take apart an EventPacket: height, width, seq, time_base, encoding, is_bigendian, events."""
    at = _after_header(raw)
    height, width, _, _, length = struct.unpack_from("<IIQQI", raw, at)
    at += struct.calcsize("<IIQQI")
    encoding = raw[at : at + length].decode("ascii")
    at += length + 1
    return _Message(width, height, encoding, _counted(raw, at, 1))


def _parse_array(raw: bytes) -> _Message:
    """Take apart an EventArray: height, width, events."""
    at = _after_header(raw)
    height, width = struct.unpack_from("<II", raw, at)
    return _Message(width, height, "", _counted(raw, at + 8, ARRAY_EVENT.itemsize))


def _counted(raw: bytes, at: int, item_bytes: int) -> bytes:
    """Return the bytes of a counted array that ends the message."""
    (count,) = struct.unpack_from("<I", raw, at)
    data = bytes(raw[at + 4 :])
    if len(data) != count * item_bytes:
        raise ValueError(f"a message declares {count} items and holds {len(data) / item_bytes:g}")
    return data
