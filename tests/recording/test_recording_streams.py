"""Several event streams in a file: named, chosen, never merged; bags of both versions of ROS."""

import struct

import numpy as np
import pytest
from prophesee_files import HEADER, raw
from recording_files import HEIGHT, WIDTH, assert_same_events, make_events, structured

from evqr.errors import RecordingError, StreamChoice
from evqr.recording import open_recording
from evqr.recording.ros_messages import ARRAY, PACKET, array_columns, parse

EVENTS = make_events(400)
FEW = EVENTS.cut(0, 100)

DVS = """std_msgs/Header header
uint32 height
uint32 width
dvs_msgs/Event[] events

================================================================================
MSG: dvs_msgs/Event
uint16 x
uint16 y
time ts
bool polarity
"""
EVENT_CAMERA = """std_msgs/Header header
# a comment, and a constant
uint8 MONO=3
uint32 height
uint32 width
uint64 seq
uint64 time_base
string encoding
bool is_bigendian
uint8[] events
"""


def read(path, **options):
    with open_recording(path, **options) as recording:
        return recording.read(), recording


class Serial:
    """Writes numbers one after the other, aligned as CDR wants it or, for ROS 1, not."""

    def __init__(self, cdr: bool) -> None:
        self.cdr, self.data = cdr, b""

    def add(self, code: str, *values) -> None:
        for c, value in zip(code, values, strict=True):
            if self.cdr:
                self.data += bytes(-len(self.data) % struct.calcsize(c))
            self.data += struct.pack("<" + c, value)

    def text(self, value: str) -> None:
        data = value.encode() + b"\0" * self.cdr
        self.add("I", len(data))
        self.data += data

    def header(self, frame: str) -> None:
        if not self.cdr:
            self.add("I", 0)
        self.add("II", 0, 0)
        self.text(frame)
        self.add("II", HEIGHT, WIDTH)

    @property
    def message(self) -> bytes:
        return (b"\0\1\0\0" if self.cdr else b"") + self.data


def array_message(events, cdr, frame="cam") -> bytes:
    serial = Serial(cdr)
    serial.header(frame)
    serial.add("I", len(events))
    for t, x, y, p in zip(events.t.tolist(), events.x, events.y, events.p > 0, strict=True):
        serial.add("HHII?", x, y, t // 1_000_000, t % 1_000_000 * 1000, p)
    return serial.message


def packet_message(data: bytes, encoding: str, cdr, time_base=0) -> bytes:
    serial = Serial(cdr)
    serial.header("camera")
    serial.add("QQ", 0, time_base)
    serial.text(encoding)
    serial.add("?I", False, len(data))
    return serial.message + data


def mono(events) -> bytes:
    out = np.zeros(len(events), [("t", "<u4"), ("x", "<u2"), ("yp", "<u2")])
    out["t"], out["x"] = events.t * 1000 - 1_000_000, events.x
    out["yp"] = events.y | ((events.p > 0).astype(np.uint16) << 15)
    return out.tobytes()


def bag(path, kind, connections, packed=None):
    """Write (topic, type, definition, messages) to a bag of ROS 1, or of ROS 2 in either storage."""
    if kind == "ros1":
        writer = pytest.importorskip("rosbags.rosbag1").Writer(path)
        if packed:
            writer.set_compression(writer.CompressionFormat[packed.upper()])
    else:
        rosbag2 = pytest.importorskip("rosbags.rosbag2")
        plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        if packed:
            writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
    stamp = 1
    with writer:
        for topic, msgtype, definition, messages in connections:
            digest = (
                {"md5sum": "0" * 32, "callerid": f"/node{stamp}"}
                if kind == "ros1"
                else {"rihs01": "RIHS01_" + "0" * 64}
            )
            connection = writer.add_connection(topic, msgtype, msgdef=definition, **digest)
            for message in messages:
                writer.write(connection, stamp, message)
                stamp += 1
    return path


KINDS = ["ros1", "sqlite", "mcap"]


def arrays(events, kind, size=37):
    return [array_message(events.cut(i, i + size), kind != "ros1") for i in range(0, len(events), size)]


@pytest.mark.parametrize("frame", ["", "a", "ab", "abc", "abcd"])
@pytest.mark.parametrize("cdr", [False, True])
@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_messages_are_taken_apart(frame, cdr, count):
    message = parse(array_message(EVENTS.cut(0, count), cdr, frame), ARRAY, ros2=cdr)
    events = array_columns(message)
    assert (message.width, message.height) == (WIDTH, HEIGHT)
    for column, expected in (("t", EVENTS.t * 1000), ("x", EVENTS.x), ("y", EVENTS.y), ("p", EVENTS.p > 0)):
        np.testing.assert_array_equal(getattr(events, column), expected[:count])
    if count:
        with pytest.raises(ValueError, match=f"a message declares {count} items"):
            parse(array_message(EVENTS.cut(0, count), cdr, frame)[:-2], ARRAY, ros2=cdr)
    packet = parse(packet_message(b"12345", "evt3", cdr, 7), PACKET, ros2=cdr)
    assert (packet.data, packet.encoding, packet.time_base_ns) == (b"12345", "evt3", 7)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "msgtype", ["dvs_msgs/msg/EventArray", "prophesee_event_msgs/msg/EventArray", "own_msgs/msg/Events"]
)
def test_arrays_by_layout(tmp_path, kind, msgtype):
    if msgtype.startswith("own") and kind == "sqlite":
        pytest.skip("sqlite3 bags of this version hold no definition")
    path = bag(tmp_path / "a", kind, [("/events", msgtype, DVS, arrays(EVENTS, kind))])
    for chunk_events in (50, 1 << 20):
        got, recording = read(path, chunk_events=chunk_events)
        assert_same_events(got, EVENTS)
    assert recording.format == f"ROS {'2 ' * (kind != 'ros1')}bag {msgtype.replace('/msg/', '/')} on /events"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("encoding", ["evt2", "evt21", "evt4", "mono"])
