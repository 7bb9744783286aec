"""ROS bags, versions 1 and 2 (sqlite3 and MCAP), with one topic of events read.

A bag is taken apart by the package rosbags, EVT3 packets by evt3 (extra ``formats``).  Messages are known by
their layout, not by the name of their type alone, and belong together by topic: a node that was restarted
opens a connection of its own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RecordingError
from .bag_scan import ScannedBag, is_ros1, is_sqlite, lacks_index
from .declared import DeclaredSensor, DeclaredUnit
from .extras import required
from .faults import Faults
from .options import Asked
from .prophesee_words import EVT2, EVT4, EVT21, WordDecoder
from .ros_messages import ARRAY, PACKET, Message, array_columns, mono_columns, parse
from .source import RawChunks, RawColumns, Source, choose_stream, explained

# What drivers call these messages (package and type), and the fields of such a message without their names.
TYPES = {
    "event_camera_msgs/EventPacket": PACKET,
    "event_array_msgs/EventArray": PACKET,
    "dvs_msgs/EventArray": ARRAY,
    "prophesee_event_msgs/EventArray": ARRAY,
}
FIELDS = {
    ("Header", "uint32", "uint32", "uint64", "uint64", "string", "bool", "uint8[]"): PACKET,
    ("Header", "uint32", "uint32", "Event[]"): ARRAY,
}

MEND = "copy it again, or give it a new index: rosbag reindex, ros2 bag reindex, mcap recover"

WORDS = {"evt2": EVT2, "evt21": EVT21, "evt4": EVT4}
ENCODINGS = ("evt3", *WORDS, "mono")


class BagSource(Source):
    """All messages of one topic of a bag, in the order of the bag."""

    def __init__(self, path: str, asked: Asked) -> None:
        required("rosbags.rosbag1", path, "ROS bag")
        self._scanned = False
        with explained(path, "ROS bag", MEND):
            self._scanned = lacks_index(path)
        with explained(path, "ROS bag", MEND), self._opened(path) as (bag, self._ros2):
            layouts = {c.topic: layout for c in bag.connections if (layout := _layout(c))}
            if not layouts:
                has = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in bag.connections})) or "nothing"
                if self._scanned:
                    raise RecordingError(
                        f"{path}: ROS bag is truncated, and what is left of it has no event stream (it has:"
                        f" {has}); copy it again from where it was recorded"
                    )
                raise RecordingError(
                    f"{path}: no event stream in this bag (it has: {has}); needs messages of type EventPacket"
                    " or EventArray"
                )
            topics = sorted(layouts)
            self._topic = choose_stream(topics, asked.stream, path, "topic")
            self._layout = layouts[self._topic]
            kind = next(c.msgtype for c in bag.connections if c.topic == self._topic)
            first = next((message for _, message in self._messages(bag)), None)
        if first is None:
            what = "truncated before its first message" if self._scanned else "empty: no message"
            raise RecordingError(f"{path}: the recording is {what} on {self._topic}")
        if self._layout == PACKET and first.encoding not in ENCODINGS:
            raise RecordingError(
                f"{path}: packets are encoded as {first.encoding!r}; {', '.join(ENCODINGS)} are read,"
                " convert the bag"
            )
        if first.encoding == "evt3":
            self._evt3 = required("evt3", path, "ROS bag with EVT3 packets")
        in_ns = self._layout == ARRAY or first.encoding == "mono"
        super().__init__(
            path,
            f"ROS {'2 ' * self._ros2}bag {kind.replace('/msg/', '/')} on {self._topic}",
            sensor=DeclaredSensor((first.width, first.height)),
            unit=DeclaredUnit("ns", "ROS time is in ns")
            if in_ns
            else DeclaredUnit("us", f"{first.encoding.upper()} is in us"),
            stream=self._topic,
            streams=topics,
        )

    def _opened(self, path: str) -> AbstractContextManager[tuple[Any, bool]]:
        if self._scanned:
            return nullcontext((ScannedBag(path), not is_ros1(path)))
        return _opened(path)

    def _messages(self, bag: Any) -> Iterator[tuple[int, Message]]:
        """Give each message of the topic, with the number of its connection."""
        connections = [c for c in bag.connections if c.topic == self._topic and _layout(c) == self._layout]
        for connection, _, raw in bag.messages(connections):
            yield connection.id, parse(bytes(raw), self._layout, ros2=self._ros2)

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Join messages until there are ``chunk_events``."""
        decoders: dict[int, Any] = {}
        parts: list[RawColumns] = []
        with explained(self.name, "ROS bag", MEND), self._opened(self.name) as (bag, _):
            for connection, message in self._messages(bag):
                parts.append(self._columns(message, connection, decoders, faults))
                if sum(len(part.t) for part in parts) >= chunk_events:
                    yield _joined(parts)
                    parts = []
        if parts:
            yield _joined(parts)
        if self._scanned:
            faults.cut("the index at the end of the bag is missing")

    def _columns(
        self, message: Message, connection: int, decoders: dict[int, Any], faults: Faults
    ) -> RawColumns:
        if self._layout == ARRAY:
            return array_columns(message)
        if message.encoding == "mono":
            return mono_columns(message)
        # A node that was restarted sends from a clock of its own.
        decoder = decoders.get(connection)
        if decoder is None:
            words = WORDS.get(message.encoding)
            decoder = self._evt3.Decoder() if words is None else WordDecoder(words, faults)
            decoders[connection] = decoder
        events = decoder.feed(message.data)
        return (
            events
            if isinstance(events, RawColumns)
            else RawColumns(events.timestamp, events.x, events.y, events.polarity)
        )


@contextmanager
def _opened(path: str) -> Iterator[tuple[Any, bool]]:
    """Open a bag of either version; it has ``connections`` and ``messages``."""
    place = Path(path)
    if place.is_dir():
        from rosbags.rosbag2 import Reader

        with Reader(place) as bag:
            yield bag, True
        return
    if is_ros1(path):
        from rosbags.rosbag1 import Reader as Reader1

        with Reader1(place) as bag:
            yield bag, False
        return
    if is_sqlite(path):
        from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader as Storage
    else:
        from rosbags.rosbag2.storage_mcap import McapReader as Storage
    storage = Storage(place)
    storage.open()
    with closing(storage):
        yield storage, True


def _layout(connection: Any) -> str | None:
    """Layout of a connection's messages, by the name of the type or else by its definition."""
    package, _, rest = connection.msgtype.partition("/")
    named = TYPES.get(f"{package}/{rest.rsplit('/', 1)[-1]}")
    return named or FIELDS.get(_fields(connection.msgdef.data))


def _fields(definition: str) -> tuple[str, ...]:
    """Types of the fields of a message, without packages."""
    top = definition.split("\n===")[0]
    lines = (re.sub(r"#.*", "", line).split() for line in top.splitlines())
    return tuple(line[0].rsplit("/", 1)[-1] for line in lines if len(line) == 2 and "=" not in line[1])


def _joined(parts: list[RawColumns]) -> RawColumns:
    return RawColumns(*(np.concatenate(column) for column in zip(*parts, strict=True)))
