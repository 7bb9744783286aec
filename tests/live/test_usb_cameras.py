"""Cameras of neuromorphic-drivers: packets as it makes them, decoded; cameras that come, go, cannot be used.

Its packets are made by its compiled part alone, from a camera; those here have the names that its
documentation and its compiled part have, and the types of its arrays.
"""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from evqr.errors import MissingExtra, UsageError
from evqr.live import cameras, usb_cameras
from evqr.live.cameras import Camera
from evqr.live.pieces import Events, Idle, Interrupted, Sensor, TimePasses, TriggerSeen
from evqr.service.feeding import feed, opened_source

SENSOR = Sensor(64, 48)
POLARITY = np.dtype([("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])
EDGE = np.dtype([("t", "<u8"), ("id", "u1"), ("rising", "?")])
DAVIS_EDGE = np.dtype([("t", "<u8"), ("polarity", "u1")])


def packet(events=None, triggers=None, lost=None):
    return SimpleNamespace(
        polarity_events=None if events is None else np.array(events, POLARITY),
        trigger_events=triggers,
        polarity_events_overflow_indices=None if lost is None else np.array(lost, np.uint64),
        trigger_events_overflow_indices=None,
    )


def status(now_us=None):
    return SimpleNamespace(ring=None if now_us is None else SimpleNamespace(current_t=now_us))


def decoded(*given):
    return list(usb_cameras.pieces_of(*given, SENSOR))


def test_packets_are_events_triggers_and_time():
    got = decoded(
        status(90), packet([(70, 3, 4, True), (80, 63, 47, False)], np.array([(75, 0, True)], EDGE))
    )
    assert got[0] == TriggerSeen(75, "start") and got[2] == TimePasses(90) and len(got) == 3
    assert [column.tolist() for column in got[1].columns] == [[70, 80], [3, 63], [4, 47], [1, -1]]
    assert [column.dtype for column in got[1].columns] == [np.int64, np.uint16, np.uint16, np.int8]


def test_edges_of_both_kinds_of_cameras():
    falls = np.array([(5, 0, False), (7, 0, True)], EDGE)
    davis = np.array([(5, 0), (6, 1), (7, 2), (8, 9)], DAVIS_EDGE)
    assert decoded(status(9), packet(triggers=falls))[:-1] == [TriggerSeen(5, "end"), TriggerSeen(7, "start")]
    assert decoded(status(9), packet(triggers=davis))[:-1] == [
        TriggerSeen(5, "end"), TriggerSeen(6, "start"), TriggerSeen(7, "pulse")
    ]  # fmt: skip


def test_what_the_computer_did_not_take_is_a_gap_where_it_was():
    got = decoded(status(9), packet([(t, 1, 1, True) for t in range(6)], lost=[2, 4]))
    assert [type(each) for each in got] == [
        Events, Interrupted, Sensor, Events, Interrupted, Sensor, Events, TimePasses
    ]  # fmt: skip
    assert [each.columns.t.tolist() for each in got if isinstance(each, Events)] == [[0, 1], [2, 3], [4, 5]]


def test_nothing_came_in_time():
    assert decoded(status(), packet()) == [Idle()]
    assert decoded(status(5), None) == [Idle()]
    assert decoded(status(5), packet()) == [TimePasses(5)]


class Device:
    """A camera that gives some packets, and is pulled out then."""

    def __init__(self, *steps):
        self._steps = steps

    def __enter__(self):
        return self

    def __exit__(self, *failure):
        return False

    def __iter__(self):
        yield from self._steps
        raise RuntimeError("No such device (it may have been disconnected)")

    def properties(self):
        return SimpleNamespace(width=64, height=48)


@pytest.fixture
def driver(monkeypatch):
    """The package, with what tests plug in."""
    plugged = SimpleNamespace(list_devices=list, open=None, opened=[])
    monkeypatch.setitem(sys.modules, "neuromorphic_drivers", plugged)
    monkeypatch.setattr(cameras, "DRIVERS", cameras.DRIVERS[:1])
    return plugged


def listed(serial, error=None, name="Prophesee EVK4"):
    return SimpleNamespace(name=SimpleNamespace(value=name), serial=serial, error=error)


def test_a_camera_that_is_pulled_out_is_opened_again(driver):
    def opened(*, serial, iterator_timeout):
        driver.opened.append(serial)
        return Device((status(10), packet([(9, 1, 1, True)])))

    driver.open, driver.list_devices = opened, lambda: [listed("41"), listed("42")]
    camera, got = Camera("camera:42", retry_s=(0.001, 0.002)), []
    for piece in camera.pieces():
        got.append(piece)
        if len(driver.opened) == 2 and isinstance(piece, Events):
            camera.stop()
    assert driver.opened == ["42", "42"] and got[0] == SENSOR
    (lost,) = (each for each in got if isinstance(each, Interrupted))
    assert "No such device" in lost.reason and "\n" not in lost.reason


def test_records_say_that_it_was_lost_and_its_clock_began_again(driver, monkeypatch):
    def opened(*, serial, iterator_timeout):
        driver.opened.append(serial)
        if len(driver.opened) == 2:
            source.stop()
        return Device((status(200_000), packet([(t, 1, 1, True) for t in range(100_000, 200_000, 500)])))

    from evqr import Reader

    driver.open, driver.list_devices = opened, lambda: [listed("41")]
    with opened_source("camera") as source:
        records = list(feed(source, lambda size: Reader(size, backend="numpy")))
    assert [each.record for each in records] == ["gap"]
    assert records[0].reason_code == "interrupted" and "No such device" in records[0].reason


@pytest.mark.parametrize(
    ("where", "plugged", "said"),
    [
        ("camera", [], "no camera is plugged in"),
        ("camera:7", [listed("8")], "no camera 7 is plugged in, there is 8"),
        ("camera", [listed("8", "Access denied")], "Prophesee EVK4 8: Access denied"),
    ],
)
def test_no_camera_is_said_and_looked_for_again(driver, where, plugged, said):
    driver.list_devices = lambda: plugged
    camera = Camera(where, retry_s=(0.001, 0.002))
    pieces = camera.pieces()
    first = [next(pieces) for _ in range(4)]
    camera.stop()
    assert said in first[0].reason and first[1:] == [Idle()] * 3 and list(pieces) == []


def test_where_there_is_no_usb(driver):
    def fails():
        raise RuntimeError("Other error")

    driver.list_devices = fails
    found, problems = cameras.plugged_in()
    assert found == [] and "USB cannot be used (Other error)" in problems[0] == cameras.describe_cameras()
    assert "USB cannot be used" in next(Camera("camera").pieces()).reason


def test_without_the_extra(monkeypatch):
    for name in ("neuromorphic_drivers", "dv_processing"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtra, match=r"a camera needs neuromorphic-drivers: .*live"):
        Camera("camera")
    assert "live" in cameras.describe_cameras()


def test_what_is_no_camera():
    with pytest.raises(UsageError, match="camera:SERIAL"):
        Camera("camera:")


def test_the_package_is_as_we_take_it():
    driver = pytest.importorskip("neuromorphic_drivers", reason="extra 'live' is not installed")
    try:
        assert isinstance(driver.list_devices(), list)
    except RuntimeError:  # no USB here
        pass
    for kind in (driver.Evt3Packet, driver.DvxplorerPacket, driver.Davis346Packet):
        assert {"polarity_events", "trigger_events", "polarity_events_overflow_indices"} <= set(
            kind.__annotations__
        )
    for name in driver.Name:
        properties = driver.name_to_properties(name)
        assert properties.width > 0 and properties.height > 0
    status = sys.modules["neuromorphic_drivers.status"]
    assert "ring" in status.Status.__annotations__ and "current_t" in status.RingStatus.__annotations__