def test_packets(tmp_path, kind, encoding):
    if encoding == "mono":
        data, time_base = mono(EVENTS), 1_000_000
    else:
        version = {"evt2": "2.0", "evt21": "2.1", "evt4": "4.0"}[encoding]
        data = raw(EVENTS, version)[len(HEADER.replace(b"VERSION", version.encode())) :]
        time_base = 0
    parts = [data[i : i + 800] for i in range(0, len(data), 800)]
    messages = [packet_message(part, encoding, kind != "ros1", time_base) for part in parts]
    path = bag(tmp_path / "a", kind, [("/cam", "event_camera_msgs/msg/EventPacket", EVENT_CAMERA, messages)])
    assert_same_events(read(path)[0], EVENTS)


@pytest.mark.parametrize("kind", KINDS)
def test_two_topics_and_a_node_that_was_restarted(tmp_path, kind):
    own = "dvs_msgs/msg/EventArray"
    first, second = arrays(EVENTS.cut(0, 200), kind), arrays(EVENTS.cut(200, 400), kind)
    connections = [("/left", own, DVS, first), ("/right", own, DVS, arrays(FEW, kind))]
    if kind == "ros1":  # ROS 2 keeps one entry a topic
        connections.append(("/left", own, DVS, second))
    else:
        connections[0] = ("/left", own, DVS, first + second)
    path = bag(tmp_path / "a", kind, connections)
    with pytest.raises(StreamChoice, match=r"topics \(/left, /right\); choose one of them: stream=./left."):
        read(path)
    got, recording = read(path, stream="/left")
    assert_same_events(got, EVENTS)
    assert recording.streams == ("/left", "/right")
    assert_same_events(read(path, stream="right")[0], FEW)


