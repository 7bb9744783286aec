"""Recordings to readings: every code once, whatever the source, the options and the order of things."""

import pickle
from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest
from backends import BACKENDS
from scenes import at, events_at, joined, keep, middle_us, noise, scene, true_corners

import evqr
from evqr import AlignConfig, ReadConfig, ReadStatus, Reason, Vote, read_codes, read_many, read_windows
from evqr.events.array import EventArray
from evqr.motion import Motion
from evqr.results import CodeReading
from evqr.search.motion_estimate import MotionEstimate
from evqr.simulate import CodePlacement, shuffled

LONG = {"travel_px": 30.0}
"""Long enough to be read, followed, lost and found."""

HARD = {"preset": "hard", "speed_px_ms": 8.0, "travel_px": 20.0}

WIDE = {"width": 480, "height": 160}

CORNER_TOLERANCE = 0.3
"""Modules: windows of 2 px of travel, with the velocity of the first of them held for half a window."""


def assert_same(a, b):
    """All of two readings but the time they took."""
    for field in fields(CodeReading):
        if field.name != "compute_ms":
            np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name), err_msg=field.name)


def assert_same_results(a, b):
    assert (a.status, a.reason, a.seen) == (b.status, b.reason, b.seen)
    assert len(a.readings) == len(b.readings)
    for one, other in zip(a.readings, b.readings, strict=True):
        assert_same(one, other)


def only(result):
    """The one reading of a result."""
    assert [reading.text for reading in result.readings] == ["EVQR-07"]
    assert (result.status, result.reason) == (ReadStatus.READ, "")
    return result.readings[0]


def assert_true(reading, made, name="truth"):
    """Place and motion of a reading are those of the scene."""
    truth = made.truth[name]
    module_px = made.scene.codes[0].module_px
    off = np.abs(reading.corners_px - true_corners(truth, reading.t_read_us)).max() / module_px
    assert off < CORNER_TOLERANCE
    velocity = at(truth, "velocity", reading.t_read_us)
    error = np.hypot(*(reading.motion_px_per_s - velocity)) / np.hypot(*velocity)
    assert error < 0.2  # from cold, over 3 px: 12 % of speed, 10 degrees of direction


# ---- one code


@pytest.mark.parametrize(
    "options",
    [
        LONG,
        {"angle": 45.0, "direction": 110.0},
        {"angle": -160.0, "direction": 270.0, "preset": "fast", "speed_px_ms": 8.0},
        {"preset": "slow", "speed_px_ms": 1.0},
        {"preset": "hard", "speed_px_ms": 8.0, "travel_px": 20.0},
        {"version": 5, "ec": "L", "module_px": 4.0, "preset": "fast"},
        {"tilt": 10.0, "preset": "fast"},
        {"invert": True, "preset": "fast"},
    ],
    ids=["long", "45", "fast", "slow", "hard", "version-5", "tilt", "inverted"],
)
def test_a_code_is_read_once_and_where_it_is(options):
    made = scene(**options)
    reading = only(read_codes(made.events))
    truth = made.truth["truth"]
    assert reading.data == b"EVQR-07"
    assert reading.symbology == "QRCode"
    assert (reading.version, reading.ec_level, reading.mask) == (
        truth["version"],
        truth["ec_level"],
        truth["mask"],
    )
    np.testing.assert_array_equal(reading.modules, 1 - 2 * truth["modules"].astype(np.int8))
    assert reading.estimate.shape == reading.modules.shape
    assert 0.999 <= reading.confidence <= 1.0
    assert reading.errors_corrected >= 0
    assert reading.windows >= 1
    assert_true(reading, made)


def test_times_are_in_order_and_in_the_recording():
    made = scene(**LONG)
    reading = only(read_codes(made.events))
    first, last = int(made.events.t[0]), int(made.events.t[-1])
    assert first <= reading.t_first_us < reading.t_read_us <= reading.t_last_us <= last + 1
    assert reading.t_first_us < first + 500
    # followed in steps of 8 px, 2 ms here
    assert reading.t_last_us > last - 2500


def test_a_code_is_read_as_soon_as_it_is_seen():
    """One window of 2 px is enough in a clean scene: half a millisecond."""
    reading = only(read_codes(scene(**LONG).events))
    assert reading.windows == 1
    assert reading.t_read_us < 700


