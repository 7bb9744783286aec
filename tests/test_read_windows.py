"""Windows of a recording, each read alone and from cold."""

import pickle
from collections.abc import Iterator
from dataclasses import FrozenInstanceError, fields, replace

import numpy as np
import pytest
from scenes import at, find, joined, noise, scene

from evqr import ReadConfig, ReadStatus, Reason, Solver, read_windows
from evqr.events.window import make_window
from evqr.results import WindowReading
from evqr.simulate import CodePlacement

LONG = {"travel_px": 30.0}


@pytest.fixture(scope="module")
def made():
    return scene(**LONG)


def windows_of(events, *, threads=None, **options):
    return list(read_windows(events, config=ReadConfig(**options), threads=threads))


def assert_same(a, b, but=("compute_ms",)):
    for field in fields(WindowReading):
        if field.name not in but:
            np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name), err_msg=field.name)


@pytest.mark.parametrize("count", [1, 4, 7])
@pytest.mark.parametrize("window_us", [None, 400])
def test_windows_are_spread_evenly(count, window_us, made):
    found = windows_of(made.events, max_windows=count, window_us=window_us)
    assert [w.window for w in found] == list(range(count))
    first, last = int(made.events.t[0]), int(made.events.t[-1])
    expected = first + np.arange(count) * (last + 1 - first) / count
    np.testing.assert_allclose([w.t_start_us for w in found], expected, atol=1.0)
    for w in found:
        assert w.n_events == len(made.events.between(w.t_start_us, w.t_end_us))
        if window_us is not None:
            assert w.t_end_us - w.t_start_us == window_us


def test_without_a_number_they_follow_one_another(made):
    found = windows_of(made.events, window_us=900)
    starts, ends = [w.t_start_us for w in found], [w.t_end_us for w in found]
    assert starts[1:] == ends[:-1]
    assert starts[0] == made.events.t[0]
    assert ends[-1] > made.events.t[-1] >= starts[-1]


def test_windows_adapt_to_the_motion():
    """2 px of travel, whatever the speed."""
    for speed in (1.0, 8.0):
        for w in windows_of(scene(speed_px_ms=speed, travel_px=16.0).events, max_windows=3):
            travel = (w.t_end_us - w.t_start_us) * speed / 1000.0
            assert travel == pytest.approx(2.0, rel=0.15)


@pytest.mark.parametrize(
    ("options", "least"),
    [(LONG, 7), ({**LONG, "preset": "fast", "speed_px_ms": 8.0}, 7), ({**LONG, "invert": True}, 7)],
    ids=["clean", "fast", "inverted"],
)
def test_nearly_every_window_is_read(options, least):
    found = windows_of(scene(**options).events, max_windows=7)
    assert sum(w.status is ReadStatus.READ for w in found) >= least
    for w in found:
        if w.status is ReadStatus.READ:
            assert (w.text, w.version, w.reason) == ("EVQR-07", 2, "")
        else:
            assert w.text is None
            assert w.reason


def test_a_window_says_where_the_code_is(made):
    """W takes px to modules, integers at module centres: a finder pattern's is module 3 or r - 4."""
    truth = made.truth["truth"]
    centres = np.array([[3.5, 3.5], [21.5, 3.5], [3.5, 21.5], [12.5, 12.5]])
    for w in windows_of(made.events, max_windows=5):
        middle = 0.5 * (w.t_start_us + w.t_end_us)
        pose = at(truth, "H", middle)
        x, y, z = pose @ np.column_stack([centres, np.ones(4)]).T
        px = np.stack([x / z, y / z, np.ones(4)])
        np.testing.assert_allclose((w.affine @ px).T, centres - 0.5, atol=0.2)
        velocity = at(truth, "velocity", middle)
        assert np.hypot(*(w.motion_px_per_s - velocity)) < 0.2 * np.hypot(*velocity)


def test_affine_of_a_tilted_code_is_right_in_its_middle():
    made = scene(tilt=20.0, **LONG)
    for w in windows_of(made.events, max_windows=3):
        pose = at(made.truth["truth"], "H", 0.5 * (w.t_start_us + w.t_end_us))
        x, y, z = pose @ (12.5, 12.5, 1.0)
        np.testing.assert_allclose(w.affine @ (x / z, y / z, 1.0), [12.0, 12.0], atol=0.2)


def test_modules_are_estimates_with_the_right_signs(made):
    modules = 1 - 2.0 * made.truth["truth"]["modules"]
    for w in windows_of(made.events, max_windows=4):
        assert w.modules.shape == (25, 25)
        assert w.modules.dtype == np.float32
        assert np.mean(w.modules * modules > 0.0) > 0.98
        assert w.stage_one_iterations > 0
        assert w.stage_two_iterations > 0


