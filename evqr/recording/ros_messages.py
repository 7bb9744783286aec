"""The two messages that event cameras send in ROS, taken apart as ROS 1 and ROS 2 (CDR) serialise them.

``EventArray``: header, height, width, events, each x, y, time, polarity.  ``EventPacket``: header, height,
width, seq, time_base, encoding, is_bigendian, bytes.  rosbags would make a Python object of every event; here
an array is made of all.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .source import RawColumns

PACKET, ARRAY = "packet", "array"

ROS1_EVENT = np.dtype([("x", "<u2"), ("y", "<u2"), ("s", "<u4"), ("ns", "<u4"), ("p", "u1")])
ROS1_EVENT_BYTES = ROS1_EVENT.itemsize
CDR_STRIDE = 16
"""CDR aligns s and ns to 4 bytes, and x and y to 2: from an event's s to the next event's s are 16 bytes."""

CDR_TIME = np.dtype([("s", "<u4"), ("ns", "<u4"), ("p", "u1"), ("pad", "V7")])
MONO_EVENT = np.dtype([("t", "<u4"), ("x", "<u2"), ("yp", "<u2")])


class Message(NamedTuple):
    """What both messages share.

    Attributes
    ----------
    width, height : int [px]
        Sensor size.
    time_base_ns : int
        Of a packet.
    encoding : str
        Of a packet; "" for an array.
    items : int
        Items that ``data`` holds: events, or bytes.
    data : bytes
        The serialised items.
    ros2 : bool
        Whether they are serialised as CDR.
    """

    width: int
    height: int
    time_base_ns: int
    encoding: str
    items: int
    data: bytes
    ros2: bool


class _Reader:
    """Reads numbers one after the other, aligned as CDR wants it, or not at all as in ROS 1."""

    def __init__(self, raw: bytes, at: int, aligned: bool) -> None:
        self.raw, self.start, self.at, self.aligned = raw, at, at, aligned

    def number(self, code: str) -> int:
        size = struct.calcsize(code)
        if self.aligned:
            self.at += -(self.at - self.start) % size
        (value,) = struct.unpack_from("<" + code, self.raw, self.at)
        self.at += size
        return value

    def text(self) -> str:
        length = self.number("I")
        value = self.raw[self.at : self.at + length]
        self.at += length
        return value.rstrip(b"\0").decode("ascii")


def parse(raw: bytes, layout: str, *, ros2: bool) -> Message:
    """Take a message apart; raises ValueError or struct.error for one that is cut."""
    if ros2 and (len(raw) < 4 or not raw[1] & 1):
        raise ValueError("a message is not in little-endian CDR")
    reader = _Reader(raw, 4 if ros2 else 0, ros2)
    if not ros2:
        reader.number("I")  # seq of the header
    reader.number("I")
    reader.number("I")
    reader.text()  # frame_id
    height, width = reader.number("I"), reader.number("I")
    time_base, encoding = 0, ""
    if layout == PACKET:
        reader.number("Q")
        time_base = reader.number("Q")
        encoding = reader.text()
        reader.number("B")
    count = reader.number("I")
    data = raw[reader.at :]
    if layout == PACKET:
        need = count
    else:
        need = (CDR_STRIDE * count - 3 if count else 0) if ros2 else ROS1_EVENT_BYTES * count
    if len(data) < need or (not ros2 and len(data) > need):
        raise ValueError(f"a message declares {count} items, which need {need} bytes, and holds {len(data)}")
    return Message(width, height, time_base, encoding, count, data[:need], ros2)


def array_columns(message: Message) -> RawColumns:
    """Events of an ``EventArray``, times in ns."""
    if not message.ros2:
        events = np.frombuffer(message.data, ROS1_EVENT)
        return RawColumns(_ns(events), events["x"], events["y"], events["p"])
    if not message.items:
        return RawColumns(*(np.empty(0, np.int64) for _ in range(4)))
    # x and y of the first event stand before its time; those of all others two bytes after the polarity
    # before.
    data = message.data + bytes(3)
    times = np.frombuffer(
        data[4 : 4 + CDR_STRIDE * message.items].ljust(CDR_STRIDE * message.items, b"\0"), CDR_TIME
    )
    places = np.frombuffer(data[: CDR_STRIDE * message.items].ljust(CDR_STRIDE * message.items, b"\0"), "<u2")
    places = places.reshape(message.items, CDR_STRIDE // 2)
    x, y = places[:, 0].copy(), places[:, 1].copy()
    x[1:] = places[:-1, 7]
    y[1:] = places[1:, 0]
    return RawColumns(_ns(times), x, y, times["p"])


def mono_columns(message: Message) -> RawColumns:
    """Events of an ``EventPacket`` in the encoding "mono", times in ns."""
    events = np.frombuffer(message.data, MONO_EVENT)
    t = events["t"].astype(np.int64) + message.time_base_ns
    return RawColumns(t, events["x"], events["yp"] & 0x7FFF, (events["yp"] >> 15).astype(np.uint8))


def _ns(events: NDArray[Any]) -> NDArray[np.int64]:
    return events["s"].astype(np.int64) * 1_000_000_000 + events["ns"]