def test_result_says_what_was_seen_and_how_long_it_took():
    made = scene(**LONG)
    result = read_codes(made.events)
    assert result.seen["events"] == len(made.events)
    assert result.seen["duration_us"] == made.events.t[-1] - made.events.t[0]
    assert result.seen["searches"] >= 1
    assert result.seen["windows"] >= 2
    assert result.seen["codes_not_decoded"] == 0
    assert result.source == ""
    for times in (result.compute_ms, result.readings[0].compute_ms):
        assert {"motion", "finder", "stage_one", "stage_two", "decode", "total"} <= set(times)
        assert min(times.values()) >= 0.0
        assert times["total"] >= 0.99 * sum(ms for stage, ms in times.items() if stage != "total")
    assert result.compute_ms["total"] >= result.readings[0].compute_ms["total"]


# ---- sources


@pytest.fixture(scope="module")
def events():
    return scene(**LONG).events


@pytest.fixture(scope="module")
def read(events):
    return read_codes(events)


def test_a_file_gives_the_same_readings(events, read, tmp_path):
    for name in ("recording.h5", "recording.npz"):
        path = tmp_path / name
        evqr.save_recording(path, events)
        for source in (path, str(path)):
            result = read_codes(source)
            assert_same_results(result, read)
            assert result.source == str(path)


def test_a_structured_array_gives_the_same_readings(events, read):
    table = np.zeros(len(events), [("x", "<u2"), ("y", "<u2"), ("t", "<i8"), ("p", "u1")])
    table["t"], table["x"], table["y"], table["p"] = events.t, events.x, events.y, events.p > 0
    result = read_codes(table, sensor=(events.width, events.height), time_unit="us")
    assert_same_results(result, read)


def test_a_tuple_of_arrays_gives_the_same_readings(events, read):
    result = read_codes(
        (events.t * 1000, events.x.astype(np.int64), events.y.astype(np.float64), events.p),
        sensor=(events.width, events.height),
        time_unit="ns",
    )
    assert_same_results(result, read)


def test_an_open_recording_gives_the_same_readings_and_stays_open(events, read):
    with evqr.open_recording(events) as recording:
        assert_same_results(read_codes(recording), read)
        assert_same_results(read_codes(recording), read)


@pytest.mark.parametrize("chunk_events", [1_000, 77_777, 1 << 24])
def test_the_size_of_chunks_does_not_matter(chunk_events, events, read):
    with evqr.open_recording(events, chunk_events=chunk_events) as recording:
        assert_same_results(read_codes(recording), read)


def test_the_size_of_chunks_does_not_matter_to_a_reading_of_many_windows():
    events = scene(**HARD).events
    config, found = ReadConfig(window_us=60), []
    for chunk_events in (500, 1 << 20):
        with evqr.open_recording(events, chunk_events=chunk_events) as recording:
            found.append(read_codes(recording, config=config))
    assert_same_results(*found)
    assert only(found[0]).windows > 1


def test_time_may_start_anywhere(events, read):
    late = 1_633_953_690_975_950
    shifted = EventArray(events.t + late, events.x, events.y, events.p, events.width, events.height)
    ours, theirs = only(read), only(read_codes(shifted))
    for name in ("t_first_us", "t_read_us", "t_last_us"):
        assert getattr(theirs, name) == getattr(ours, name) + late
    np.testing.assert_allclose(theirs.corners_px, ours.corners_px, atol=1e-3)


def test_the_source_is_not_changed(events):
    before = [column.copy() for column in (events.t, events.x, events.y, events.p)]
    read_codes(events)
    for column, kept in zip((events.t, events.x, events.y, events.p), before, strict=True):
        np.testing.assert_array_equal(column, kept)


# ---- several codes


def two_codes(left, right, travel_px=24.0):
    codes = (
        CodePlacement(text=left, version=1, module_px=4.5, angle=20.0, offset_px=(-85.0, 0.0)),
        CodePlacement(text=right, version=1, module_px=4.5, angle=60.0, offset_px=(85.0, 0.0)),
    )
    return scene(codes=codes, width=420, direction=10.0, travel_px=travel_px)


@pytest.mark.parametrize("travel_px", [8.0, 24.0])
def test_two_codes_side_by_side(travel_px):
    made = two_codes("LEFT", "RIGHT", travel_px)
    result = read_codes(made.events)
    assert sorted(r.text for r in result.readings) == ["LEFT", "RIGHT"]
    for reading in result.readings:
        assert_true(reading, made, "truth" if reading.text == "LEFT" else "truth2")
    assert [r.t_read_us for r in result.readings] == sorted(r.t_read_us for r in result.readings)


