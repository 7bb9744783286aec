"""Bags without an index, read record by record: those that were cut short, or never closed.

The index of a bag stands at its end, and readers want it.  What comes before are records, one behind the
other, some of them in chunks that may be compressed; of a chunk that is cut, what can still be taken out.
Layouts: http://wiki.ros.org/Bags/Format/2.0 and https://mcap.dev/spec.  In a bag of ROS 2 in sqlite3 the rows
are read as far as the database goes.
"""

from __future__ import annotations

import bz2
import io
import os
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeAlias

MAX_CHUNK_BYTES = 1 << 30
"""What a chunk may take when taken out; more is damage."""

MCAP_MAGIC = b"\x89MCAP0\r\n"


class Definition(NamedTuple):
    """A message definition, as rosbags has it.

    Attributes
    ----------
    data : str
        Its text.
    """

    data: str


class Connection(NamedTuple):
    """A topic with the type of its messages, as rosbags has it.

    Attributes
    ----------
    id : int
        Its number in the file.
    topic, msgtype : str
        Names.
    msgdef : Definition
        What a message holds.
    """

    id: int
    topic: str
    msgtype: str
    msgdef: Definition


class _Message(NamedTuple):
    connection: int
    time_ns: int
    data: bytes


_Found: TypeAlias = "Connection | _Message"


