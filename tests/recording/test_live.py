"""Events that come bit by bit: in order, with bounded delay; clocks that are reset; garbage."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import events_at

from evqr.events.array import EventArray
from evqr.recording.clock import EPOCH_GAP_US, Reset
from evqr.recording.live import LiveIntake
from evqr.recording.source import RawColumns

STEADY = [1_000 + 10 * k for k in range(20)]
"""Times of a clock that is trusted: what is fewer waits."""


def raw(times):
    events = events_at(times)
    return RawColumns(events.t, events.x, events.y, events.p)


def taken(intake, *pushes, end=True):
    """All that comes out: times, and resets between them."""
    found = [each for times in pushes for each in intake.push(raw(times))]
    found += intake.finish() if end else []
    out = []
    for each in found:
        out += each.t.tolist() if isinstance(each, EventArray) else [each]
    return out


def intake_of(**given):
    return LiveIntake("camera", (64, 48), **given)


def test_sources_that_sort_cost_no_delay():
    intake = intake_of()
    assert taken(intake, STEADY, [1_200, 1_205], end=False) == [*STEADY, 1_200, 1_205]
    assert intake.known_us == 1_205


def test_disorder_costs_as_much_delay_as_is_allowed():
    intake = intake_of(disorder_us=50)
    assert taken(intake, STEADY, end=False) == [t for t in STEADY if t <= STEADY[-1] - 50]
    assert intake.known_us == STEADY[-1] - 50
    assert taken(intake, [1_180, 1_300, 1_250], end=False)[-1] == 1_250
    assert taken(intake) == [1_300]
    assert intake.faults.left_out == 0


def test_what_is_later_is_left_out_and_counted():
    intake = intake_of(disorder_us=50)
    assert taken(intake, STEADY, [1_300], [1_249], [1_250]) == [*STEADY, 1_250, 1_300]
    assert intake.faults.left_out == 1


def test_garbage_is_left_out_and_counted_however_much_it_is():
    intake = intake_of()
    columns = raw([*STEADY, *range(1_200, 1_300)])
    bad = columns._replace(x=np.where(np.arange(120) < 110, np.uint16(9_999), columns.x))
    assert sum(map(len, intake.push(raw(STEADY)))) == 20
    assert sum(map(len, intake.push(bad))) == 10
    assert intake.faults.left_out == 110


def test_a_stamp_far_ahead_is_stray():
    intake = intake_of()
    assert taken(intake, STEADY, [9_000_000_000], [1_300]) == [*STEADY, 1_300]
    assert intake.faults.left_out == 1


def test_a_silence_holds_nothing_up():
    intake = intake_of()
    later = [10_000_000 + t for t in STEADY]
    assert taken(intake, STEADY, later[:16], end=False) == [*STEADY, *later[:16]]
    assert taken(intake, later[16:], end=False) == later[16:]


def test_few_events_after_a_silence_are_trusted_once_time_has_passed():
    intake = intake_of()
    assert taken(intake, STEADY, [5_000_000], end=False) == STEADY
    (events,) = intake.advance(5_000_100)
    assert events.t.tolist() == [5_000_000] and intake.known_us == 5_000_100
    assert taken(intake, [5_000_050], [5_000_120], end=False) == [5_000_120]
    assert intake.faults.left_out == 1


def test_time_that_passes_lets_out_what_is_held_back():
    intake = intake_of(disorder_us=10_000)
    assert taken(intake, STEADY, end=False) == []
    (events,) = intake.advance(STEADY[-1])
    assert events.t.tolist() == STEADY
    assert list(intake.advance(5)) == [] and intake.known_us == STEADY[-1]


@pytest.mark.parametrize("before_us", [10_000_000, (1 << 31) + 5, (1 << 32) - 1_000])
def test_a_clock_that_is_reset_begins_anew(before_us):
    intake = intake_of()
    first = [before_us + t for t in STEADY]
    second = list(range(0, 60_000, 1_000))
    out = taken(intake, first, second)
    reset = out[len(first)]
    assert isinstance(reset, Reset)
    assert (reset.before_us, reset.after_us) == (first[-1], 0)
    assert out == [*first, reset, *second]
    assert reset.shift_us == first[-1] + EPOCH_GAP_US
    assert intake.known_us == second[-1]


def test_clocks_that_are_reset_again_and_again():
    intake = intake_of()
    clock = [
        [9_000_000 + t for t in STEADY],
        list(range(500_000, 600_000, 1_000)),
        list(range(0, 90_000, 1_000)),
    ]
    out = taken(intake, *clock)
    resets = [each for each in out if isinstance(each, Reset)]
    assert [(each.before_us, each.after_us) for each in resets] == [
        (clock[0][-1], 500_000),
        (clock[1][-1], 0),
    ]
    assert [each for each in out if not isinstance(each, Reset)] == [t for times in clock for t in times]
    (events,) = intake.push(raw([90_000]))
    assert events.t.tolist() == [90_000]


@settings(max_examples=80, deadline=None)
@given(
    steps=st.lists(st.integers(0, 40), min_size=20, max_size=60),
    late=st.lists(st.integers(0, 80), min_size=60, max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=8),
    disorder_us=st.sampled_from([0, 30, 100]),
)
def test_how_events_are_cut_does_not_matter(steps, late, cuts, disorder_us):
    """In order, whole, and the same events are left out."""
    times = [max(0, 1_000 + t - back) for t, back in zip(np.cumsum(steps).tolist(), late, strict=False)]
    whole = intake_of(disorder_us=disorder_us)
    expected = taken(whole, times)
    bounds = sorted({0, len(times), *(cut for cut in cuts if cut < len(times))})
    intake = intake_of(disorder_us=disorder_us)
    assert taken(intake, *(times[a:b] for a, b in itertools.pairwise(bounds))) == expected
    assert expected == sorted(expected)
    newest = np.maximum.accumulate(times)
    assert expected == sorted(t for t, most in zip(times, newest, strict=True) if most - t <= disorder_us)


def test_columns_that_are_right_are_taken_as_they_are():
    """And are no less checked: what only looks right is left out."""
    intake = intake_of()
    assert taken(intake, STEADY, end=False) == STEADY
    columns = raw([1_300, 1_310])
    (events,) = intake.push(columns)
    assert events.t is columns.t and intake.known_us == 1_310
    for wrong in (
        columns._replace(t=columns.t + 10, x=np.array([5, 64], np.uint16)),
        columns._replace(t=columns.t + 20, y=np.array([48, 5], np.uint16)),
        columns._replace(t=columns.t + 30, p=np.array([1, 2], np.int8)),
        columns._replace(t=np.array([-5, 1_350])),
    ):
        assert sum(map(len, intake.push(wrong))) == 1
    assert intake.faults.left_out == 4 and intake.faults.met == 30
    assert taken(intake, [1_400, 1_390], end=False) == [1_400]


def test_a_reset_is_seen_behind_columns_that_are_right():
    intake = intake_of(disorder_us=20)
    first, second = [t + 900_000 for t in STEADY], list(range(0, 60_000, 1_000))
    out = taken(intake, first, second[:30], second[30:], [60_000, 60_001])
    assert [each for each in out if not isinstance(each, Reset)] == [*first, *second, 60_000, 60_001]