def test_two_codes_of_one_text_side_by_side_are_two():
    result = read_codes(two_codes("SAME", "SAME").events)
    assert [r.text for r in result.readings] == ["SAME", "SAME"]
    apart = np.ptp([r.corners_px.mean(axis=0) for r in result.readings], axis=0)
    assert np.hypot(*apart) > 100.0


def test_two_codes_after_one_another():
    first, second = scene(), scene("SECOND", version=1, module_px=6.0, direction=200.0, seed=3)
    result = read_codes(joined(first.events, second.events, gap_us=10_000))
    assert [r.text for r in result.readings] == ["EVQR-07", "SECOND"]
    a, b = result.readings
    assert a.t_last_us <= first.events.t[-1] + 1
    assert b.t_first_us > first.events.t[-1] + 9_000


def test_the_same_text_on_a_second_object_is_a_second_reading(events):
    result = read_codes(joined(events, events, gap_us=50_000))
    assert [r.text for r in result.readings] == ["EVQR-07", "EVQR-07"]
    a, b = result.readings
    assert a.t_last_us < b.t_first_us


@pytest.mark.parametrize("until_us", [4_000, 10_000])
def test_a_code_that_is_lost_for_a_while_is_one_reading(until_us):
    """Without any event for 4 px of travel, and for 28 px: then it has to be searched anew."""
    events = scene(travel_px=60.0, version=1).events
    reading = only(read_codes(keep(events, (events.t < 3_000) | (events.t >= until_us))))
    assert reading.t_first_us < 500
    assert reading.t_last_us > until_us


def test_something_slow_does_not_blind_the_reader():
    """10 px of its travel take 100 ms, in which a code could pass."""
    slow = scene(code=False, speed_px_ms=0.1, travel_px=4.0, **WIDE)
    fast = scene(speed_px_ms=10.0, travel_px=220.0, version=1, module_px=4.0, direction=0.0, **WIDE)
    only(read_codes(joined(slow.events, fast.events)))


def test_a_code_right_after_something_that_looks_like_one():
    decoy = scene(code=False, travel_px=50.0)
    only(read_codes(joined(decoy.events, scene().events, gap_us=3_000)))


@pytest.mark.parametrize("speed_px_ms", [4.0, 8.0])
@pytest.mark.parametrize("travel_px", [3.0, 4.0])
def test_a_recording_that_ends_within_the_first_windows_is_read(speed_px_ms, travel_px):
    """Windows for the motion are cut where the recording ends: their second halves would be empty else."""
    made = scene(speed_px_ms=speed_px_ms, travel_px=travel_px)
    only(read_codes(made.events))
    (first, *_) = read_windows(made.events)
    assert first.text == "EVQR-07"


# ---- nothing to read


def assert_nothing(result, words=1):
    assert result.status is ReadStatus.NO_READ
    assert result.readings == ()
    assert len(result.reason.split()) >= words
    assert "\n" not in result.reason


@pytest.mark.parametrize("preset", ["clean", "fast"])
def test_things_that_are_no_code_give_nothing(preset):
    result = read_codes(scene(code=False, preset=preset).events)
    assert_nothing(result, words=3)
    assert result.seen["searches"] >= 1


def test_shuffled_events_give_nothing(events):
    assert_nothing(read_codes(shuffled(events, seed=1)))


def test_where_a_search_only_disagrees_its_best_candidate_is_told():
    made = scene()
    nothing = read_codes(made.events, config=ReadConfig(align=AlignConfig(min_score=1.0, good_score=1.0)))
    assert_nothing(nothing)
    assert nothing.reason_code is Reason.DISAGREES
    (taken,) = nothing.nearest.candidates
    assert taken.symbol == "QRCode 2"
    assert f"{taken.score:.2f}" in nothing.reason
    off_px = np.abs(taken.corners_px - true_corners(made.truth["truth"], nothing.nearest.t_us)).max()
    assert off_px < 2.0 * made.scene.codes[0].module_px


@pytest.mark.parametrize("times", [[7], [7, 7, 7], range(7, 70)])
def test_a_few_events_are_too_few(times):
    result = read_codes(events_at(times))
    assert_nothing(result, words=2)
    assert result.reason_code in (Reason.TOO_FEW_EVENTS, Reason.NOTHING_MOVES)


