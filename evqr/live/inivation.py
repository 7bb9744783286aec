"""Cameras and streams that dv-processing (extra ``live``) gives access to: what it hands over, decoded."""

from __future__ import annotations

import re
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from types import ModuleType
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from evqr.errors import RecordingError, UsageError
from evqr.extras import needs_extra
from evqr.live.pieces import Events, Idle, Piece, Sensor, TriggerSeen
from evqr.live.source import IDLE_S, RETRY_S, Reopened
from evqr.recording.source import RawColumns
from evqr.recording.triggers import AEDAT4_SOURCES

POLL_S = 0.001
"""How often it is asked for more where nothing has come [s]."""

CONNECT_S = 5.0

GREETING = b"IOHE"
"""What a stream's first message says it is, behind the length and an offset."""

SCHEME = "dv://HOST:PORT[,PORT OF TRIGGERS]"


def dv_processing(doing: str) -> ModuleType:
    """Import the package, or say how to install it."""
    with needs_extra(doing, "dv-processing", "live"):
        import dv_processing  # pyright: ignore[reportMissingImports]
    return dv_processing


def events_of(store: Any) -> Events:
    """Decode an ``EventStore``."""
    events = store.numpy()
    p = np.where(events["polarity"] > 0, np.int8(1), np.int8(-1))
    x, y = (events[name].astype(np.uint16) for name in "xy")
    return Events(RawColumns(events["timestamp"].astype(np.int64), x, y, p))


def triggers_of(batch: Any) -> Iterator[TriggerSeen]:
    """Decode a batch of triggers; one that rises opens a gate, and one that falls closes it."""
    for trigger in batch:
        kind = AEDAT4_SOURCES.get(int(trigger.type.value))
        if kind is not None:
            yield TriggerSeen(int(trigger.timestamp), kind)


def pieces_of(inputs: Sequence[Any], stopped: threading.Event) -> Iterator[Piece]:
    """Give what comes from the inputs of one camera, until one of them ends.

    Parameters
    ----------
    inputs : sequence of dv_processing.io.InputBase
        A camera, or connections of which one has its events.
    stopped : threading.Event
        Ends it.

    Yields
    ------
    piece : Piece
        The size of the sensor first.

    Raises
    ------
    RecordingError
        There are no events.
    """
    with_events = [each for each in inputs if each.isEventStreamAvailable()]
    size = with_events[0].getEventResolution() if with_events else None
    if size is None:
        raise RecordingError("it has no events; choose the stream of a camera's events")
    yield Sensor(int(size[0]), int(size[1]))
    with_triggers = [each for each in inputs if each.isTriggerStreamAvailable()]
    quiet_since = time.monotonic()
    while not stopped.is_set():
        over = not all(each.isRunning() for each in inputs)  # asked first: what came before its end is taken
        came = False
        for each in with_triggers:
            if (triggers := each.getNextTriggerBatch()) is not None:
                came = True
                yield from triggers_of(triggers)
        for each in with_events:
            if (events := each.getNextEventBatch()) is not None:
                came = True
                yield events_of(events)
        now = time.monotonic()
        if came:
            quiet_since = now
            continue
        if over:
            return
        if now - quiet_since >= IDLE_S:
            quiet_since = now
            yield Idle()
        stopped.wait(POLL_S)


@contextmanager
def explained() -> Iterator[None]:
    """Turn what the package raises into an error of one line."""
    try:
        yield
    except (RuntimeError, IndexError, ValueError) as error:
        text = str(error)
        said = re.search(r"^\w*(?:Error|Exception|Argument): (.*)$", text, re.MULTILINE)
        text = (said[1] if said else text).partition(" [system:")[0].partition("\n")[0]
        raise RecordingError(text.removeprefix("connect: ") or type(error).__name__) from error


class DvStream(Reopened):
    """What somebody sends over a network with dv-processing, as its ``NetworkWriter`` does, or with DV.

    A connection has one stream: that of a camera's triggers is another one.

    Parameters
    ----------
    where : str
        ``dv://HOST:PORT``, or with a second port, of the triggers, ``dv://HOST:PORT,PORT``.
    retry_s : (float, float) [s]
        First and longest time between two tries to connect.

    Raises
    ------
    UsageError
        It is none of these.
    MissingExtra
        The package is not installed.
    """

    def __init__(self, where: str, *, retry_s: tuple[float, float] = RETRY_S) -> None:
        super().__init__(where, retry_s)
        self._places = _places(where)
        self._dv = dv_processing(where)

    @staticmethod
    def meant(where: str) -> bool:
        """Whether a text names such a source."""
        return where.startswith("dv://")

    def _opened(self) -> Iterator[Piece]:
        for place in self._places:
            _greeted(*place)
        with explained():
            inputs = [self._dv.io.NetworkReader(host, port) for host, port in self._places]
        yield from pieces_of(inputs, self._stopped)


def _places(where: str) -> list[tuple[str, int]]:
    try:
        first, *others = where.split(",")
        parts = urlsplit(first)
        if parts.hostname and parts.port and len(others) <= 1:
            host = socket.gethostbyname(parts.hostname) if parts.hostname == "localhost" else parts.hostname
            ports = [parts.port, *(int(port) for port in others)]
            if all(0 < port < 1 << 16 for port in ports):
                return [(host, port) for port in ports]
    except ValueError:
        pass
    raise UsageError(f"{where}: is no stream of dv-processing; write {SCHEME}")


def _greeted(host: str, port: int) -> None:
    """See that somebody there speaks so: the package itself would wait for it, with all of Python.

    Raises
    ------
    OSError, RecordingError
        Nobody does.
    """
    with socket.create_connection((host, port), CONNECT_S) as connected:
        begun = b""
        while len(begun) < 12:
            more = connected.recv(12 - len(begun))
            if not more:
                break
            begun += more
    if begun[8:12] != GREETING:
        raise RecordingError(
            f"begins with {begun!r}, which streams of dv-processing do not; see what sends it"
        )


def listed() -> list[tuple[str, str, str]]:
    """Tell which cameras are plugged in.

    Returns
    -------
    cameras : list of (str, str, str)
        Serial number, model, and what is wrong with it, or "".
    """
    with explained():
        found = dv_processing("a camera").io.camera.discover()
    return [(str(each.serialNumber), str(each.cameraModel.name), "") for each in found]


def camera_pieces(serial: str, stopped: threading.Event) -> Iterator[Piece]:
    """Open a camera, and give what comes until it is lost or stopped.

    Parameters
    ----------
    serial : str
        Its number.
    stopped : threading.Event
        Ends it.

    Yields
    ------
    piece : Piece
        The size of the sensor first.

    Raises
    ------
    RecordingError
        It cannot be opened, or was lost.
    """
    with explained():
        camera = dv_processing("a camera").io.camera.open(serial)
        camera.setTimeInterval(timedelta(milliseconds=1))  # as often as packets of other sources come
        yield from pieces_of([camera], stopped)
