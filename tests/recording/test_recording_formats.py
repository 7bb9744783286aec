"""Every layout of the formats that need no extra gives exactly the events that were written."""

import subprocess
import sys
import zipfile

import h5py
import numpy as np
import pytest
from recording_files import HEIGHT, WIDTH, WRITERS, assert_same_events, make_events, structured

from evqr.errors import UsageError
from evqr.events.array import EventArray
from evqr.recording import open_recording, save_recording

SENSOR = (WIDTH, HEIGHT)


@pytest.mark.parametrize("chunk_events", [1, 7, 64, 1000, 1 << 20])
@pytest.mark.parametrize("kind", WRITERS)
def test_chunks_join_to_the_events_whatever_the_name(tmp_path, events, kind, chunk_events):
    if chunk_events == 1:
        events = events.cut(0, 100)
    path = tmp_path / "recording.of.some.kind"
    WRITERS[kind](path, events)
    with open_recording(path, sensor=SENSOR, chunk_events=chunk_events) as recording:
        chunks = list(recording.chunks())
        assert max(map(len, chunks)) <= chunk_events
        assert_same_events(recording.read(), events)
        assert (recording.n_events, recording.notes) == (len(events), ())
        assert (recording.t_first_us, recording.t_last_us) == (events.t[0], events.t[-1])


@pytest.mark.parametrize("suffix", [".h5", ".hdf5", ".npz"])
def test_saved_recordings_need_no_option(tmp_path, events, suffix):
    path = tmp_path / f"saved{suffix}"
    save_recording(path, events)
    with open_recording(path) as recording:
        assert_same_events(recording.read(), events)
        assert recording.time_unit == "us"


@pytest.mark.parametrize("kind", ["h5", "arrays"])
def test_the_end_is_known_at_once_where_it_can_be_looked_at(tmp_path, kind):
    events = make_events(100_000)
    t = events.t.copy()
    t[[-1, -2]] = t[-1], t[-1] + 5
    events = EventArray(t, events.x, events.y, events.p, WIDTH, HEIGHT)
    WRITERS["h5"](tmp_path / "a", events)
    with open_recording(events if kind == "arrays" else tmp_path / "a") as recording:
        assert recording.t_last_us == t.max()
        recording.read()
        assert recording.t_last_us == t.max()


def test_saved_truth_has_the_layout_of_the_development_recordings(tmp_path, events):
    first = {"payload": "LOT-1", "version": 2, "modules": np.eye(25, dtype=np.uint8), "t_us": np.arange(3)}
    truth = {"truth": first, "truth2": {**first, "payload": "LOT-2"}}
    save_recording(tmp_path / "a.h5", events, truth=truth)
    with h5py.File(tmp_path / "a.h5") as file:
        assert (file.attrs["width"], file.attrs["height"]) == SENSOR
        assert set(np.unique(file["events/p"][:])) == {0, 1}
        assert set(file) == {"events", "truth", "truth2"}
        assert (file["truth"].attrs["payload"], file["truth"].attrs["version"]) == ("LOT-1", 2)
        assert file["truth2"].attrs["payload"] == "LOT-2"
        np.testing.assert_array_equal(file["truth2/modules"][:], first["modules"])
    save_recording(tmp_path / "a.npz", events, truth=truth)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        assert (file["truth/payload"], file["truth2/payload"]) == ("LOT-1", "LOT-2")
        np.testing.assert_array_equal(file["truth/t_us"], first["t_us"])
    for name in ("a.h5", "a.npz"):
        with open_recording(tmp_path / name) as recording:
            assert_same_events(recording.read(), events)


def test_saving_refuses_other_suffixes_and_unwritable_places(tmp_path, events):
    with pytest.raises(UsageError, match=r"written as \.h5"):
        save_recording(tmp_path / "a.xls", events)
    with pytest.raises(ValueError, match="cannot be written"):
        save_recording(tmp_path / "missing" / "a.npz", events)


@pytest.mark.parametrize(
    "names",
    [("t", "x", "y", "p"), ("ts", "xs", "ys", "pol"), ("timestamp", "X", "Y", "Polarity")],
)
@pytest.mark.parametrize("group", ["events", "raw_events", "", "camera/left"])
def test_hdf5_groups_and_aliases(tmp_path, events, group, names):
    path = tmp_path / "a"
    with h5py.File(path, "w") as file:
        for name, values in zip(names, (events.t, events.x, events.y, events.p), strict=True):
            file[f"{group}/{name}"] = values
    with open_recording(path, sensor=SENSOR) as recording:
        assert_same_events(recording.read(), events)
        assert recording.format.startswith(f"HDF5 {group}")