@pytest.mark.parametrize("threads", [1, 2])
def test_what_does_not_move_at_all_gives_nothing(threads, events, monkeypatch):
    """A peak of the correlation at no shift that is no vertex either: its place is whole steps, so zero."""

    def still(*_, **__):
        return MotionEstimate(Motion(np.zeros(2)), 0.5)
        yield  # asks for no window

    monkeypatch.setattr("evqr.solver.find_motion", still)
    monkeypatch.setattr("evqr.work.motion_probes", still)
    assert read_codes(events, threads=threads).status is ReadStatus.NO_READ
    windows = list(read_windows(events, config=ReadConfig(max_windows=4), threads=threads))
    assert [window.status for window in windows] == [ReadStatus.NO_CODE] * 4
    assert [window.reason for window in windows] == ["nothing moves"] * 4


@pytest.mark.parametrize("count", [1, 150, 100_000])
def test_noise_gives_nothing(count):
    assert_nothing(read_codes(noise(count, 20_000)))


@pytest.mark.parametrize("side", [8, 32, 60])
def test_a_sensor_that_is_too_small_for_a_code_sees_none(side, events):
    inside = (abs(events.x - 160.0) < side / 2) & (abs(events.y - 120.0) < side / 2)
    part = keep(events, inside)
    x, y = part.x - part.x.min(), part.y - part.y.min()
    result = read_codes(EventArray(part.t, x, y, part.p, side, side))
    assert_nothing(result)


def test_a_recording_without_events_is_refused():
    with pytest.raises(evqr.RecordingError, match="empty"):
        read_codes(noise(0, 1))


def test_time_run_backwards_gives_no_wrong_text():
    """The code is in it, with motion and polarity reversed: read it rightly or not at all."""
    forward = scene().events
    backward = EventArray(
        (forward.t[-1] - forward.t)[::-1], forward.x[::-1], forward.y[::-1], -forward.p[::-1], 320, 240
    )
    assert {r.text for r in read_codes(backward).readings} == {"EVQR-07"}


def test_a_mirrored_view_gives_no_wrong_text():
    made = scene().events
    mirrored = EventArray(made.t, (319 - made.x).astype(np.uint16), made.y, made.p, 320, 240)
    assert {r.text for r in read_codes(mirrored).readings} <= {"EVQR-07"}


# ---- options


@pytest.mark.parametrize("vote", Vote)
def test_every_vote_reads_a_hard_scene(vote):
    only(read_codes(scene(**HARD).events, config=ReadConfig(vote=vote)))


@pytest.mark.parametrize("window_us", [200, 250, 1000])
def test_windows_of_fixed_length(window_us, events):
    reading = only(read_codes(events, config=ReadConfig(window_us=window_us)))
    if reading.windows == 1:
        assert reading.t_read_us - reading.t_first_us == window_us
    assert_true(reading, scene(**LONG))


def test_travel_sets_the_length_of_windows(events):
    lengths = []
    for travel_px in (1.5, 3.0):
        reading = only(read_codes(events, config=ReadConfig(travel_px=travel_px)))
        lengths.append((reading.t_read_us - reading.t_first_us) / reading.windows)
    assert lengths[1] == pytest.approx(2.0 * lengths[0], rel=0.15)


@pytest.mark.parametrize("most", [1, 2, 3])
def test_no_more_windows_than_asked_for(most, events):
    result = read_codes(events, config=ReadConfig(max_windows=most))
    assert result.seen["windows"] <= most
    only(result)


def test_lags_that_are_given_are_not_estimated():
    made = scene(**HARD)
    for lag_us in ((150.0, 350.0), (300.0, 600.0)):
        result = read_codes(made.events, config=ReadConfig(lag_us=lag_us))
        only(result)
        assert "lag" not in result.compute_ms


def test_lags_put_the_code_in_its_place():
    """Lagging pixels show the code behind itself; undone, it is where the truth says."""
    made = scene(**HARD)
    truth, off = made.truth["truth"], []
    for lag_us in ((0.0, 0.0), (300.0, 600.0)):
        reading = only(read_codes(made.events, config=ReadConfig(lag_us=lag_us)))
        behind = true_corners(truth, reading.t_read_us) - reading.corners_px
        velocity = at(truth, "velocity", reading.t_read_us)
        off.append(float((behind @ velocity).mean() / np.hypot(*velocity)))
    assert off[0] > 1.0
    assert abs(off[1]) < 0.6 * off[0]


def test_progress_goes_forward_to_the_end(events):
    calls = []
    read_codes(events, progress=lambda done, whole: calls.append((done, whole)))
    done = [call[0] for call in calls]
    assert len(calls) >= 3
    assert done == sorted(done)
    assert done[0] >= 0
    whole = events.t[-1] - events.t[0]
    assert {call[1] for call in calls} == {whole}
    assert 0.5 * whole < done[-1] <= whole


