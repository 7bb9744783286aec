"""Bad input: one line that names the file, what is wrong, the value, and what to do."""

import os
import sys

import h5py
import numpy as np
import pytest
from recording_files import HEIGHT, WIDTH, WRITERS, make_events, write_h5, write_npz

import evqr.recording.recognise
from evqr.errors import MissingExtra, RecordingError, UsageError
from evqr.recording import open_recording
from evqr_kernels.extras import install_command

SENSOR = (WIDTH, HEIGHT)


def error_of(source, **options) -> str:
    """Message of the error that opening and reading gives."""
    with pytest.raises((RecordingError, MissingExtra)) as caught:
        with open_recording(source, **options) as recording:
            recording.read()
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(source) if isinstance(source, (str, os.PathLike)) else "arrays")
    return message


def arrays(**changes):
    """Good columns of 20 events, some of them replaced."""
    columns = {
        "t": np.arange(20),
        "x": np.arange(20),
        "y": np.arange(20),
        "p": np.arange(20) % 2,
    }
    return tuple((columns | changes).values())


def with_value(dtype, index, value):
    values = np.arange(20).astype(dtype)
    values[index] = value
    return values


def test_missing_directory_and_empty(tmp_path):
    assert "no such file" in error_of(tmp_path / "nothing.h5")
    assert "is a directory" in error_of(tmp_path)
    (tmp_path / "a").touch()
    assert "empty (0 bytes)" in error_of(tmp_path / "a")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_does_not_block(tmp_path):
    os.mkfifo(tmp_path / "a")
    assert "is a pipe or a device" in error_of(tmp_path / "a")


def test_unreadable(tmp_path, events, monkeypatch):
    write_h5(tmp_path / "a", events)

    def refuse(path, mode):
        raise PermissionError(13, "Permission denied", path)

    monkeypatch.setattr(evqr.recording.recognise, "open", refuse, raising=False)
    assert "cannot be read (Permission denied); check its permissions" in error_of(tmp_path / "a")


@pytest.mark.parametrize(
    "content",
    [
        b"\x89PNG\r\n\x1a\n" + bytes(100),
        b"%PDF-1.7\n\x00\xff",
        b"\x7fELF" + bytes(60),
        b"\x00" * 5000,
        b"a" * 5000,
    ],
)
def test_not_an_event_file(tmp_path, content):
    (tmp_path / "a.h5").write_bytes(content)
    message = error_of(tmp_path / "a.h5")
    assert "not an event recording" in message
    assert "pip install" not in message  # no extra reads it


@pytest.mark.parametrize(
    ("content", "advice"),
    [
        (b"#!AER-DAT2.0\r\n# comment\r\n", "AEDAT before version 3 is not read"),
        (b"#!AER-DAT3.1\r\n" + bytes(100), "AEDAT 3 is read as cAER writes it in format RAW"),
        (b"Event Stream\2\0\0\1", "faery input file IN.es output file OUT.aedat4"),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + bytes(99), "save it with save(..., '-v7.3')"),
        (b"\x1f\x8b\x08" + bytes(9), "unpack it first"),
    ],
)
def test_event_files_that_evqr_does_not_read(tmp_path, content, advice):
    (tmp_path / "a").write_bytes(content)
    assert advice in error_of(tmp_path / "a")


def test_text_that_is_no_recording(tmp_path):
    (tmp_path / "a").write_text("Dear reader,\nnothing here\n")
    assert "line 1 is no event: 'Dear reader,'" in error_of(tmp_path / "a")
    (tmp_path / "a").write_text("# only comments\n\n")
    assert "empty" in error_of(tmp_path / "a")
    (tmp_path / "a").write_text("t x y\n1 2 3\n")
    assert "line 1 is no event" in error_of(tmp_path / "a")
    (tmp_path / "a").write_text("time x y colour\n1 2 3 1\n")
    assert "lacks column p (has time, x, y, colour)" in error_of(tmp_path / "a")
    for number, line in ((6, "2 2 nothing 1"), (6, "2 2"), (7, "# a remark\n2 2 2 1 2")):
        (tmp_path / "a").write_text("1 2 3 1\n" * 5 + line + "\n")
        expected = f"line {number} is no event: {line.splitlines()[-1]!r}"
        for chunk_events in (2, 1 << 20):
            assert expected in error_of(
                tmp_path / "a", sensor=SENSOR, time_unit="us", chunk_events=chunk_events
            )
    (tmp_path / "a").write_text(" ".join("abcdefghijklmno") + "\n")
    assert "(has a, b, c, d, e, f, g, h, i, j, k, l, ...)" in error_of(tmp_path / "a")
    (tmp_path / "a").write_text("1 2 3 1\n" + f"{10**30} 2 3 1\n")
    assert "time 1e+30 of event 1 overflows" in error_of(tmp_path / "a", sensor=SENSOR, time_unit="us")