def test_hdf5_prophesee_compound(tmp_path, events):
    path = tmp_path / "a"
    dtype = [("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "<i2")]
    with h5py.File(path, "w") as file:
        file["CD/events"] = structured(events, dtype, events.p > 0)
        file.attrs["geometry"] = f"{WIDTH}x{HEIGHT}"
    with open_recording(path) as recording:
        assert_same_events(recording.read(), events)
        assert "Prophesee" in recording.time_unit_reason


def test_hdf5_dsec_adds_its_offset(tmp_path, events):
    hdf5plugin = pytest.importorskip("hdf5plugin")
    path = tmp_path / "a"
    offset = 49_599_300_523
    with h5py.File(path, "w") as file:
        columns = (("t", events.t.astype(np.uint32)), ("x", events.x), ("y", events.y), ("p", events.p > 0))
        for name, values in columns:
            file.create_dataset(f"events/{name}", data=values.astype(np.uint32), **hdf5plugin.Blosc())
        file["ms_to_idx"] = np.arange(3)
        file["t_offset"] = np.int64(offset)
    with open_recording(path, sensor=SENSOR) as recording:
        shifted = EventArray(events.t + offset, events.x, events.y, events.p, WIDTH, HEIGHT)
        assert_same_events(recording.read(), shifted)
        assert "DSEC" in recording.time_unit_reason


def test_hdf5_unit_attribute(tmp_path, events):
    path = tmp_path / "a"
    with h5py.File(path, "w") as file:
        for name, values in (("t", events.t * 1000), ("x", events.x), ("y", events.y), ("p", events.p)):
            file[f"events/{name}"] = values
        file["events/t"].attrs["units"] = "Nanoseconds"
        file["events/width"], file["events/height"] = WIDTH, HEIGHT
    with open_recording(path) as recording:
        assert_same_events(recording.read(), events)
        assert recording.time_unit == "ns"


@pytest.mark.parametrize(
    "dtype",
    [
        [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("p", "?")],
        [("timestamp", ">i8"), ("x", "<i2"), ("y", "<i2"), ("polarity", "i1")],
        [("x", "<f4"), ("y", "<f4"), ("ts", "<f8"), ("pol", "<f4")],
    ],
)
def test_structured_arrays(tmp_path, events, dtype):
    names = [name for name, _ in dtype]
    columns = {"t": events.t, "x": events.x, "y": events.y, "p": events.p > 0}
    array = np.empty(len(events), dtype)
    for name in names:
        array[name] = columns[name[0] if name[:1] in "xyp" else "t"]
    np.save(tmp_path / "a.npy", array)
    np.savez(tmp_path / "a.npz", event_data=array)
    for source in (tmp_path / "a.npy", tmp_path / "a.npz", array):
        with open_recording(source, sensor=SENSOR) as recording:
            assert_same_events(recording.read(), events)


def test_arrays(events):
    with open_recording(events) as recording:
        assert_same_events(recording.read(), events)
        assert recording.path == ""
    lists = tuple(values.tolist() for values in (events.t, events.x, events.y, events.p))
    with open_recording(lists, sensor=SENSOR) as recording:
        assert_same_events(recording.read(), events)


@pytest.mark.parametrize(
    "line",
    [
        "{t} {x} {y} {p}",
        "{t},{x},{y},{p}",
        "{t}\t{x}\t{y}\t{p}",
        "{t:d}  {x}.0 {y} {p}.0",
        "{s:.6f}, {x}, {y}, {p}",
    ],
)
@pytest.mark.parametrize("top", ["", f"{WIDTH} {HEIGHT}\n", f"# made by hand\n\n{WIDTH} {HEIGHT}\n% more\n"])
def test_text(tmp_path, events, top, line):
    path = tmp_path / "a"
    rows = zip(events.t.tolist(), events.x, events.y, (events.p > 0).astype(int), strict=True)
    path.write_text(top + "\n".join(line.format(t=t, s=t / 1e6, x=x, y=y, p=p) for t, x, y, p in rows))
    with open_recording(path, sensor=None if top else SENSOR) as recording:
        assert_same_events(recording.read(), events)


def test_text_header_line_gives_the_order(tmp_path, events):
    path = tmp_path / "a.csv"
    rows = zip(events.x, events.y, events.p, events.t, strict=True)
    path.write_text("x,y,polarity,timestamp\n" + "".join(f"{x},{y},{p},{t}\n" for x, y, p, t in rows))
    with open_recording(path, sensor=SENSOR) as recording:
        assert_same_events(recording.read(), events)


def test_seconds_are_rounded_not_truncated(tmp_path):
    path = tmp_path / "a"
    path.write_text("0.6367649989999999 1 2 1\n0.636766 3 4 0\n0.636767001 5 6 0\n")
    with open_recording(path, sensor=(8, 8), time_unit="s") as recording:
        assert recording.read().t.tolist() == [636_765, 636_766, 636_767]


def test_whole_nanoseconds_since_1970_keep_all_digits(tmp_path):
    path = tmp_path / "a"
    start = 1_700_000_000_000_000_000
    path.write_text("".join(f"{start + i * 1000 + 1} {i % 8} 0 1\n" for i in range(500)))
    with open_recording(path, sensor=(8, 8)) as recording:
        assert recording.time_unit == "ns"
        np.testing.assert_array_equal(recording.read().t, start // 1000 + np.arange(500))


def test_npz_members_may_be_stored_plainly(tmp_path):
    events = make_events(5000)
    np.savez(tmp_path / "a.npz", t=events.t, x=events.x, y=events.y, p=events.p)
    assert zipfile.ZipFile(tmp_path / "a.npz").infolist()[0].compress_type == zipfile.ZIP_STORED
    with open_recording(tmp_path / "a.npz", sensor=SENSOR, chunk_events=999) as recording:
        assert_same_events(recording.read(), events)


def test_coarse_float32_times_are_told():
    t = np.linspace(100, 101, 5000, dtype=np.float32)
    columns = t, np.arange(5000) % 64, np.arange(5000) % 48, np.ones(5000)
    with open_recording(columns, sensor=SENSOR, time_unit="s") as recording:
        assert recording.notes == ("times are stored as float32, which tells no less than 7.6 us apart",)


def test_importing_loads_no_reader():
    code = "import sys, evqr.recording; print(*sorted({'h5py', 'eventcv', 'hdf5plugin'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