def test_a_code_that_does_not_decode_still_has_modules():
    """Polarities in the lower right of the print are random: more than the 7 % that level L corrects."""
    made = scene(ec="L", **LONG)
    events, truth = made.events, made.truth["truth"]
    velocity = truth["velocity"][0]
    place = np.stack([events.x - velocity[0] * 1e-6 * events.t, events.y - velocity[1] * 1e-6 * events.t])
    u, v, _ = np.linalg.inv(truth["H"][0]) @ np.vstack([place, np.ones(len(events))])
    stained = (u > 8.5) & (v > 8.5) & (u < 25.0) & (v < 25.0)
    coins = np.random.default_rng(0).choice(np.array([-1, 1], np.int8), len(events))
    for w in windows_of(replace(events, p=np.where(stained, coins, events.p)), max_windows=3):
        assert w.status is ReadStatus.NO_READ
        assert (w.text, w.version) == (None, 2)
        assert w.reason
        right = w.modules * (1 - 2.0 * truth["modules"]) > 0.0
        assert right[:8].mean() > 0.97
        assert right[10:, 10:].mean() < 0.8
        assert w.affine.shape == (2, 3)
        assert w.motion_px_per_s.shape == (2,)


def test_windows_without_a_code():
    for events in (scene(code=False).events, noise(30_000, 10_000)):
        for w in windows_of(events, max_windows=4):
            assert w.status is not ReadStatus.READ
            assert w.text is None
            assert len(w.reason.split()) >= 2
            if w.status is ReadStatus.NO_CODE:
                assert (w.version, w.modules, w.motion_px_per_s, w.affine) == (None, None, None, None)


def test_a_window_is_read_alone(made):
    """The same windows, among others: no window knows of another."""
    many = windows_of(made.events, max_windows=6)
    few = windows_of(made.events, max_windows=3)
    assert [w.t_start_us for w in many[::2]] == [w.t_start_us for w in few]
    for a, b in zip(many[::2], few, strict=True):
        assert_same(a, b, but=("compute_ms", "window"))


def test_a_window_is_what_a_fresh_solver_sees(made):
    for w in windows_of(made.events, max_windows=3, window_us=500):
        solver = Solver(ReadConfig(window_us=500))
        window = make_window(made.events, w.t_start_us, w.t_end_us)
        found = find(solver, window, solver.motion_in(window).motion)
        np.testing.assert_array_equal(found.motion.velocity, w.motion_px_per_s)
        assert found.space.version == w.version


@pytest.mark.parametrize("most", [None, 9])
@pytest.mark.parametrize("window_us", [None, 300])
def test_threads_change_nothing(window_us, most, made):
    one = windows_of(made.events, max_windows=most, window_us=window_us)
    two = windows_of(made.events, max_windows=most, window_us=window_us, threads=2)
    assert len(one) == len(two) > 4
    for a, b in zip(one, two, strict=True):
        assert_same(a, b)


def batches_of(events, count, monkeypatch, **options):
    """Windows read so many at once, and how many were searched in each call of the solver."""
    searched, find = [], Solver.find

    def counting(self, batch, motions, **more):
        searched.append(len(batch))
        return find(self, batch, motions, **more)

    with monkeypatch.context() as patched:
        patched.setattr("evqr.offline._at_once", lambda solver: count)
        patched.setattr(Solver, "find", counting)
        return windows_of(events, **options), searched


@pytest.mark.parametrize("threads", [None, 2])
@pytest.mark.parametrize("window_us", [None, 300])
def test_windows_side_by_side_are_what_each_is_alone(window_us, threads, made, monkeypatch):
    """As on a device, in whose batches quiet windows and such with codes are mixed."""
    events = joined(made.events, noise(20_000, 2_000, width=320, height=240), gap_us=3_000)
    options = {"max_windows": 11, "window_us": window_us, "threads": threads}
    alone, (at_once, searched) = windows_of(events, **options), batches_of(events, 5, monkeypatch, **options)
    assert sum(w.status is ReadStatus.READ for w in alone) >= 4
    assert max(searched) >= 3 and len(searched) <= 4
    for a, b in zip(alone, at_once, strict=True):
        assert_same(a, b, but=("compute_ms", "codes"))
        for one, other in zip(a.codes, b.codes, strict=True):
            assert (one.text, one.status, one.reason) == (other.text, other.status, other.reason)
            np.testing.assert_array_equal(one.motion_px_per_s, other.motion_px_per_s)
            np.testing.assert_allclose(one.affine, other.affine, atol=1e-3)
            np.testing.assert_allclose(one.modules, other.modules, atol=1e-3)