def test_threads_search_ahead_and_read_the_same():
    """50 px of something else before the code comes: searches on two threads find it, each time alike."""
    made = scene(travel_px=60.0, version=1)
    before = scene(code=False, travel_px=50.0)
    events = joined(before.events, made.events, gap_us=3_000)
    one = only(read_codes(events))
    two = [read_codes(events, threads=2) for _ in range(2)]
    assert_same_results(*two)
    start = int(before.events.t[-1]) + 3_001
    for reading in (one, only(two[0])):
        assert start <= reading.t_first_us < reading.t_read_us < start + made.events.t[-1]
        off = np.abs(reading.corners_px - true_corners(made.truth["truth"], reading.t_read_us - start)).max()
        assert off < 5.0 * CORNER_TOLERANCE


@pytest.mark.parametrize("threads", [0, -1])
def test_no_threads_are_refused(threads, events):
    with pytest.raises(ValueError, match=f"threads must be at least 1, got {threads}"):
        read_codes(events, threads=threads)


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_backend_reads_the_same(backend):
    made = scene()
    ours, theirs = (only(read_codes(made.events, backend=name)) for name in ("warp", backend))
    assert (ours.text, ours.version, ours.mask) == (theirs.text, theirs.version, theirs.mask)
    np.testing.assert_array_equal(ours.modules, theirs.modules)
    np.testing.assert_allclose(ours.corners_px, theirs.corners_px, atol=0.5)


@pytest.mark.parametrize("options", [{"backend": "abacus"}, {"device": "cuda:99"}], ids=str)
def test_what_is_not_there_is_refused(options, events):
    with pytest.raises(evqr.BackendError, match=r"abacus|cuda:99") as caught:
        read_codes(events, **options)
    assert isinstance(caught.value, evqr.EvqrError) and isinstance(caught.value, ValueError)
    (result,) = read_many([events], **options)
    assert (result.status, result.reason_code) == (ReadStatus.ERROR, Reason.BACKEND_UNAVAILABLE)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"window_us": 0}, "window_us must be a whole number, at least 1, or None, got 0"),
        ({"max_windows": 0}, "max_windows must be a whole number, at least 1, or None, got 0"),
        ({"travel_px": 0.1}, "travel_px must be a number, at least 0.2 and at most 50, got 0.1"),
        ({"lag_us": (-1.0, 5.0)}, "lag_us must be a tuple of 2, each a number, at least 0 and at most"),
        ({"lag_us": (1.0, float("nan"))}, "lag_us must be a tuple of 2, each a number, .* got .1.0, nan."),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_settings_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        ReadConfig(**options)


# ---- results


def test_two_runs_are_the_same_bit_for_bit(events, read):
    assert_same_results(read_codes(events, backend="warp", device="cpu"), read)
    hard = scene(**HARD).events
    assert_same_results(*(read_codes(hard, backend="warp", device="cpu") for _ in range(2)))


def test_results_can_be_pickled(read):
    again = pickle.loads(pickle.dumps(read))
    assert_same_results(again, read)
    assert dict(again.readings[0].compute_ms) == dict(read.readings[0].compute_ms)
    assert again.status is ReadStatus.READ


def test_results_are_frozen(read):
    with pytest.raises(FrozenInstanceError):
        read.status = ReadStatus.NO_READ
    with pytest.raises(FrozenInstanceError):
        read.readings[0].text = "another"


def test_a_reading_keeps_its_numbers_when_more_is_read(events):
    """Arrays of a result are its own, not buffers that are used again."""
    reading = only(read_codes(events))
    kept = [
        getattr(reading, name).copy() for name in ("corners_px", "motion_px_per_s", "modules", "estimate")
    ]
    read_codes(scene(preset="fast", angle=45.0).events)
    for name, value in zip(("corners_px", "motion_px_per_s", "modules", "estimate"), kept, strict=True):
        np.testing.assert_array_equal(getattr(reading, name), value)


def test_the_middle_of_a_recording_alone_is_enough():
    """A code that is in view from the first event to the last, met in mid-course."""
    made = scene(**LONG)
    middle = middle_us(made)
    reading = only(read_codes(made.events.between(middle, middle + 2000)))
    assert middle <= reading.t_first_us < reading.t_read_us <= middle + 2000
    assert_true(reading, made)
