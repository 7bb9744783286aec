"""What dv-processing hands over, decoded; and its streams over a network, without a camera."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("dv_processing", reason="extra 'live' is not installed")

from evqr.errors import RecordingError, UsageError
from evqr.live import inivation
from evqr.live.inivation import DvStream
from evqr.live.pieces import Events, Idle, Interrupted, Sensor, TriggerSeen

SENDS = """
import os, sys, time
import dv_processing as dv

ports, first = [int(port) for port in sys.argv[1:3]], int(sys.argv[3])
sys.stdin.readline()
writers = [
    dv.io.NetworkWriter("127.0.0.1", ports[0], dv.io.Stream.EventStream(0, "events", "camera", (64, 48))),
    dv.io.NetworkWriter("127.0.0.1", ports[1], dv.io.Stream.TriggerStream(0, "triggers", "camera")),
]
print("listening", flush=True)
while not all(writer.getClientCount() for writer in writers):
    time.sleep(0.002)
time.sleep(0.1)  # who only looked whether somebody is there has gone
while not all(writer.getClientCount() for writer in writers):
    time.sleep(0.002)
events = dv.EventStore()
for k in range(100):
    events.push_back(first + k, k % 64, k % 48, k % 2 == 1)
triggers = dv.TriggerPacket.TriggersVector()
for t, kind in ((first + 5, "EXTERNAL_SIGNAL_RISING_EDGE"), (first + 6, "APS_FRAME_START"),
                (first + 50, "EXTERNAL_SIGNAL_FALLING_EDGE")):
    triggers.append(dv.Trigger(t, getattr(dv.TriggerType, kind)))
writers[1].writeTriggers(triggers)
writers[0].writeEvents(events)
sys.stdin.read()
os._exit(0)  # as if it was killed: its writers wait for ever where they are to end in Python
"""


def free_ports(count):
    listening = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [each.getsockname()[1] for each in listening]
    for each in listening:
        each.close()
    return ports


class Sender:
    """A program that has a camera."""

    def __init__(self, ports, first):
        self._program = subprocess.Popen(
            [sys.executable, "-c", SENDS, *map(str, ports), str(first)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def begin(self):
        self._program.stdin.write("\n")
        self._program.stdin.flush()
        assert self._program.stdout.readline() == "listening\n"

    def end(self):
        self._program.communicate("", 10)

    def __enter__(self):
        return self

    def __exit__(self, *failure):
        self._program.kill()
        self._program.communicate()


def test_over_a_network_and_again_when_it_is_lost():
    ports = free_ports(2)
    stream = DvStream(f"dv://127.0.0.1:{ports[0]},{ports[1]}", retry_s=(0.01, 0.05))
    got = []
    with Sender(ports, 1_000) as sender, Sender(ports, 9_000) as other:
        following = other
        sender.begin()
        for piece in stream.pieces():
            if isinstance(piece, Idle):
                continue
            got.append(piece)
            session = {type(each) for each in got[-4:]}
            if session == {Sensor, Events, TriggerSeen}:
                sender.end()
                if following is None:
                    stream.stop()
            elif isinstance(piece, Interrupted) and following is not None:
                sender, following = following, None
                sender.begin()
    assert [each for each in got if isinstance(each, Sensor)] == [Sensor(64, 48)] * 2
    assert [each for each in got if isinstance(each, TriggerSeen)] == [
        TriggerSeen(begin + later, kind)
        for begin in (1_000, 9_000)
        for later, kind in ((5, "start"), (50, "end"))
    ]
    assert sum(isinstance(each, Interrupted) for each in got) == 1
    for begin, events in zip((1_000, 9_000), (each for each in got if isinstance(each, Events)), strict=True):
        t, x, y, p = (column.tolist() for column in events.columns)
        assert t == list(range(begin, begin + 100))
        assert (x[65], y[65], p[:3]) == (1, 17, [-1, 1, -1])
        assert [column.dtype for column in events.columns] == [np.int64, np.uint16, np.uint16, np.int8]


@pytest.mark.parametrize("greeting", [b"garbage of any length", b"", b"\x10\0\0"])
def test_who_speaks_otherwise_is_left(greeting):
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def answer():
            connected, _ = listening.accept()
            with connected:
                connected.sendall(greeting)

        answering = threading.Thread(target=answer)
        answering.start()
        stream = DvStream(f"dv://127.0.0.1:{listening.getsockname()[1]}")
        lost = next(stream.pieces())
        answering.join()
    assert isinstance(lost, Interrupted) and "streams of dv-processing do not" in lost.reason


def test_who_says_nothing_is_not_waited_for(monkeypatch):
    monkeypatch.setattr(inivation, "CONNECT_S", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        lost = next(DvStream(f"dv://127.0.0.1:{listening.getsockname()[1]}").pieces())
    assert lost == Interrupted("timed out")


def test_nobody_listens():
    (port,) = free_ports(1)
    assert next(DvStream(f"dv://127.0.0.1:{port}").pieces()) == Interrupted("Connection refused")


@pytest.mark.parametrize(
    "where", ["dv://", "dv://host", "dv://host:no", "dv://h:1,x", "dv://h:1,2,3", "dv://h:1,70000"]
)
def test_what_is_no_stream(where):
    with pytest.raises(UsageError, match="dv://HOST:PORT"):
        DvStream(where)


def test_a_stream_without_events_is_none():
    only_triggers = SimpleNamespace(
        getEventResolution=lambda: None, isEventStreamAvailable=lambda: False, isTriggerStreamAvailable=bool
    )
    with pytest.raises(RecordingError, match="has no events"):
        next(inivation.pieces_of([only_triggers], threading.Event()))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "/project/include/dv-processing/io/camera/discovery.hpp(88): dv::io::camera::open(...)\n"
            "RuntimeError: Could not find device with given serial number\nStacktrace:\n 0# 0x00 in dv.so\n",
            "Could not find device with given serial number",
        ),
        (
            "connect: Connection refused [system:111 at /vcpkg/reactive_socket_service.hpp:588]",
            "Connection refused",
        ),
        ("", "RuntimeError"),
    ],
)
def test_what_the_package_says_is_one_line(text, said):
    with pytest.raises(RecordingError) as refused, inivation.explained():
        raise RuntimeError(text)
    assert str(refused.value) == said


def test_cameras_are_listed():
    assert isinstance(inivation.listed(), list)