def test_windows_that_lie_far_apart_are_not_held_together(made, monkeypatch):
    monkeypatch.setattr("evqr.offline.MOST_EVENTS", len(made.events) // 4)
    _, searched = batches_of(made.events, 16, monkeypatch, max_windows=12, window_us=300)
    assert 1 < max(searched) <= 5


def test_two_runs_are_the_same_bit_for_bit():
    events = scene(preset="hard", speed_px_ms=8.0, travel_px=20.0).events
    for a, b in zip(windows_of(events, max_windows=4), windows_of(events, max_windows=4), strict=True):
        assert_same(a, b)


def test_gaps_are_windows_without_a_code():
    part = scene().events
    found = windows_of(joined(part, part, gap_us=20_000), max_windows=10, window_us=500)
    assert len(found) == 10
    quiet = [w for w in found if w.n_events == 0]
    assert len(quiet) >= 5
    assert all(w.status is ReadStatus.NO_CODE and w.reason for w in quiet)
    assert found[0].status is ReadStatus.READ


@pytest.mark.parametrize("window_us", [None, 600])
def test_windows_without_an_event_are_left_out_but_counted(window_us, made):
    """An hour of them would take an hour."""
    hour_us = 3_600_000_000
    config = ReadConfig(window_us=window_us)
    windows = list(read_windows(joined(made.events, made.events, gap_us=hour_us), config=config))
    assert all(window.n_events for window in windows)
    behind = [window for window in windows if window.t_start_us > hour_us]
    assert len(windows) <= 2 * len(behind) + 2
    assert [window.text for window in behind].count("EVQR-07") >= 3
    step_us = window_us or ReadConfig().motion.probe_us
    assert behind[0].window == pytest.approx(hour_us / step_us, abs=20)


def test_times_of_the_stages_add_up(made):
    for w in (
        *windows_of(made.events, max_windows=2),
        *windows_of(made.events, max_windows=2, window_us=400),
    ):
        assert {"motion", "finder", "stage_one", "stage_two", "decode", "total"} <= set(w.compute_ms)
        stages = [ms for stage, ms in w.compute_ms.items() if stage != "total"]
        assert min(stages) >= 0.0
        assert w.compute_ms["total"] == pytest.approx(sum(stages))


def test_windows_come_one_by_one(made):
    """Nothing is read before it is asked for: a long recording can be left early."""
    found = read_windows(made.events, config=ReadConfig(max_windows=4))
    assert isinstance(found, Iterator)
    assert next(found).window == 0
    assert next(found).window == 1


def test_progress_goes_forward(made):
    calls = []
    for _ in read_windows(
        made.events,
        config=ReadConfig(max_windows=5),
        progress=lambda done, whole: calls.append((done, whole)),
    ):
        pass
    done = [call[0] for call in calls]
    assert len(done) == 5
    assert done == sorted(done)
    assert {call[1] for call in calls} == {made.events.t[-1] - made.events.t[0]}


def test_window_readings_can_be_pickled_and_are_frozen(made):
    (w,) = windows_of(made.events, max_windows=1)
    assert_same(pickle.loads(pickle.dumps(w)), w)
    with pytest.raises(FrozenInstanceError):
        w.text = "another"


def test_readings_keep_their_numbers_when_more_is_read(made):
    """Arrays of a reading are its own, not buffers that are used again."""
    found, kept = [], []
    for w in read_windows(made.events, config=ReadConfig(max_windows=4)):
        found.append(w)
        kept.append((w.modules.copy(), w.affine.copy(), w.motion_px_per_s.copy()))
    for w, values in zip(found, kept, strict=True):
        for shown, value in zip((w.modules, w.affine, w.motion_px_per_s), values, strict=True):
            np.testing.assert_array_equal(shown, value)


def test_all_codes_of_a_window_are_read():
    codes = (
        CodePlacement(text="LEFT", version=1, module_px=4.5, angle=20.0, offset_px=(-85.0, 0.0)),
        CodePlacement(text="RIGHT", version=1, module_px=4.5, angle=60.0, offset_px=(85.0, 0.0)),
    )
    found = windows_of(scene(codes=codes, width=420, direction=10.0, **LONG).events, max_windows=4)
    for window in found:
        assert sorted(code.text for code in window.codes) == ["LEFT", "RIGHT"]
        assert window.status is ReadStatus.READ and window.text == window.codes[0].text
        for code in window.codes:
            assert (code.symbology, code.version, code.rows, code.columns) == ("QRCode", 1, 21, 21)
            assert code.ec_level == "M" and code.mask in range(8) and code.confidence > 0.999
    one = windows_of(scene(codes=codes[:1], width=420, direction=10.0, **LONG).events, max_windows=4)
    assert [[code.text for code in window.codes] for window in one] == [["LEFT"]] * 4


def test_windows_tell_what_is_odd_about_the_recording_by_then(made):
    t = made.events.t.copy()
    t[[10, 11]] = t[11] + 3, t[10]
    shuffled = replace(made.events, t=t)
    (note,) = {note for w in windows_of(shuffled, max_windows=2) for note in w.warnings}
    assert "out of order" in note


def test_windows_without_a_code_say_why_for_programs_too(made):
    quiet = replace(made.events, **{name: getattr(made.events, name)[::4000] for name in "txyp"})
    for window in windows_of(quiet, max_windows=3):
        assert window.status is ReadStatus.NO_CODE and window.codes == ()
        assert window.reason_code in (Reason.NO_EVENTS, Reason.TOO_FEW_EVENTS, Reason.NOTHING_MOVES)
        assert window.reason.startswith(window.reason_code.text)
