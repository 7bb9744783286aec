"""A little that is wrong is left out and counted; more is refused; strictly, anything is."""

import errno

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_files import HEIGHT, WIDTH, WRITERS, assert_same_events, make_events, write_h5

import evqr.recording.recognise
from evqr.errors import RecordingError, UsageError
from evqr.events.array import EventArray
from evqr.recording import open_recording, summarise
from evqr.recording.clock import EPOCH_GAP_US, FEW_EVENTS, MAX_DISORDER_US, ClockWatch
from evqr.recording.faults import JUDGED_EVENTS, MAX_LEFT_OUT_SHARE, Faults
from evqr.recording.source import explained, refusal

SENSOR = (WIDTH, HEIGHT)
EVENTS = make_events(1000, span_us=1_000_000, start_us=2_000_000)
CHUNKS = [7, 100, 1 << 20]


def read(columns, **options):
    with open_recording(columns, **{"sensor": SENSOR, "time_unit": "us", **options}) as recording:
        return recording.read(), recording


def columns(events=EVENTS, **changes):
    return tuple(
        np.asarray(changes.get(c, getattr(events, c)), None if c in changes else np.int64) for c in "txyp"
    )


def changed(column: str, at, values) -> np.ndarray:
    copy = getattr(EVENTS, column).astype(np.int64)
    copy[at] = values
    return copy


def without(*at) -> EventArray:
    keep = np.setdiff1d(np.arange(len(EVENTS)), at)
    return EventArray(EVENTS.t[keep], EVENTS.x[keep], EVENTS.y[keep], EVENTS.p[keep], WIDTH, HEIGHT)


@pytest.mark.parametrize("chunk_events", CHUNKS)
@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"t": changed("t", 500, EVENTS.t[500] - 999_000)}, "times jump back by"),
        ({"t": changed("t", 500, EVENTS.t[500] + 999_000)}, "of event 500 is far ahead of those around it"),
        ({"t": changed("t", 500, 1 << 60)}, "is far ahead of those around it"),
        ({"t": changed("t", 0, 1 << 50)}, "of event 0 is far ahead"),
        ({"t": changed("t", 500, -7)}, "time -7 of event 500 is negative"),
        ({"x": changed("x", 500, 64)}, "x 64 of event 500 is outside the 64x48 sensor"),
        ({"y": changed("y", 500, -1)}, "y -1 of event 500 is outside the 64x48 sensor"),
        (
            {"y": changed("y", 500, 3).astype(float) + np.where(np.arange(1000) == 500, 0.5, 0)},
            "y 3.5 of event 500",
        ),
        ({"p": changed("p", 500, 7)}, "polarity 7 of event 500 fits neither"),
    ],
)
def test_one_wrong_event_is_left_out(changes, told, chunk_events):
    at = 0 if "event 0 " in told else 500
    got, recording = read(columns(**changes), chunk_events=chunk_events)
    assert_same_events(got, without(at))
    assert recording.counts.left_out == 1
    assert recording.notes[-1].startswith("1 event was wrong and left out, the first: ")
    assert told in recording.notes[-1]
    assert recording.n_events == 999
    with pytest.raises(RecordingError):
        read(columns(**changes), chunk_events=chunk_events, strict=True)


@pytest.mark.parametrize("chunk_events", CHUNKS)
@pytest.mark.parametrize("count", [1, 10, 11, 40, 1000])
def test_no_more_than_the_share_is_left_out(count, chunk_events):
    at = np.linspace(0, 999, count).astype(int)
    source = columns(x=changed("x", at, 99))
    if count <= MAX_LEFT_OUT_SHARE * 1000:
        got, recording = read(source, chunk_events=chunk_events)
        assert_same_events(got, without(at))
        assert recording.counts.left_out == count
        return
    with pytest.raises(
        RecordingError, match=rf"x 99 of event 0 is outside .* \({count:,} of 1,000 events are wrong"
    ):
        read(source, chunk_events=chunk_events)


