"""Vendor formats (extra ``formats``): written by eventcv, read by evqr, whatever the file is called."""

import re
import struct
import sys

import numpy as np
import pytest
from recording_files import HEIGHT, WIDTH, assert_same_events, make_events
from vendor_files import FORMATS, write

from evqr.errors import MissingExtra, RecordingError
from evqr.events.array import EventArray
from evqr.recording import open_recording
from evqr_kernels.extras import install_command

pytest.importorskip("eventcv")


@pytest.fixture(params=FORMATS)
def kind(request):
    return request.param


@pytest.mark.parametrize("chunk_events", [1000, 1 << 20])
def test_same_events(tmp_path, kind, chunk_events):
    # Over a minute, so that EVT3's clock of 24 bits wraps; not sparser, because its decoders tell a wrap from
    # the high time bits that a camera sends all the time, and eventcv writes none without events.
    events = make_events(40_000, span_us=70_000_000)
    write(kind, tmp_path / "a.h5", events)
    with open_recording(tmp_path / "a.h5", chunk_events=chunk_events) as recording:
        assert_same_events(recording.read(), events)
        assert recording.format == FORMATS[kind][2]
        assert recording.notes == ()


def test_truncated(tmp_path, kind, events):
    write(kind, tmp_path / "a", events)
    whole = (tmp_path / "a").read_bytes()
    for lost in (1, len(whole) // 3 | 1):  # odd: a cut between words of EVT2 and EVT3 leaves no trace
        if kind == "aedat4" and lost == 1:
            continue  # the table of packets at the end is not needed
        (tmp_path / "a").write_bytes(whole[:-lost])
        with pytest.raises(RecordingError, match="truncated"):
            with open_recording(tmp_path / "a", strict=True) as recording:
                recording.read()
        if kind in ("bag", "aedat4"):  # the index of a bag is at its end, and this AEDAT4 has one packet
            continue
        with open_recording(tmp_path / "a") as recording:
            read = recording.read()
            assert any("the file is cut short" in note for note in recording.notes)
        assert_same_events(read, events.cut(0, len(read)))
        assert len(read) >= 0.5 * (len(whole) - lost) / len(whole) * len(events)


def test_events_outside_the_sensor_are_not_dropped(tmp_path, kind, events):
    write(kind, tmp_path / "a", events)
    outside = pytest.raises(RecordingError, match=r"x 63 of event \d+ is outside the 63x48 sensor")
    with outside, open_recording(tmp_path / "a", sensor=(WIDTH - 1, HEIGHT)) as recording:
        recording.read()


def test_missing_package(tmp_path, kind, events, monkeypatch):
    if FORMATS[kind][3] is None:
        pytest.skip("decoded by evqr itself")
    write(kind, tmp_path / "a", events)
    for module in ("aedat", "evt3", "rosbags.rosbag1"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(
        MissingExtra, match=rf"needs the package {FORMATS[kind][3]}: {re.escape(install_command('formats'))}"
    ):
        open_recording(tmp_path / "a")


def test_headers(tmp_path, events):
    path = tmp_path / "a"
    write("evt3", path, events)
    data = path.read_bytes().partition(b"% end\n")[2]

    def header(text):
        path.write_bytes(text + data)
        with open_recording(path) as recording:
            return recording.read()

    for good in (
        b"% evt 3.0\n% geometry 64x48\n% end\n",
        b"% date 2024-01-01 10:00:00\n% evt 3.0\n% format EVT3;height=48;width=64\n",
    ):
        assert_same_events(header(good), events)
    for bad, message in (
        (b"% evt 3.0\n% end\n", 'sensor size unknown: pass sensor="WxH"'),
        (b"% evt 3.0\n% geometry wide\n% end\n", "header says the sensor is 'wide', no WxH"),
        (b"% format HISTO3D;width=64;height=48\n% end\n", "encoding HISTO3D is not supported"),
        (b"% geometry 64x48\n% end\n", "encoding unknown is not supported"),
    ):
        with pytest.raises(RecordingError, match=message):
            header(bad)


def test_a_raw_file_of_triggers_only_is_empty(tmp_path):
    (tmp_path / "a").write_bytes(b"% evt 3.0\n% geometry 64x48\n% end\n" + b"\x00\x80\x00\x60" * 100)
    with pytest.raises(RecordingError, match="the recording is empty: Prophesee EVT3 with 0 events"):
        open_recording(tmp_path / "a")


def test_bag_with_evt3_packets(tmp_path, events):
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    write("evt3", tmp_path / "raw", events)
    data = (tmp_path / "raw").read_bytes().partition(b"% end\n")[2]

    def message(payload: bytes, encoding: bytes) -> bytes:
        u32 = lambda value: int(value).to_bytes(4, "little")  # noqa: E731
        header = u32(0) + bytes(8) + u32(3) + b"cam"
        packet = u32(HEIGHT) + u32(WIDTH) + bytes(16) + u32(len(encoding)) + encoding + b"\0"
        return header + packet + u32(len(payload)) + payload

    def bag(name, encoding, topics=("/events",)):
        with rosbag1.Writer(tmp_path / name) as writer:
            for topic in topics:
                connection = writer.add_connection(
                    topic, "event_camera_msgs/msg/EventPacket", msgdef="uint8[] events", md5sum="0" * 32
                )
                for i in range(0, len(data), 300):
                    writer.write(connection, i + 1, message(data[i : i + 300], encoding))
        return tmp_path / name

    with open_recording(bag("good.bag", b"evt3"), chunk_events=90) as recording:
        assert_same_events(recording.read(), events)
    with pytest.raises(
        RecordingError, match="encoded as 'libcaer_cmp'; evt3, evt2, evt21, evt4, mono are read"
    ):
        open_recording(bag("libcaer.bag", b"libcaer_cmp"))
    with pytest.raises(
        RecordingError, match=r"several event topics \(/left, /right\); choose one of them: stream=./left."
    ):
        open_recording(bag("two.bag", b"evt3", ("/left", "/right")))


def table_position(head: bytes) -> int:
    """Where the table of packets of an AEDAT4 file starts, by the IOHeader, a FlatBuffer."""
    base = len(b"#!AER-DAT4.0\r\n") + 4
    table = base + struct.unpack_from("<I", head, base)[0]
    vtable = table - struct.unpack_from("<i", head, table)[0]
    (field,) = struct.unpack_from("<H", head, vtable + 6)
    return struct.unpack_from("<q", head, table + field)[0]


def test_aedat4_with_a_table_that_counts_no_events(tmp_path, events):
    lz4_frame = pytest.importorskip("lz4.frame")
    path = tmp_path / "a"
    write("aedat4", path, events)
    whole = path.read_bytes()
    position = table_position(whole)
    assert position < len(whole)
    # A FlatBuffer: its size, offset of the root, a vtable without fields, the root with its way to that.
    empty_table = struct.pack("<IIHHi", 12, 8, 4, 4, 4)
    path.write_bytes(whole[:position] + lz4_frame.compress(empty_table))
    with open_recording(path) as recording:
        assert_same_events(recording.read(), events)


def test_polarity_and_order_of_equal_times(tmp_path, kind):
    x = np.array([5, 3, 9], np.uint16)
    p = np.array([1, -1, 1], np.int8)
    events = EventArray(np.full(3, 77), x, x, p, WIDTH, HEIGHT)
    write(kind, tmp_path / "a", events)
    with open_recording(tmp_path / "a") as recording:
        read = recording.read()
    assert sorted(zip(read.x.tolist(), read.p.tolist(), strict=True)) == [(3, -1), (5, 1), (9, 1)]
