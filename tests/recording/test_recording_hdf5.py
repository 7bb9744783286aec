"""Layouts of HDF5 in use: groups, compounds, matrices, MATLAB, virtual data sets, several cameras."""

import fcntl
import shutil

import h5py
import numpy as np
import pytest
from recording_files import HEIGHT, WIDTH, assert_same_events, make_events, structured

from evqr.errors import RecordingError, StreamChoice
from evqr.events.array import EventArray
from evqr.recording import open_recording

SENSOR = (WIDTH, HEIGHT)
EVENTS = make_events(400)
MATRIX = {"t": EVENTS.t, "x": EVENTS.x, "y": EVENTS.y, "p": (EVENTS.p > 0)}


def matrix(order: str, dtype=np.float64, **changes) -> np.ndarray:
    return np.stack([np.asarray((MATRIX | changes)[c]).astype(dtype) for c in order], axis=1)


def write(path, content, **attributes):
    with h5py.File(path, "w") as file:
        for name, values in content.items():
            file[name] = values
        file.attrs.update(attributes)


def read(path, **options):
    with open_recording(path, **{"sensor": SENSOR, **options}) as recording:
        return recording.read(), recording


def columns(place: str) -> dict[str, np.ndarray]:
    return {f"{place}/{name}": values for name, values in MATRIX.items()}


@pytest.mark.parametrize("chunk_events", [7, 1 << 20])
@pytest.mark.parametrize(
    ("name", "values", "unit"),
    [
        ("events", matrix("txyp", np.uint32), "us"),  # v2e
        ("events", matrix("txyp", np.uint32).T, "us"),
        ("davis/left/events", matrix("xytp", t=EVENTS.t / 1e6), "s"),  # MVSEC
        ("davis/left/events", matrix("xytp", t=EVENTS.t / 1e6 + 1_506_117_919), "s"),
        ("recording/events", matrix("xypt", np.int64), "us"),
        ("a/b/c/data", matrix("txyp", p=EVENTS.p), "us"),
    ],
)
def test_matrices(tmp_path, name, values, unit, chunk_events):
    write(
        tmp_path / "a", {name: values, "davis/left/imu": np.zeros((90, 6)), "truth/corners": np.ones((4, 2))}
    )
    got, recording = read(tmp_path / "a", chunk_events=chunk_events)
    np.testing.assert_array_equal(got.t - got.t[0], EVENTS.t - EVENTS.t[0])
    np.testing.assert_array_equal(got.x, EVENTS.x)
    np.testing.assert_array_equal(got.p, EVENTS.p)
    assert recording.time_unit == unit
    assert recording.stream == name


def test_matrices_whose_order_is_told(tmp_path):
    values = matrix("xypt", np.int64)
    write(tmp_path / "a", {"events": values})
    assert_same_events(read(tmp_path / "a", columns="x,y,p,t")[0], EVENTS)
    five = np.column_stack([np.arange(400) % 7, values])
    write(tmp_path / "a", {"events": five})
    assert_same_events(read(tmp_path / "a", columns="-,x,y,p,t")[0], EVENTS)
    with h5py.File(tmp_path / "a", "w") as file:
        file["events"] = values[:, [2, 0, 1, 3]]
        file["events"].attrs["columns"] = ["p", "x", "y", "t"]
    assert_same_events(read(tmp_path / "a")[0], EVENTS)


def test_a_matrix_that_fits_no_order_is_named(tmp_path):
    write(tmp_path / "a", {"events": np.random.default_rng(0).normal(size=(100, 4))})
    with pytest.raises(
        RecordingError, match=r"array events of shape \(100, 4\) has no column names and fits no"
    ):
        read(tmp_path / "a")


def test_columns_of_one_row(tmp_path):
    """As MATLAB stores a vector, in version 7.3 after 512 bytes of its own."""
    for shape in ((1, 400), (400, 1)):
        content = {name: np.reshape(v, shape).astype(float) for name, v in columns("events").items()}
        write(tmp_path / "a", content)
        for chunk_events in (64, 1 << 20):
            assert_same_events(read(tmp_path / "a", chunk_events=chunk_events)[0], EVENTS)
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name, values in content.items():
            file[name] = values
    with open(tmp_path / "a.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Nov 30 2026".ljust(512))
    assert_same_events(read(tmp_path / "a.mat")[0], EVENTS)