def test_a_wrong_option_is_noticed_early():
    faults = Faults("name")
    faults.met = 5_000
    with pytest.raises(RecordingError, match="up to 1% are left out"):
        faults.leave_out(int(MAX_LEFT_OUT_SHARE * JUDGED_EVENTS) + 1, "wrong", "mend it")


@pytest.mark.parametrize("chunk_events", CHUNKS)
@pytest.mark.parametrize("back_to_us", [0, 100, 1_000_000])
def test_a_clock_that_was_reset_starts_an_epoch(back_to_us, chunk_events):
    t = EVENTS.t.copy()
    t[600:] += back_to_us - t[600]
    got, recording = read(columns(t=t), chunk_events=chunk_events)
    assert len(got) == 1000
    np.testing.assert_array_equal(got.x, EVENTS.x)
    np.testing.assert_array_equal(np.diff(got.t[600:]), np.diff(EVENTS.t[600:]))
    assert got.t[600] - got.t[599] == EPOCH_GAP_US
    assert recording.counts.epochs == 2
    assert recording.notes[0].startswith(
        f"the clock was reset: from {t[599]} us to {t[600]} us at event 600; times"
    )
    with pytest.raises(RecordingError, match=rf"times jump back by .* to {back_to_us} us at event 600"):
        read(columns(t=t), chunk_events=chunk_events, strict=True)


def test_two_resets_and_a_stray_stamp():
    t = EVENTS.t.copy()
    t[400:] -= t[400]
    t[700:] -= t[700]
    t[100] = 5
    got, recording = read(columns(t=t))
    assert (len(got), recording.counts.epochs, recording.counts.left_out) == (999, 3, 1)
    assert np.all(np.diff(got.t) >= 0)
    np.testing.assert_array_equal(got.x, without(100).x)


def test_a_silence_is_no_fault():
    for gap_us in (60_000, 10**9):
        t = EVENTS.t + np.where(np.arange(1000) < 300, 0, gap_us) + np.where(np.arange(1000) < 995, 0, gap_us)
        got, recording = read(columns(t=t))
        np.testing.assert_array_equal(got.t, t)
        assert recording.notes == ()


def test_sparse_events_are_no_fault():
    t = np.cumsum(np.random.default_rng(0).integers(0, 4 * MAX_DISORDER_US, 1000))
    for chunk_events in CHUNKS:
        got, recording = read(columns(t=t), chunk_events=chunk_events, strict=True)
        np.testing.assert_array_equal(got.t, t)
        assert recording.notes == ()


@settings(max_examples=50, deadline=None)
@given(
    stray=st.dictionaries(st.integers(20, 299), st.integers(0, 10**9), max_size=3),
    reset=st.none() | st.integers(50, 250),
    chunk_events=st.sampled_from([1, 13, 1000]),
)
def test_what_the_clock_leaves_is_the_same_in_any_pieces_and_rises(stray, reset, chunk_events):
    events = make_events(300, span_us=600_000, start_us=100_000_000)
    t = events.t.copy()
    if reset is not None:
        t[reset:] -= t[reset]
    for at, value in stray.items():
        t[at] = value
    events = EventArray(t, events.x, events.y, events.p, WIDTH, HEIGHT)

    def passed(pieces):
        faults = Faults("name")
        faults.met = 10**6
        clock = ClockWatch(faults)
        parts = [part for i in range(0, 300, pieces) for part in clock.push(events.cut(i, i + pieces))]
        return np.concatenate([part.t for part in (*parts, *clock.finish())]), faults

    got, faults = passed(chunk_events)
    whole, _ = passed(300)
    np.testing.assert_array_equal(got, whole)
    assert np.all(np.maximum.accumulate(got) - got <= MAX_DISORDER_US)
    assert len(got) + faults.left_out == 300
    assert faults.left_out <= FEW_EVENTS * (1 + len(stray))


