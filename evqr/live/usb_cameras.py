"""Cameras that neuromorphic-drivers (extra ``live``) drives: what it hands over, decoded."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.errors import RecordingError
from evqr.extras import needs_extra
from evqr.live.pieces import Events, Idle, Interrupted, Piece, Sensor, TimePasses, TriggerSeen
from evqr.live.source import IDLE_S
from evqr.recording.source import RawColumns
from evqr.recording.triggers import TriggerKind

OVERRUN = "packets of the camera were lost, as they were not taken in time"

EDGES: tuple[TriggerKind, ...] = ("end", "start", "pulse")
"""Kinds of triggers by their number: a line falls, or rises, or both at once."""


def neuromorphic_drivers(doing: str) -> ModuleType:
    """Import the package, or say how to install it."""
    with needs_extra(doing, "neuromorphic-drivers", "live"):
        import neuromorphic_drivers  # pyright: ignore[reportMissingImports]
    return neuromorphic_drivers


def pieces_of(status: Any, packet: Any, sensor: Sensor) -> Iterator[Piece]:
    """Decode what one step of a device gives.

    Parameters
    ----------
    status : neuromorphic_drivers.status.Status
        Its clock.
    packet : Evt3Packet, DvxplorerPacket, Davis346Packet or None
        None, or a packet without anything, where nothing came in time.
    sensor : Sensor
        Told again where the computer did not take packets in time, behind an `Interrupted`.

    Yields
    ------
    piece : Piece
        Triggers first.
    """
    if packet is None or status.ring is None:
        yield Idle()
        return
    if packet.trigger_events is not None:
        yield from _triggers(packet.trigger_events)
    events = packet.polarity_events
    lost = packet.polarity_events_overflow_indices
    parts = [events] if lost is None or events is None else np.split(events, lost.astype(np.int64))
    for number, part in enumerate(parts):
        if number:
            yield Interrupted(OVERRUN)
            yield sensor
        if part is not None and len(part):
            yield Events(_columns(part))
    now_us = getattr(status.ring, "current_t", None)
    if now_us is not None:
        yield TimePasses(int(now_us))


def _columns(events: NDArray[Any]) -> RawColumns:
    p = np.where(events["on"], np.int8(1), np.int8(-1))
    t, x, y = (np.ascontiguousarray(events[name]) for name in "txy")
    return RawColumns(t.astype(np.int64), x, y, p)


def _triggers(triggers: NDArray[Any]) -> Iterator[TriggerSeen]:
    """Decode triggers: a DAVIS346 says their polarity, others whether their line rises."""
    edges = triggers["rising" if "rising" in (triggers.dtype.names or ()) else "polarity"]
    for t_us, edge in zip(triggers["t"].tolist(), edges.tolist(), strict=True):
        if int(edge) < len(EDGES):
            yield TriggerSeen(int(t_us), EDGES[int(edge)])


@contextmanager
def explained() -> Iterator[None]:
    """Turn what the package raises into an error of one line."""
    try:
        yield
    except (RuntimeError, ValueError, KeyError, AttributeError) as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"the camera's driver says: {text}") from error


def listed() -> list[tuple[str, str, str]]:
    """Tell which cameras are plugged in.

    Returns
    -------
    cameras : list of (str, str, str)
        Serial number, model, and what is wrong with it, or "".

    Raises
    ------
    RecordingError
        There is no USB here, or it may not be used.
    """
    driver = neuromorphic_drivers("a camera")
    try:
        found = driver.list_devices()
    except RuntimeError as error:  # "Other error", where there is none
        raise RecordingError(
            f"USB cannot be used ({' '.join(str(error).split())}); see that this machine or container has it"
        ) from error
    return [(each.serial or "", each.name.value, each.error or "") for each in found]


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
    driver = neuromorphic_drivers("a camera")
    with explained(), driver.open(serial=serial or None, iterator_timeout=IDLE_S) as device:
        properties = device.properties()
        sensor = Sensor(int(properties.width), int(properties.height))
        yield sensor
        for status, packet in device:
            if stopped.is_set():
                return
            yield from pieces_of(status, packet, sensor)