def test_compounds(tmp_path):
    dtype = [("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "<i2")]
    table = structured(EVENTS, dtype, (EVENTS.p > 0).astype(int))
    for shape in ((400,), (1, 400), (400, 1)):
        write(tmp_path / "a", {"CD/events": table.reshape(shape)}, geometry="64x48")
        got, recording = read(tmp_path / "a", sensor=None)
        assert_same_events(got, EVENTS)
        assert recording.time_unit_reason == "Prophesee CD/events is in us"
    pandas = np.zeros(400, [("index", "i8"), ("values_block_0", "i8", (4,))])
    pandas["values_block_0"] = matrix("xytp", np.int64)
    write(tmp_path / "a", {"events/table": pandas})
    assert_same_events(read(tmp_path / "a")[0], EVENTS)


def test_two_cameras(tmp_path):
    other = EVENTS.cut(0, 100)
    right = {f"prophesee/right/{c}": getattr(other, c) for c in "txyp"}
    write(tmp_path / "a", {**columns("prophesee/left"), **right, "prophesee/left/calib/resolution": [64, 48]})
    with pytest.raises(StreamChoice, match=r"groups \(prophesee/left, prophesee/right\)") as caught:
        read(tmp_path / "a")
    assert caught.value.streams == ("prophesee/left", "prophesee/right")
    for stream in ("left", "prophesee/left", "/prophesee/left", "LEFT"):
        got, recording = read(tmp_path / "a", stream=stream, sensor=None)
        assert_same_events(got, EVENTS)
        assert (recording.stream, recording.streams) == ("prophesee/left", caught.value.streams)
    assert len(read(tmp_path / "a", stream="right")[0]) == 100
    with pytest.raises(RecordingError, match="stream 'middle' is not among the event groups"):
        read(tmp_path / "a", stream="middle")
    two = {f"davis/{side}/events": matrix("xytp") for side in ("left", "right")}
    write(tmp_path / "a", two)
    with pytest.raises(StreamChoice, match="davis/left/events, davis/right/events"):
        read(tmp_path / "a")
    for stream in ("left", "davis/left"):
        assert_same_events(read(tmp_path / "a", stream=stream, time_unit="us")[0], EVENTS)
    with pytest.raises(RecordingError, match="stream 'davis' fits several event groups"):
        read(tmp_path / "a", stream="davis")


def test_a_matrix_of_more_columns_asks_what_they_are(tmp_path):
    wide = np.column_stack([matrix("txyp"), np.zeros(400)])
    write(tmp_path / "a", {"events": wide})
    with pytest.raises(
        RecordingError, match=r"array events of shape \(400, 5\) has no column names.*t,x,y,p,-"
    ):
        read(tmp_path / "a")
    assert_same_events(read(tmp_path / "a", columns="t,x,y,p,-", time_unit="us")[0], EVENTS)


def test_links(tmp_path):
    write(tmp_path / "other", columns("store"))
    with h5py.File(tmp_path / "a", "w") as file:
        for name, values in columns("deep/camera").items():
            file[name] = values
        file["events"] = h5py.SoftLink("/deep/camera")  # the same again
        file["gone"] = h5py.SoftLink("/nowhere")
        file["loop"] = h5py.SoftLink("/")
        file["lost"] = h5py.ExternalLink("missing.h5", "/events")
    assert_same_events(read(tmp_path / "a")[0], EVENTS)
    with h5py.File(tmp_path / "a", "w") as file:
        file["events"] = h5py.ExternalLink(str(tmp_path / "other"), "/store")
    assert_same_events(read(tmp_path / "a")[0], EVENTS)


def test_virtual_data_sets(tmp_path):
    for i in (0, 1):
        part = EVENTS.cut(200 * i, 200 * i + 200)
        write(tmp_path / f"part{i}.h5", {f"events/{c}": getattr(part, c) for c in "txyp"})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for c in "txyp":
            layout = h5py.VirtualLayout((400,), getattr(EVENTS, c).dtype)
            for i in (0, 1):
                source = h5py.VirtualSource(f"part{i}.h5", f"events/{c}", (200,))
                layout[200 * i : 200 * i + 200] = source
            file.create_virtual_dataset(f"events/{c}", layout)
    assert_same_events(read(tmp_path / "a.h5")[0], EVENTS)
    (tmp_path / "part1.h5").unlink()
    with pytest.raises(RecordingError, match=r"put together from other files, and part1\.h5 is not there"):
        read(tmp_path / "a.h5")


@pytest.mark.parametrize("offset", [np.array([5_000_000]), np.int64(5_000_000), np.array([[5e6]])])
@pytest.mark.parametrize("place", ["t_offset", "events/t_offset"])
def test_offsets(tmp_path, offset, place):
    write(tmp_path / "a", {**columns("events"), place: offset})
    later = EventArray(EVENTS.t + 5_000_000, EVENTS.x, EVENTS.y, EVENTS.p, WIDTH, HEIGHT)
    assert_same_events(read(tmp_path / "a", time_unit="us")[0], later)
    write(tmp_path / "a", {**columns("events"), place: [1, 2]})
    got, recording = read(tmp_path / "a", time_unit="us")
    assert_same_events(got, EVENTS)
    assert "t_offset of shape (2,) is no whole number of microseconds" in recording.notes[0]


def test_units_in_names(tmp_path):
    content = columns("events")
    content["events/t_ns"] = content.pop("events/t") * 1000 + 1
    write(tmp_path / "a", content, sensorWidth=64, sensorHeight=48)
    got, recording = read(tmp_path / "a", sensor=None)
    assert_same_events(got, EVENTS)
    assert recording.time_unit_reason == "column 't_ns' says so"


def test_an_interrupted_file_is_read_as_far_as_it_is_written(tmp_path):
    with h5py.File(tmp_path / "a", "w") as file:
        for c, values in MATRIX.items():
            dataset = file.create_dataset(f"events/{c}", (400,), values.dtype, chunks=(50,))
            dataset[: 300 if c == "t" else 250] = values[: 300 if c == "t" else 250]
    got, recording = read(tmp_path / "a")
    assert_same_events(got, EVENTS.cut(0, 250))
    assert recording.notes == (
        "the file is cut short: /events/t declares 400 events, and 250 are stored; read up to there",
    )
    with pytest.raises(
        RecordingError, match="/events/t is truncated: 400 events declared, 2,400 bytes stored"
    ):
        read(tmp_path / "a", strict=True)


COUNTS = np.column_stack([np.arange(500), *np.zeros((2, 500)), np.ones(500)]).astype(int)
LABELS = np.eye(4, dtype=int)[np.random.default_rng(0).integers(0, 4, 500)]


@pytest.mark.parametrize("place", ["events", "labels"])
@pytest.mark.parametrize(
    ("numbers", "problem"),
    [
        (np.zeros((500, 4)), "its first 500 would be all at one time"),
        (COUNTS, "its first 500 would be all on at most four pixels"),
        (LABELS, "its first 500 would be all on at most four pixels"),
    ],
    ids=["zeros", "counts", "labels"],
)
def test_four_columns_that_are_hardly_events_are_refused(tmp_path, place, numbers, problem):
    write(tmp_path / "a", {place: numbers})
    with pytest.raises(RecordingError, match=problem) as caught:
        read(tmp_path / "a")
    assert 'columns="t,x,y,p"' in str(caught.value)
    if numbers is COUNTS:
        assert len(read(tmp_path / "a", columns="t,x,y,p", time_unit="us")[0]) == 500


def cut(path, share):
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])