@pytest.mark.parametrize(
    ("kind", "packed"),
    [*((kind, None) for kind in KINDS), ("ros1", "bz2"), ("ros1", "lz4"), ("mcap", "zstd")],
)
def test_a_bag_that_was_cut_is_read_as_far_as_it_goes(tmp_path, kind, packed):
    """Its index stands at its end."""
    events = make_events(4000)
    own = "dvs_msgs/msg/EventArray"
    topics = [("/events", own, DVS, arrays(events, kind, 400)), ("/other", own, DVS, arrays(FEW, kind))]
    path = bag(tmp_path / "a", kind, topics, packed=packed)
    file = (
        path if path.is_file() else next(each for each in path.iterdir() if each.suffix in (".db3", ".mcap"))
    )
    whole, counts = file.read_bytes(), set()
    assert read(path, stream="/events")[1].notes == ()
    for length in (*range(64, len(whole), len(whole) // 12), len(whole) - 9):
        file.write_bytes(whole[:length])
        try:
            got, recording = read(path, stream="/events")
        except RecordingError as error:
            assert "truncated" in str(error)
        else:
            assert_same_events(got, events.cut(0, len(got)))
            assert recording.notes == (
                "the file is cut short: the index at the end of the bag is missing; read up to there",
            )
            counts.add(len(got))
    assert max(counts) >= (len(events) if kind != "sqlite" else 2800)
    assert len(counts) > 3 or packed  # in one chunk
    file.write_bytes(whole[: len(whole) - 9])
    with pytest.raises(RecordingError, match="truncated: the index at the end of the bag is missing"):
        read(path, stream="/events", strict=True)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_without_events(tmp_path, kind):
    path = bag(tmp_path / "a", kind, [("/imu", "own_msgs/msg/Imu", "float64 x\n", [b"\0\1\0\0" + bytes(8)])])
    with pytest.raises(
        RecordingError, match=r"no event stream in this bag \(it has: /imu \(own_msgs/msg/Imu\)\)"
    ):
        read(path)


@pytest.mark.parametrize("kind", ["sqlite", "mcap"])
def test_the_file_in_a_ros_2_bag(tmp_path, kind):
    path = bag(tmp_path / "a", kind, [("/e", "dvs_msgs/msg/EventArray", DVS, arrays(EVENTS, kind))])
    (file,) = [f for f in path.iterdir() if f.name != "metadata.yaml"]
    assert_same_events(read(file)[0], EVENTS)
    (path / "metadata.yaml").unlink()
    assert_same_events(read(path)[0], EVENTS)


def attrs(values) -> str:
    return "".join(f'<attr key="{key}" type="string">{value}</attr>' for key, value in values.items())


def aedat4(path, streams):
    """Join AEDAT4 files of one stream each, (output, camera, events or type), without a table of packets."""
    xml, packets = "", b""
    for number, (output, source, events) in enumerate(streams):
        kind = events if isinstance(events, str) else "EVTS"
        attributes = {"compression": "NONE", "originalOutputName": output, "typeIdentifier": kind}
        info = {"sizeX": WIDTH, "sizeY": HEIGHT, "source": source}
        xml += f'<node name="{number}">{attrs(attributes)}<node name="info">{attrs(info)}</node></node>'
        if kind == "EVTS":
            packets += packet(number, events)
    xml = f'<dv version="2.0"><node name="outInfo" path="/outInfo/">{xml}</node></dv>'
    text = xml.encode() + b"\0" * (4 - len(xml) % 4)
    # IOHeader, a FlatBuffer: root, vtable of three fields (compression, position of the table, XML), values.
    head = struct.pack("<I4s", 20, b"IOHE")
    vtable = struct.pack("<HHHHHH", 10, 24, 4, 8, 16, 0)
    table = struct.pack("<iiqII", 12, 0, -1, 8, 0)
    body = head + vtable + table + struct.pack("<I", len(xml)) + text
    path.write_bytes(b"#!AER-DAT4.0\r\n" + struct.pack("<I", len(body)) + body + packets)


def packet(stream: int, events) -> bytes:
    rows = np.zeros(len(events), [("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("on", "?"), ("pad", "V3")])
    rows["t"], rows["x"], rows["y"], rows["on"] = events.t, events.x, events.y, events.p > 0
    # EventPacket, a FlatBuffer with its size before it: a vector of structs of 16 bytes, aligned to 8.
    head = struct.pack("<I4s", 16, b"EVTS") + struct.pack("<HHHH", 6, 8, 4, 0)
    body = head + struct.pack("<iI", 8, 8) + struct.pack("<II", 0, len(events)) + rows.tobytes()
    body = struct.pack("<I", len(body)) + body
    return struct.pack("<ii", stream, len(body)) + body


def test_aedat4_with_several_streams(tmp_path):
    pytest.importorskip("aedat")
    path = tmp_path / "a"
    aedat4(path, [("events", "cam", EVENTS)])
    assert_same_events(read(path)[0], EVENTS)
    for names, streams in (
        (("events", "filtered"), [("events", "cam", EVENTS), ("filtered", "cam", FEW)]),
        (("L/events", "R/events"), [("events", "L", EVENTS), ("events", "R", FEW)]),
        (("0", "1"), [("events", "cam", EVENTS), ("events", "cam", FEW)]),
    ):
        aedat4(path, streams)
        with pytest.raises(StreamChoice, match=f"event streams \\({', '.join(names)}\\)"):
            read(path)
        for name, expected in zip(names, (EVENTS, FEW), strict=True):
            got, recording = read(path, stream=name)
            assert_same_events(got, expected)
            assert (recording.stream, recording.streams) == (name, names)
    aedat4(path, [("frames", "cam", "FRME"), ("imu", "cam", "IMUS")])
    with pytest.raises(RecordingError, match=r"no event stream in this file \(it has: frame, imus\)"):
        read(path)


def test_npz_with_several_arrays(tmp_path):
    table = structured(EVENTS, [("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "i1")], EVENTS.p)
    np.savez(tmp_path / "a.npz", left=table, right=table[:100], width=WIDTH, height=HEIGHT)
    with pytest.raises(StreamChoice, match=r"event arrays \(left, right\)"):
        read(tmp_path / "a.npz")
    assert_same_events(read(tmp_path / "a.npz", stream="left")[0], EVENTS)
    for separator in "/_.":
        two = {
            f"{side}{separator}{c}": getattr(e, c) for side, e in (("l", EVENTS), ("r", FEW)) for c in "txyp"
        }
        np.savez(
            tmp_path / "a.npz", **two, resolution="64x48", note=np.array([{"never": "unpickled"}], object)
        )
        with pytest.raises(StreamChoice, match=r"event groups \(l, r\)"):
            read(tmp_path / "a.npz")
        assert_same_events(read(tmp_path / "a.npz", stream="l")[0], EVENTS)
    matrix = np.stack([EVENTS.x, EVENTS.y, EVENTS.p > 0, EVENTS.t], axis=1)
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", arr_0=matrix, sensor_size=[WIDTH, HEIGHT])
        for chunk_events in (33, 1 << 20):
            assert_same_events(read(tmp_path / "a.npz", chunk_events=chunk_events)[0], EVENTS)
    for stored in (matrix.T, np.asfortranarray(matrix), np.asfortranarray(matrix.T)):
        np.save(tmp_path / "a.npy", stored)
        np.savez(tmp_path / "a.npz", events=stored)
        for name in ("a.npy", "a.npz"):
            for chunk_events in (33, 1 << 20):
                got = read(tmp_path / name, sensor=(WIDTH, HEIGHT), chunk_events=chunk_events)[0]
                assert_same_events(got, EVENTS)
    np.save(tmp_path / "a.npy", matrix)
    got, recording = read(tmp_path / "a.npy", sensor=(WIDTH, HEIGHT))
    assert_same_events(got, EVENTS)
    assert recording.notes == (
        "columns are taken as x, y, p, t: the array has no names, and no other order fits",
    )
    assert_same_events(read(tmp_path / "a.npy", sensor="64x48", columns="xypt")[0], EVENTS)
    assert_same_events(read(matrix, sensor="64x48")[0], EVENTS)


def test_a_stream_of_a_format_that_has_but_one(tmp_path, events):
    (tmp_path / "a").write_bytes(raw(events, "2.0"))
    with pytest.raises(RecordingError, match="holds one stream; leave out stream="):
        read(tmp_path / "a", stream="left")


def test_the_choice_survives_a_process(tmp_path):
    import pickle

    choice = pickle.loads(pickle.dumps(StreamChoice("a: holds several", ("x", "y"))))
    assert (str(choice), choice.streams) == ("a: holds several", ("x", "y"))


def aedat3(path, packets, header="#Source 1: DVS128"):
    """Write (type, source, events or bytes, ts_overflow) as AEDAT 3.1."""
    data = f"#!AER-DAT3.1\r\n#Format: RAW\r\n{header}\r\n#!END-HEADER\r\n".encode()
    for kind, source, events, overflow in packets:
        if kind == 1:
            place = (
                1 | (events.p > 0) << 1 | events.y.astype(np.uint32) << 2 | events.x.astype(np.uint32) << 17
            )
            body = np.stack([place.astype("<u4"), (events.t & 0x7FFFFFFF).astype("<u4")], axis=1).tobytes()
            count, size = len(events), 8
        else:
            body, count, size = events, 1, len(events)
        data += struct.pack("<hhiiiiii", kind, source, size, 4, overflow, count, count, count) + body
    path.write_bytes(data)


def test_aedat3(tmp_path):
    path = tmp_path / "a"
    parts = [EVENTS.cut(i, i + 70) for i in range(0, 400, 70)]
    aedat3(path, [(0, 1, bytes(32), 0), *((1, 1, part, 0) for part in parts), (3, 1, bytes(36), 0)])
    for chunk_events in (64, 1 << 20):
        got, recording = read(path, sensor=(WIDTH, HEIGHT), chunk_events=chunk_events)
        assert_same_events(got, EVENTS)
    assert (read(path)[1].width, read(path)[1].height) == (128, 128)
    (tmp_path / "b").write_bytes(path.read_bytes()[:-50])
    got, recording = read(tmp_path / "b")
    assert len(got) == 400  # it was the packet after the last events
    (tmp_path / "b").write_bytes(path.read_bytes()[:-100])
    got, recording = read(tmp_path / "b")
    assert len(got) == 400 - len(parts[-1])
    assert recording.notes == ("the file is cut short: its last packet is not whole; read up to there",)
    aedat3(path, [(1, 1, EVENTS, 3)])
    np.testing.assert_array_equal(read(path)[0].t, EVENTS.t + 3 * 2**31)
    aedat3(path, [(1, 1, EVENTS, 0), (1, 2, FEW, 0)], "#Source 1: DAVIS240C\r\n#Source 2: DVS128")
    with pytest.raises(StreamChoice, match=r"event sources \(1, 2\)"):
        read(path)
    got, recording = read(path, stream="1")
    assert (len(got), recording.width, recording.height) == (400, 240, 180)
    aedat3(path, [(2, 1, bytes(36), 0)])
    with pytest.raises(RecordingError, match="no packet of polarity events"):
        read(path)
