"""Connections: to whoever listens, and again when they are lost."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading

import numpy as np
import pytest

from evqr.errors import UsageError
from evqr.live.connection import Connection
from evqr.live.packed_stream import PackedWriter
from evqr.live.pieces import Events, Idle, Interrupted, Sensor, TimePasses

QUICK = (0.005, 0.02)


class Camera:
    """Listens, and sends what it is told to each that connects, one after another."""

    def __init__(self, listening, sends):
        self._listening, self._sends = listening, sends
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        self._listening.listen()
        self._thread.start()
        return self

    def __exit__(self, *failure):
        self._thread.join(10)
        self._listening.close()

    def _run(self):
        for send in self._sends:
            connected, _ = self._listening.accept()
            with connected, connected.makefile("wb") as file:
                send(file)


def events_of(*times):
    def send(file):
        writer = PackedWriter(file, (64, 48))
        writer.events(times, np.zeros(len(times)), np.ones(len(times)), np.ones(len(times)))
        writer.time(times[-1] + 1)

    return send


def until(connection, last):
    """All pieces but idle ones, up to a certain one."""
    got = []
    for piece in connection.pieces():
        if not isinstance(piece, Idle):
            got.append(piece)
        if piece == last:
            connection.stop()
    return got


def kinds(pieces):
    return [type(piece) for piece in pieces]


def test_over_tcp_and_again_when_it_is_lost():
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        connection = Connection(f"tcp://127.0.0.1:{listening.getsockname()[1]}", retry_s=QUICK)
        with Camera(listening, [events_of(1, 2), lambda file: file.write(b"garbage"), events_of(7)]):
            got = until(connection, TimePasses(8))
    assert kinds(got) == [
        Sensor, Events, TimePasses, Interrupted, Interrupted, Sensor, Events, TimePasses
    ] or kinds(got) == [Sensor, Events, TimePasses, Interrupted, Sensor, Events, TimePasses]  # fmt: skip
    assert [piece.columns.t.tolist() for piece in got if isinstance(piece, Events)] == [[1, 2], [7]]


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="needs sockets in the file system")
def test_over_a_socket_in_the_file_system(tmp_path):
    path = tmp_path / "camera"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        with Camera(listening, [events_of(5)]):
            got = until(Connection(f"unix:{path}"), TimePasses(6))
    assert kinds(got) == [Sensor, Events, TimePasses]


def test_nobody_listens():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    connection = Connection(f"tcp://127.0.0.1:{port}", retry_s=QUICK)
    got = []
    for piece in connection.pieces():
        got.append(piece)
        if len(got) == 6:
            connection.stop()
    assert got == [Interrupted("Connection refused"), *[Idle()] * 5]


READS = """
import sys
from evqr.live.connection import Connection
print([type(piece).__name__ for piece in Connection("-").pieces() if type(piece).__name__ != "Idle"])
"""


@pytest.mark.parametrize("by", ["pipe", "file"])
def test_by_standard_input(tmp_path, by):
    path = tmp_path / "events"
    with open(path, "wb") as file:
        events_of(1, 2, 3)(file)
    with open(path, "rb") as file:
        given = {"stdin": file} if by == "file" else {"input": path.read_bytes()}
        read = subprocess.run([sys.executable, "-c", READS], capture_output=True, env=os.environ, **given)
    assert read.stdout.split() == [b"['Sensor',", b"'Events',", b"'TimePasses']"], read.stderr


@pytest.mark.parametrize(
    "where", ["tcp://", "tcp://host", "tcp://host:no", "unix:", "udp://host:1", "", "tcp://h:99999"]
)
def test_what_is_no_source(where):
    with pytest.raises(UsageError, match="is no source of events"):
        Connection(where)