@pytest.mark.parametrize("share", [0.45, 0.7, 0.95])
def test_a_file_that_was_cut_is_read_as_far_as_it_is_there(tmp_path, share):
    write(tmp_path / "a", {"events": matrix("txyp")})
    cut(tmp_path / "a", share)
    got, recording = read(tmp_path / "a", time_unit="us")
    assert (share - 0.35) * len(EVENTS) < len(got) < len(EVENTS)
    assert_same_events(got, EVENTS.cut(0, len(got)))
    assert recording.notes == (
        f"the file is cut short: /events declares 400 events, and {len(got)} are stored; read up to there",
    )
    with pytest.raises(RecordingError, match="truncated: /events declares 400 events"):
        read(tmp_path / "a", time_unit="us", strict=True)


@pytest.mark.parametrize("libver", ["earliest", "latest"])
@pytest.mark.parametrize(
    "options", [{}, {"chunks": (32,)}, {"chunks": (32,), "compression": "gzip"}], ids=str
)
def test_cut_anywhere_a_file_gives_its_first_events_or_says_why_not(tmp_path, libver, options):
    with h5py.File(tmp_path / "a", "w", libver=libver) as file:
        for column in "txyp":
            file.create_dataset(f"events/{column}", data=getattr(EVENTS, column), **options)
    whole, counts = (tmp_path / "a").read_bytes(), set()
    for length in range(1024, len(whole), max(len(whole) // 60, 1)):
        (tmp_path / "b").write_bytes(whole[:length])
        try:
            got, recording = read(tmp_path / "b")
        except RecordingError as error:
            assert "truncated" in str(error)
            assert str(error).count(str(tmp_path)) == 1
        else:
            assert_same_events(got, EVENTS.cut(0, len(got)))
            assert "the file is cut short" in recording.notes[0]
            counts.add(len(got))
    assert counts


def test_locked_in_use_and_left_open(tmp_path):
    path = tmp_path / "a"
    with h5py.File(path, "w", libver="latest") as file:
        for name, values in columns("events").items():
            file.create_dataset(name, data=values, chunks=(100,), maxshape=(None,))
        file.swmr_mode = True
        shutil.copyfile(path, tmp_path / "swmr")  # as the writer's death leaves it
    got, recording = read(tmp_path / "swmr")
    assert_same_events(got, EVENTS)
    assert "marked as being written (SWMR)" in recording.notes[0]

    write(path, columns("events"))
    with open(path, "rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        with pytest.raises(RecordingError, match="is in use by another program, which locks it"):
            read(path)
    with h5py.File(tmp_path / "b", "w", libver="latest") as file:
        file["events/t"] = np.arange(5)
        file.flush()
        shutil.copyfile(tmp_path / "b", tmp_path / "open")
    with pytest.raises(RecordingError, match=r"is marked as being written: close it .*h5clear -s FILE"):
        read(tmp_path / "open")