class ScannedBag:
    """A bag without an index, with what rosbags' readers have.

    Parameters
    ----------
    path : str
        A file of ROS 1, MCAP or sqlite3, or the folder of a bag of ROS 2.

    Attributes
    ----------
    connections : list of Connection
        As far as the file goes.
    """

    def __init__(self, path: str) -> None:
        self._files = _files_of(path)
        found = {one.id: one for one in self._scan() if isinstance(one, Connection)}
        self.connections = list(found.values())

    def messages(self, connections: list[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Give the messages of some connections, in the order of the file."""
        wanted = {connection.id: connection for connection in connections}
        for one in self._scan():
            if isinstance(one, _Message) and one.connection in wanted:
                yield wanted[one.connection], one.time_ns, one.data

    def _scan(self) -> Iterator[_Found]:
        for number, file in enumerate(self._files):
            first = number << 32  # numbers of connections are of one file
            for one in _scan_of(file)(file):
                if isinstance(one, Connection):
                    yield one._replace(id=first + one.id)
                else:
                    yield one._replace(connection=first + one.connection)


def lacks_index(path: str) -> bool:
    """Tell whether a bag ends before its index, as one does that was cut short or not closed.

    Parameters
    ----------
    path : str
        As of `ScannedBag`.
    """
    return any(_lacks_index(file) for file in _files_of(path))


def is_ros1(path: str) -> bool:
    """Tell whether a bag is one of ROS 1."""
    return _starts_with(path, b"#ROSBAG")


def is_sqlite(path: str) -> bool:
    """Tell whether a file of a bag of ROS 2 is a database."""
    return _starts_with(path, b"SQLite")


def _starts_with(path: str, magic: bytes) -> bool:
    if os.path.isdir(path):
        return False
    with open(path, "rb") as file:
        return file.read(len(magic)) == magic


def _files_of(path: str) -> list[str]:
    place = Path(path)
    if not place.is_dir():
        return [path]
    return sorted(str(file) for file in place.iterdir() if file.suffix in (".db3", ".mcap"))


def _lacks_index(path: str) -> bool:
    size = os.path.getsize(path)
    with open(path, "rb") as file:
        head = file.read(100)
        if head.startswith(b"SQLite"):
            page, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
            return size < pages * (page if page > 1 else 1 << 16)
        if head.startswith(MCAP_MAGIC):
            file.seek(max(size - len(MCAP_MAGIC), 1))
            return file.read() != MCAP_MAGIC
        return not _has_ros1_index(file, size)


def _scan_of(path: str) -> Callable[[str], Iterator[_Found]]:
    return _scan_sqlite if is_sqlite(path) else _scan_ros1 if is_ros1(path) else _scan_mcap


def _take(file: BinaryIO, size: int) -> bytes:
    data = file.read(size) if size <= MAX_CHUNK_BYTES else b""
    if len(data) < size:
        raise EOFError
    return data


# ---- ROS 1


def _scan_ros1(path: str) -> Iterator[_Found]:
    with open(path, "rb") as file:
        file.readline()
        yield from _records_ros1(file)


def _has_ros1_index(file: BinaryIO, size: int) -> bool:
    """Whether all of the index is there: records of which the header of the bag says where, and how many."""
    try:
        file.seek(0)
        file.readline()
        head = _fields(_take(file, *struct.unpack("<I", _take(file, 4))))
        (place,) = struct.unpack("<Q", head[b"index_pos"])
        count = sum(struct.unpack("<II", head[b"conn_count"] + head[b"chunk_count"]))
        file.seek(place)
        for _ in range(2 * count):  # of each the header and the data
            file.seek(*struct.unpack("<I", _take(file, 4)), os.SEEK_CUR)
        return 0 < place < size >= file.tell()
    except (EOFError, struct.error, KeyError):
        return False


def _records_ros1(file: BinaryIO) -> Iterator[_Found]:
    try:
        while size := file.read(4):
            header = _fields(_take(file, *struct.unpack("<I", size)))
            (length,) = struct.unpack("<I", _take(file, 4))
            kind = header[b"op"][0]
            if kind == 5:
                packed = file.read(min(length, MAX_CHUNK_BYTES))
                yield from _records_ros1(_unpacked(packed, header[b"compression"].decode()))
                if len(packed) < length:
                    return
                continue
            data = _take(file, length)
            if kind == 7:
                said = _fields(data)
                topic, msgtype = header[b"topic"].decode(), said[b"type"].decode()
                definition = Definition(said[b"message_definition"].decode(errors="replace"))
                yield Connection(*struct.unpack("<I", header[b"conn"]), topic, msgtype, definition)
            elif kind == 2:
                seconds, nanoseconds = struct.unpack("<II", header[b"time"])
                (connection,) = struct.unpack("<I", header[b"conn"])
                yield _Message(connection, 1_000_000_000 * seconds + nanoseconds, data)
    except (EOFError, struct.error, KeyError, IndexError):
        return  # what follows is lost


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Fields of a record's header: each a length and name=value."""
    found, at = {}, 0
    while at < len(header):
        (size,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + size].partition(b"=")
        found[name] = value
        at += 4 + size
    return found


# ---- MCAP


def _scan_mcap(path: str) -> Iterator[_Found]:
    with open(path, "rb") as file:
        file.read(len(MCAP_MAGIC))
        yield from _records_mcap(file, {})


def _records_mcap(file: BinaryIO, schemas: dict[int, tuple[str, str]]) -> Iterator[_Found]:
    try:
        while kind := file.read(1):
            (length,) = struct.unpack("<Q", _take(file, 8))
            if kind == b"\x06":
                head = _take(file, 28)
                compression = _text(file)
                (size,) = struct.unpack("<Q", _take(file, 8))
                packed = file.read(min(size, MAX_CHUNK_BYTES))
                yield from _records_mcap(_unpacked(packed, compression), schemas)
                if len(packed) < size or length != len(head) + 4 + len(compression) + 8 + size:
                    return
                continue
            if kind == b"\x02":
                return
            record = _unpacked(_take(file, length), "")
            if kind == b"\x01" and _text(record) != "ros2":
                return
            if kind == b"\x03":
                (schema,) = struct.unpack("<H", _take(record, 2))
                name, _ = _text(record), _text(record)
                schemas[schema] = name, _text(record)
            elif kind == b"\x04":
                channel, schema = struct.unpack("<HH", _take(record, 4))
                name, definition = schemas.get(schema, ("", ""))
                yield Connection(channel, _text(record), name, Definition(definition))
            elif kind == b"\x05":
                channel, _, _, published = struct.unpack("<HIQQ", _take(record, 22))
                yield _Message(channel, published, record.read())
    except (EOFError, struct.error):
        return  # what follows is lost


def _text(file: BinaryIO) -> str:
    (size,) = struct.unpack("<I", _take(file, 4))
    return _take(file, size).decode(errors="replace")


# ---- sqlite3


def _scan_sqlite(path: str) -> Iterator[_Found]:
    import sqlite3
    from urllib.parse import quote

    with closing(sqlite3.connect(f"file:{quote(path)}?mode=ro&immutable=1", uri=True)) as database:
        try:
            database.execute("PRAGMA writable_schema=ON")  # else a file that is too short is refused whole
            for key, name, msgtype in database.execute("SELECT id, name, type FROM topics"):
                yield Connection(key, name, msgtype, Definition(""))
            for row in database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY rowid"):
                yield _Message(*row)
        except sqlite3.DatabaseError:
            return  # what follows is lost


# ---- chunks


def _unpacked(packed: bytes, compression: str) -> BinaryIO:
    """Give the contents of a chunk, as far as they can be taken out."""
    if compression in ("", "none"):
        return io.BytesIO(packed)
    decompressor = _decompressor(compression)
    try:
        return io.BytesIO(decompressor.decompress(packed, max_length=MAX_CHUNK_BYTES))
    except Exception:  # each of the libraries has an error of its own for damage
        return io.BytesIO()


def _decompressor(compression: str) -> Any:
    """Give a decompressor that takes what there is and gives what comes of it."""
    if compression == "bz2":
        return bz2.BZ2Decompressor()
    if compression == "lz4":
        return import_module("lz4.frame").LZ4FrameDecompressor()
    if compression == "zstd":
        zstd = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
        return import_module(zstd).ZstdDecompressor()
    raise ValueError(f"chunks are compressed by {compression!r}, which is none of bz2, lz4, zstd")