@pytest.mark.parametrize("kind", ["h5", "npz", "npy"])
def test_truncated(tmp_path, events, kind):
    path = tmp_path / "a"
    WRITERS[kind](path, events)
    whole = path.read_bytes()
    for share in (0.2, 0.6, 0.95):
        path.write_bytes(whole[: int(share * len(whole))])
        assert "truncated" in error_of(path, sensor=SENSOR, strict=True)


def test_interrupted_hdf5_has_declared_more_than_it_wrote(tmp_path):
    with h5py.File(tmp_path / "a", "w") as file:
        for column in "txyp":
            file.create_dataset(f"events/{column}", (1000,), np.int32, chunks=(100,))
        file["events/t"][:500] = np.arange(500)
    message = error_of(tmp_path / "a", sensor=SENSOR)
    assert "/events/t is truncated: 1,000 events declared, 2,000 bytes stored" in message


def test_hdf5_without_events(tmp_path):
    with h5py.File(tmp_path / "a", "w") as file:
        file["images"] = np.zeros((3, 3))
    assert "lacks column t, x, y, p (has images)" in error_of(tmp_path / "a")
    with h5py.File(tmp_path / "a", "w") as file:
        file["events/t"] = file["events/x"] = file["events/polarity"] = np.zeros(3)
    assert "/events lacks column y (has polarity, t, x)" in error_of(tmp_path / "a")
    with h5py.File(tmp_path / "a", "w") as file:
        for side in ("left", "right"):
            for column in "txyp":
                file[f"prophesee/{side}/{column}"] = np.zeros(3)
    assert "several event groups (prophesee/left, prophesee/right)" in error_of(tmp_path / "a")


def test_hdf5_odd_columns(tmp_path):
    with h5py.File(tmp_path / "a", "w") as file:
        for column in "txyp":
            file[f"events/{column}"] = np.zeros((3, 2))
    assert "/events/t must be one-dimensional numbers, got float64 of shape (3, 2)" in error_of(
        tmp_path / "a"
    )
    with h5py.File(tmp_path / "a", "w") as file:
        for column in "txyp":
            file[f"events/{column}"] = ["one", "two"]
    assert "must be one-dimensional numbers, got object" in error_of(tmp_path / "a")


def test_hdf5_filters_that_are_not_there(tmp_path, events, monkeypatch):
    write_h5(tmp_path / "a", events)
    monkeypatch.setattr(h5py.h5z, "filter_avail", lambda number: False)
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    assert install_command("formats") in error_of(tmp_path / "a")


def test_pickles_are_never_loaded(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{"t": 1}], object), allow_pickle=True)
    assert "pickled objects, which are never loaded" in error_of(tmp_path / "a.npy")
    objects = np.array([1, 2], object)
    np.savez(tmp_path / "a.npz", t=objects, x=objects, y=objects, p=objects)
    assert "pickled objects, which are never loaded" in error_of(tmp_path / "a.npz")


def test_npz_and_npy_without_named_columns(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((5, 6)))
    assert "shape (5, 6), which leaves open which column is which" in error_of(tmp_path / "a.npy")
    np.save(tmp_path / "a.npy", np.full((5, 4), 7))
    assert "no column names and fits no order of t, x, y, p (first: 7, 7, 7, 7)" in error_of(
        tmp_path / "a.npy"
    )
    np.save(tmp_path / "a.npy", np.zeros(5))
    assert "lacks column t, x, y, p" in error_of(tmp_path / "a.npy")
    np.savez(tmp_path / "a.npz", t=np.zeros(3), x=np.zeros(3), y=np.zeros(3))
    assert "lacks column p (has t, x, y)" in error_of(tmp_path / "a.npz")
    assert "without named columns" in error_of(np.zeros((5, 6)))


@pytest.mark.parametrize("write", ["h5", "npz"])
def test_columns_of_different_length(tmp_path, write):
    columns = {"t": np.arange(10), "x": np.arange(10), "y": np.arange(9), "p": np.ones(10)}
    if write == "npz":
        np.savez(tmp_path / "a.npz", **columns)
    else:
        with h5py.File(tmp_path / "a.npz", "w") as file:
            for name, values in columns.items():
                file[f"events/{name}"] = values
    message = error_of(tmp_path / "a.npz")
    assert "different length: t has 10, x has 10, y has 9, p has 10" in message


