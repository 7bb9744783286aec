"""The flight recorder: what is kept is what came, memory and disk are bounded, and it stops nothing."""

from __future__ import annotations

import os

import numpy as np
import pytest

from evqr.errors import UsageError
from evqr.events.array import EventArray
from evqr.recording import open_recording
from evqr.sinks.flight_recorder import FlightRecorder


def events(start_us, count, step_us=10):
    t = start_us + step_us * np.arange(count, dtype=np.int64)
    column = (t % 61).astype(np.uint16)
    return EventArray(t, column, (t % 47).astype(np.uint16), np.where(t % 20, 1, -1).astype(np.int8), 64, 48)


def test_events_of_some_time_are_in_a_file(tmp_path):
    recorder = FlightRecorder(tmp_path / "kept")
    for start in range(0, 50_000, 5_000):
        recorder.push(events(start, 500))
    path = recorder.keep("part 7: no read", 12_340, 31_000)
    recorder.close()
    assert path == tmp_path / "kept" / "part_7_no_read.h5" and recorder.left_out == 0
    with open_recording(path) as recording:
        got = recording.read()
    whole = events(0, 5_000).between(12_340, 31_000)
    assert (got.width, got.height) == (64, 48)
    for name in ("t", "x", "y", "p"):
        assert np.array_equal(getattr(got, name), getattr(whole, name))


def test_old_events_go_by_time_and_by_number(tmp_path):
    by_time = FlightRecorder(tmp_path, seconds=0.01)
    by_number = FlightRecorder(tmp_path, most_events=1_000)
    for start in range(0, 100_000, 1_000):
        for recorder in (by_time, by_number):
            recorder.push(events(start, 100))
    assert by_time.keep("old", 0, 80_000) is None and by_time.left_out == 1
    assert by_time.keep("new", 95_000, 99_000) is not None
    assert by_number._count <= 1_000
    assert by_number.keep("old", 0, 80_000) is None
    for recorder in (by_time, by_number):
        recorder.close()


def test_the_oldest_files_go_when_there_are_too_many(tmp_path):
    recorder = FlightRecorder(tmp_path, quota_bytes=60_000)
    recorder.push(events(0, 2_000))
    (tmp_path / "mine.txt").write_text("not its own")
    for k in range(6):
        path = recorder.keep(f"part{k}", 0, 20_000)
        recorder._writing[-1].result()
        os.utime(path, ns=(k, k))
    recorder.close()
    left = sorted(file.name for file in tmp_path.iterdir())
    assert "mine.txt" in left and "part5.h5" in left and "part0.h5" not in left
    assert sum(file.stat().st_size for file in tmp_path.glob("*.h5")) <= 60_000


def test_a_clock_that_was_reset_begins_anew(tmp_path):
    recorder = FlightRecorder(tmp_path)
    recorder.push(events(1_000_000, 100))
    recorder.push(events(0, 100))
    assert recorder.keep("before", 1_000_000, 1_001_000) is None
    path = recorder.keep("after", 0, 1_000)
    recorder.close()
    with open_recording(path) as recording:
        assert recording.read().t[-1] == 990


def test_a_disk_that_takes_nothing_stops_nothing(tmp_path, monkeypatch, caplog):
    recorder = FlightRecorder(tmp_path / "kept")
    recorder.push(events(0, 100))
    monkeypatch.setattr("evqr.sinks.flight_recorder.save_recording", lambda *given: fail())
    assert recorder.keep("part", 0, 1_000) is not None
    recorder.close()
    assert recorder.left_out == 1 and "No space left" in caplog.text
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot be made"):
        FlightRecorder(tmp_path / "file" / "kept")


def fail():
    raise OSError(28, "No space left on device")
