"""Every format that is written gives back what was written, of any size, and from the command line."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_files import HEIGHT, WIDTH, WRITERS, assert_same_events, make_events

from evqr.errors import RecordingError, UsageError
from evqr.events.array import EventArray
from evqr.main import run
from evqr.recording import convert_recording, open_recording, save_recording

SUFFIXES = [".h5", ".hdf5", ".npz", ".txt", ".csv", ".raw", ".aedat4"]
EVENTS = make_events(3000)


def read(path, **options):
    with open_recording(path, **options) as recording:
        assert recording.notes == ()
        return recording.read()


def skip_without_extra(suffix):
    for package in {".raw": ["evt3"], ".aedat4": ["eventcv", "aedat"]}.get(suffix, []):
        pytest.importorskip(package)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("chunk_events", [700, 1 << 20])
def test_round_trip(tmp_path, suffix, chunk_events):
    skip_without_extra(suffix)
    with open_recording(EVENTS, chunk_events=chunk_events) as recording:
        done = []
        assert convert_recording(recording, tmp_path / f"a{suffix}", progress=lambda *a: done.append(a)) == ()
    assert_same_events(read(tmp_path / f"a{suffix}"), EVENTS)
    assert done[-1] == (EVENTS.t[-1] - EVENTS.t[0],) * 2
    assert [file.name for file in tmp_path.iterdir()] == [f"a{suffix}"]


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 1000),
    start_us=st.sampled_from([0, 5, (1 << 24) - 1_000]),
    silences=st.lists(st.integers(0, 200_000_000), max_size=4),
    chunk_events=st.integers(1, 50),
)
def test_no_turn_of_evt3s_clock_is_lost(tmp_path_factory, seed, start_us, silences, chunk_events):
    pytest.importorskip("evt3")
    events = make_events(60, seed=seed, start_us=start_us)
    t = events.t.copy()
    for i, silence in enumerate(silences):
        t[10 * (i + 1) :] += silence
    events = EventArray(t, events.x, events.y // 8, events.p, WIDTH, HEIGHT)
    path = tmp_path_factory.getbasetemp() / "a.raw"
    with open_recording(events, chunk_events=chunk_events) as recording:
        convert_recording(recording, path)
    shift = t[0] // (1 << 24) * (1 << 24)
    assert_same_events(read(path), EventArray(t - shift, events.x, events.y, events.p, WIDTH, HEIGHT))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_times_since_1970(tmp_path, suffix):
    skip_without_extra(suffix)
    start = 1_700_000_000_000_000
    later = EventArray(EVENTS.t + start, EVENTS.x, EVENTS.y, EVENTS.p, WIDTH, HEIGHT)
    with open_recording(later) as recording:
        notes = convert_recording(recording, tmp_path / f"a{suffix}")
    got = read(tmp_path / f"a{suffix}")
    assert len(notes) == (suffix == ".raw")
    shift = later.t[0] // (1 << 24) * (1 << 24) if suffix == ".raw" else 0
    np.testing.assert_array_equal(got.t, later.t - shift)


def test_the_command(tmp_path, capsys):
    WRITERS["text"](tmp_path / "a.txt", EVENTS)
    source, out = str(tmp_path / "a.txt"), str(tmp_path / "b.npz")
    assert run(["convert", source, out]) == 0
    assert "b.npz: 3,000 events in" in capsys.readouterr().out
    assert_same_events(read(out), EVENTS)
    assert run(["convert", source, out]) == 2
    assert "is there already; choose another name, or write over it with --force" in capsys.readouterr().err
    start, end = EVENTS.t[500], EVENTS.t[2000]
    assert run(["convert", source, out, "--force", "--start-us", str(start), "--end-us", str(end)]) == 0
    assert_same_events(read(out), EVENTS.between(start, end))
    assert run(["convert", source, source, "--force"]) == 2
    assert run(["convert", source, str(tmp_path / "b.xyz")]) == 2
    assert "recordings are written as .h5" in capsys.readouterr().err


def test_what_fails_leaves_no_file(tmp_path, monkeypatch):
    (tmp_path / "a.h5").write_text("as it was")
    broken = EventArray(EVENTS.t, EVENTS.x, EVENTS.y, EVENTS.p, WIDTH, HEIGHT)
    with open_recording(broken) as recording:

        def chunks():
            yield EVENTS.cut(0, 10)
            raise RecordingError("a: damaged")

        monkeypatch.setattr(recording, "chunks", chunks)
        for suffix in SUFFIXES[:-1]:
            with pytest.raises(RecordingError, match="damaged"):
                convert_recording(recording, tmp_path / f"a{suffix}")
    assert [file.name for file in tmp_path.iterdir()] == ["a.h5"]
    assert (tmp_path / "a.h5").read_text() == "as it was"


def test_what_a_format_has_no_place_for(tmp_path):
    with pytest.raises(UsageError, match=r"written with their truth as \.h5, \.hdf5, \.npz"):
        save_recording(tmp_path / "a.txt", EVENTS, truth={"truth": {"payload": "A"}})
    wide = EventArray(EVENTS.t, EVENTS.x, EVENTS.y, EVENTS.p, 4096, HEIGHT)
    with pytest.raises(UsageError, match="EVT3 has room for 2048x2048 pixels, not for 4096x48"):
        save_recording(tmp_path / "a.raw", wide)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".raw", ".aedat4"])
def test_a_peer_reads_the_same(tmp_path, suffix):
    eventcv = pytest.importorskip("eventcv")
    with open_recording(EVENTS, chunk_events=700) as recording:
        convert_recording(recording, tmp_path / f"a{suffix}")
    theirs = eventcv.load(str(tmp_path / f"a{suffix}"), time_unit="us").numpy()
    ours = np.stack([EVENTS.x, EVENTS.y, EVENTS.t, EVENTS.p > 0], axis=1)
    np.testing.assert_array_equal(theirs, ours)


def test_whatever_can_be_opened_can_be_converted(tmp_path):
    columns = (EVENTS.t, EVENTS.x, EVENTS.y, EVENTS.p)
    convert_recording(columns, tmp_path / "a.npz", sensor=(EVENTS.width, EVENTS.height), time_unit="us")
    convert_recording(tmp_path / "a.npz", tmp_path / "b.h5", start_us=int(EVENTS.t[1]) + 1)
    with open_recording(tmp_path / "b.h5") as recording:
        assert 0 < len(recording.read()) < len(EVENTS)
        with pytest.raises(TypeError, match="is open already: pass sensor to open_recording"):
            convert_recording(recording, tmp_path / "c.h5", sensor="64x48")
    with pytest.raises(TypeError, match="got int"):
        convert_recording(3, tmp_path / "c.h5")