def test_no_events(tmp_path):
    empty = make_events(0)
    for kind in ("h5", "npz", "npy"):
        if kind != "h5":
            WRITERS[kind](tmp_path / kind, empty)
            assert "the recording is empty" in error_of(tmp_path / kind, sensor=SENSOR)
    with h5py.File(tmp_path / "a", "w") as file:
        for column in "txyp":
            file[f"events/{column}"] = np.zeros(0, int)
    assert "the recording is empty" in error_of(tmp_path / "a", sensor=SENSOR)
    assert "the recording is empty" in error_of(empty)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"t": with_value(int, 3, -5)}, "time -5 of event 3 is negative"),
        ({"t": with_value(float, 4, np.nan)}, "time nan of event 4 is not a finite number"),
        ({"t": with_value(float, 5, np.inf)}, "time inf of event 5 is not a finite number"),
        ({"t": with_value(np.uint64, 19, 2**63)}, "time 9223372036854775808 of event 19 overflows"),
        ({"t": with_value(float, 19, 1e30)}, "time 1e+30 of event 19 overflows"),
        ({"x": with_value(int, 6, 64)}, "x 64 of event 6 is outside the 64x48 sensor"),
        ({"x": with_value(int, 6, -1)}, "x -1 of event 6 is outside"),
        ({"y": with_value(np.uint16, 7, 65535)}, "y 65535 of event 7 is outside"),
        ({"y": with_value(float, 8, 1.5)}, "y 1.5 of event 8 is no whole number of pixels"),
        ({"y": with_value(float, 8, np.nan)}, "y nan of event 8 is no whole number"),
        ({"p": with_value(int, 9, 2) % 3}, "polarity 2 of event 2 fits neither {0, 1} nor {-1, 1}"),
        ({"p": np.array([1, -1, 0] + [1] * 17)}, "polarity 0 of event 2 fits neither"),
        ({"p": np.full(20, 0.5)}, "polarity 0.5 of event 0 fits neither"),
        ({"p": np.full(20, 255, np.uint8)}, "polarity 255 of event 0 fits neither"),
        ({"x": np.array(["a"] * 20)}, "column x must be one-dimensional numbers, got <U1"),
        ({"x": np.zeros((20, 2))}, "column x must be one-dimensional numbers, got float64 of shape"),
        ({"x": np.zeros(19)}, "columns of different length: t has 20, x has 19"),
    ],
)
@pytest.mark.parametrize("chunk_events", [2, 1 << 20])
def test_values(changes, expected, chunk_events):
    source = arrays(**changes)
    assert expected in error_of(source, sensor=SENSOR, time_unit="us", chunk_events=chunk_events)


def test_overflow_counts_the_unit():
    t = np.arange(20) + 10**13
    with open_recording(arrays(t=t), sensor=SENSOR, time_unit="us") as recording:
        assert recording.read().t[0] == 10**13
    assert "overflows 64-bit microseconds if in s" in error_of(arrays(t=t), sensor=SENSOR, time_unit="s")


def test_stamps_of_64_bits_without_sign_in_nanoseconds():
    t = np.uint64(2**63) + np.arange(20, dtype=np.uint64) * np.uint64(1000)
    with open_recording(arrays(t=t), sensor=SENSOR, time_unit="ns") as recording:
        np.testing.assert_array_equal(recording.read().t, 9223372036854776 + np.arange(20))


def test_offset_must_not_make_times_negative(tmp_path):
    with h5py.File(tmp_path / "a", "w") as file:
        for column, values in zip("txyp", arrays(), strict=True):
            file[f"events/{column}"] = values
        file["t_offset"] = -5
    assert "time -5 of event 0 is negative with the file's offset -5" in error_of(
        tmp_path / "a", sensor=SENSOR
    )


def test_sensor_size(tmp_path, events):
    np.savez(tmp_path / "a.npz", t=events.t, x=events.x, y=events.y, p=events.p)
    assert 'sensor size unknown: pass sensor="WxH"' in error_of(tmp_path / "a.npz")
    assert "sensor size unknown" in error_of(arrays())
    assert "sensor size 0x48 is impossible" in error_of(arrays(), sensor=(0, 48))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["width"], file.attrs["height"] = "wide", 3
        for column, values in zip("txyp", arrays(), strict=True):
            file[f"events/{column}"] = values
    assert "is no pair of whole numbers" in error_of(tmp_path / "a.h5")


def test_the_sensor_asked_for_wins_and_the_difference_is_told(tmp_path, events):
    write_npz(tmp_path / "a", events)
    with open_recording(tmp_path / "a", sensor=(640, 480)) as recording:
        assert (recording.width, recording.height) == (640, 480)
        assert recording.notes == ("the file says the sensor is 64x48; 640x480 was asked for",)


def test_misuse_is_no_recording_error(events):
    with pytest.raises(UsageError, match="time_unit 'minutes' is unknown; pass one of s, ms, us, ns"):
        open_recording(events, time_unit="minutes")
    with pytest.raises(TypeError, match="got list"):
        open_recording([1, 2, 3])
    with pytest.raises(ValueError, match="at least 1, got 0"):
        open_recording(events, chunk_events=0)


def test_files_are_closed_after_errors(tmp_path, events):
    write_h5(tmp_path / "a", events)
    with pytest.raises(RecordingError):
        open_recording(tmp_path / "a", sensor=(0, 1))
    with h5py.File(tmp_path / "a", "a") as file:  # refused while another handle is open
        file.attrs["note"] = "writable"