@pytest.mark.parametrize("chunk_events", CHUNKS)
def test_a_cut_of_the_time(chunk_events):
    start, end = int(EVENTS.t[100]), int(EVENTS.t[800])
    got, recording = read(EVENTS, start_us=start, end_us=end, time_unit=None, chunk_events=chunk_events)
    assert_same_events(got, EVENTS.between(start, end))
    assert (recording.n_events, recording.t_first_us) == (len(got), got.t[0])
    assert_same_events(read(EVENTS, end_us=end, time_unit=None)[0], EVENTS.between(0, end))
    with pytest.raises(RecordingError, match="no event from 9000000 us"):
        read(EVENTS, start_us=9_000_000)
    with pytest.raises(UsageError, match="nothing lies from 5 us to 5 us"):
        read(EVENTS, start_us=5, end_us=5)


def test_files_that_end_in_mid_event(tmp_path):
    for kind, text in (("text", "line 1,000 is no event"), ("npy", "is truncated after 99")):
        WRITERS[kind](tmp_path / kind, make_events(999))
        whole = (tmp_path / kind).read_bytes()
        (tmp_path / kind).write_bytes(whole[:-5])
        got, recording = read(tmp_path / kind, time_unit=None)
        assert_same_events(got, make_events(999).cut(0, 998))
        assert recording.notes == (f"the file is cut short: {recording.notes[0][23:-18]}; read up to there",)
        assert text in recording.notes[0]
        with pytest.raises(RecordingError, match="truncated"):
            read(tmp_path / kind, time_unit=None, strict=True)


def test_lines_that_are_no_events_are_left_out(tmp_path):
    WRITERS["text"](tmp_path / "a", EVENTS)
    lines = (tmp_path / "a").read_text().splitlines(keepends=True)
    lines[300] = "\0\0\0garbage\n"
    lines[400] = "1 2 3\n"
    (tmp_path / "a").write_text("".join(lines))
    for chunk_events in CHUNKS:
        got, recording = read(tmp_path / "a", time_unit=None, chunk_events=chunk_events)
        assert_same_events(got, without(299, 399))
        assert "2 events were wrong and left out, the first: line 301 is no event" in recording.notes[0]


def test_info_counts():
    t = EVENTS.t.copy()
    t[500:] -= t[500]
    with open_recording(columns(t=t, x=changed("x", 3, 99)), sensor=SENSOR, time_unit="us") as recording:
        info = summarise(recording)
    assert (info.events, info.left_out, info.epochs, info.late) == (999, 1, 2, 0)
    assert len(info.notes) == 2


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (PermissionError(errno.EACCES, "Permission denied"), "check its permissions"),
        (BlockingIOError(errno.EAGAIN, "unable to lock file"), "is in use by another program"),
        (OSError(errno.ENOSPC, "No space left on device"), "is full; make room, or set TMPDIR"),
        (OSError(errno.EMFILE, "Too many open files"), "too many files are open"),
        (OSError(errno.EIO, "Input/output error"), "check the device or the connection"),
        (FileNotFoundError(errno.ENOENT, "No such file", "part.h5"), "file part.h5 is not there any more"),
        (MemoryError(), "needs more memory than there is"),
    ],
)
def test_what_the_system_refuses_is_no_damage(tmp_path, error, told, monkeypatch):
    with pytest.raises(RecordingError, match=r"^name: ") as caught, explained("name", "HDF5 file"):
        raise error
    assert told in str(caught.value)
    assert "damaged" not in str(caught.value)
    assert refusal(ValueError("no")) is None
    write_h5(tmp_path / "a", EVENTS)

    def refuse(*_):
        raise error

    if isinstance(error, OSError) and error.errno != errno.ENOSPC:
        monkeypatch.setattr(evqr.recording.recognise, "open", refuse, raising=False)
        with pytest.raises(RecordingError, match=r"a: ") as caught:
            open_recording(tmp_path / "a")
        assert told in str(caught.value)
