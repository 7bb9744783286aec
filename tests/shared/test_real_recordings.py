"""Files of real sensors decode to exactly the events that the README beside them gives."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from evqr.errors import RecordingError
from evqr.recording import open_recording, summarise

FOLDER = Path(__file__).parents[3] / "shared" / "real-recordings"

pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="no folder ../shared/real-recordings beside the repository"
)


class Expected(NamedTuple):
    format: str
    sensor: tuple[int, int]
    off: int
    on: int
    t_first: int
    t_last: int
    first: list[tuple[int, int, int, int]]  # t, x, y, p with 1 = ON


PACKETS = Expected(
    "Prophesee EVT3",
    (640, 480),
    218_291,
    125_183,
    7_139_845,
    9_218_023,
    [(7_139_845, 479, 441, 0), (7_139_854, 503, 443, 0)],
)

EXPECTED = {
    "aestream_davis.aedat4": Expected(
        "AEDAT4",
        (346, 260),
        45_304,
        72_363,
        1_633_953_690_975_950,
        1_633_953_691_105_949,
        [
            (1_633_953_690_975_950, 218, 15, 1),
            (1_633_953_690_975_950, 306, 76, 1),
            (1_633_953_690_975_954, 178, 73, 0),
        ],
    ),
    "event_vision_library_sample.aedat4": Expected(
        "AEDAT4",
        (346, 260),
        3_113,
        3_563,
        1_589_163_147_368_868,
        1_589_163_147_538_809,
        [(1_589_163_147_368_868, 215, 164, 1), (1_589_163_147_368_950, 226, 160, 1)],
    ),
    "event_camera_py_test_events_1.bag": PACKETS._replace(
        format="ROS bag event_camera_msgs/EventPacket on /event_camera/events"
    ),
    "event_camera_py_test_events_1.evt3.raw": PACKETS,
    "event_camera_codecs_trigger.evt3.raw": Expected(
        "Prophesee EVT3",
        (1280, 720),
        41_030,
        41_439,
        14_224_870,
        15_476_187,
        [(14_224_870, 354, 604, 1), (14_224_883, 835, 577, 1)],
    ),
    "lgpl/faery_evk4.evt3.raw": Expected(
        "Prophesee EVT3",
        (1280, 720),
        132_955,
        119_013,
        11_200_224,
        11_907_346,
        [(11_200_224, 484, 315, 1), (11_200_225, 474, 231, 0)],
    ),
    "lgpl/faery_evk4.dat": Expected(
        "Prophesee DAT", (1280, 720), 132_955, 119_013, 5_856, 712_978, [(5_856, 484, 315, 1)]
    ),
}


def rows(events, count):
    return [
        (int(events.t[i]), int(events.x[i]), int(events.y[i]), int(events.p[i] > 0)) for i in range(count)
    ]


@pytest.mark.parametrize("chunk_events", [10_000, 1 << 20])
@pytest.mark.parametrize("name", EXPECTED)
def test_decodes_to_the_figures_of_the_readme(name, chunk_events):
    expected = EXPECTED[name]
    with open_recording(FOLDER / name, chunk_events=chunk_events) as recording:
        events = recording.read()
        assert recording.format == expected.format
        assert (recording.width, recording.height) == expected.sensor
        assert (recording.t_first_us, recording.t_last_us) == (expected.t_first, expected.t_last)
        assert recording.n_events == len(events) == expected.off + expected.on
        assert recording.notes == ()
    assert (np.sum(events.p < 0), np.sum(events.p > 0)) == (expected.off, expected.on)
    assert rows(events, len(expected.first)) == expected.first


def same(a, b, shift=0):
    np.testing.assert_array_equal(a.t - shift, b.t)
    for column in "xyp":
        np.testing.assert_array_equal(getattr(a, column), getattr(b, column))


def read(name):
    with open_recording(FOLDER / name) as recording:
        return recording.read()


def test_bag_and_raw_hold_the_same_events():
    same(read("event_camera_py_test_events_1.bag"), read("event_camera_py_test_events_1.evt3.raw"))


def test_evt3_and_dat_hold_the_same_events_at_a_fixed_distance_in_time():
    same(read("lgpl/faery_evk4.evt3.raw"), read("lgpl/faery_evk4.dat"), shift=11_194_368)


@pytest.mark.parametrize("name", [name for name in EXPECTED if name.endswith(".evt3.raw")])
def test_two_decoders_agree(name):
    eventcv = pytest.importorskip("eventcv")
    theirs = eventcv.load(str(FOLDER / name), time_unit="us").numpy()
    ours = read(name)
    np.testing.assert_array_equal(np.stack([ours.x, ours.y, ours.t, ours.p > 0], axis=1), theirs)


RAW_EVENTS = "event_vision_library_event.hdf5"


def test_raw_events_hdf5():
    # The 17th event lies at y 181, so the 240x180 of the README is refused ...
    with pytest.raises(RecordingError, match="y 181 of event 16 is outside the 240x180 sensor"):
        open_recording(FOLDER / RAW_EVENTS, sensor=(240, 180))
    # ... and with room for it every event is there.
    with open_recording(FOLDER / RAW_EVENTS, sensor=(240, 182)) as recording:
        events = recording.read()
        assert recording.format == "HDF5 raw_events/{t,x,y,p}"
        assert recording.time_unit == "s"
        info = summarise(recording)
    assert (info.events, info.off, info.t_first_us, info.t_last_us) == (17, 17, 0, 5_748)
    assert rows(events, 2) == [(0, 134, 30, 0), (780, 59, 158, 0)]
    assert any("no event says brighter" in text for text in info.suspicious)


def test_raw_events_hdf5_needs_its_sensor_size():
    with pytest.raises(RecordingError, match=r"sensor size unknown: pass sensor=.WxH."):
        open_recording(FOLDER / RAW_EVENTS)
