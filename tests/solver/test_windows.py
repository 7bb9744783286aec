"""Windows: times relative to the middle, and the same window however a stream is cut into chunks."""

import itertools
import weakref

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evqr.events.array import EventArray
from evqr.events.buffer import EventBuffer
from evqr.events.window import make_window

COLUMNS = "xytp"


def events_at(times):
    """Events at given times, all different in x, y and p."""
    t = np.array(times, np.int64)
    k = np.arange(len(t))
    return EventArray(
        t,
        (k % 64).astype(np.uint16),
        (k // 64 % 48).astype(np.uint16),
        (2 * (k % 2) - 1).astype(np.int8),
        64,
        48,
    )


def chunked(events, cuts):
    """The events in pieces, some of them empty."""
    bounds = [0, *sorted(min(c, len(events)) for c in cuts), len(events)]
    return iter([events.cut(a, b) for a, b in itertools.pairwise(bounds)])


def assert_same(a, b):
    assert (a.start_us, a.end_us, a.width, a.height) == (b.start_us, b.end_us, b.width, b.height)
    for column in COLUMNS:
        np.testing.assert_array_equal(getattr(a, column), getattr(b, column))


# ---- one window


def test_times_are_seconds_from_the_middle():
    window = make_window(events_at([90, 100, 130, 149, 150, 151]), 100, 150)
    np.testing.assert_allclose(window.t, [-25e-6, 5e-6, 24e-6], rtol=1e-6)
    assert window.middle_us == 125.0
    assert window.seconds == pytest.approx(50e-6)
    assert len(window) == 3


def test_an_odd_length_has_its_middle_on_a_microsecond():
    window = make_window(events_at([0, 1, 2]), 0, 3)
    assert window.middle_us == 1
    np.testing.assert_allclose(window.t, [-1e-6, 0.0, 1e-6], rtol=1e-6)


def test_columns_are_float32_and_keep_their_values():
    events = events_at(range(100, 200))
    window = make_window(events, 120, 150)
    assert all(getattr(window, column).dtype == np.float32 for column in COLUMNS)
    for column in "xyp":
        np.testing.assert_array_equal(getattr(window, column), getattr(events, column)[20:50])


@pytest.mark.parametrize("start", [0, -5_000_000, 1_633_953_690_975_950, 2**53, 2**62])
def test_stamps_of_any_size_lose_nothing(start):
    """Float32 holds half a microsecond up to 8 s, so a window's own times are exact wherever it lies."""
    offsets = [0, 1, 2, 499, 500, 501, 998, 999]
    window = make_window(events_at([start + o for o in offsets]), start, start + 1000)
    expected = (np.array(offsets) - 500.0) * 1e-6
    np.testing.assert_allclose(window.t, expected, rtol=1e-6, atol=0)
    assert window.middle_us == start + 500


def test_keep_takes_what_the_mask_says_and_the_same_bounds():
    window = make_window(events_at(range(50)), 10, 40)
    kept = window.keep(window.p > 0)
    assert len(kept) == 15
    assert (kept.p > 0).all()
    assert (kept.start_us, kept.end_us, kept.width, kept.height) == (10, 40, 64, 48)
    np.testing.assert_array_equal(kept.t, window.t[window.p > 0])


# ---- a stream


@settings(max_examples=80, deadline=None)
@given(
    gaps=st.lists(st.integers(0, 9), min_size=30, max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=8),
    wanted=st.lists(st.tuples(st.integers(-20, 250), st.integers(1, 150)), min_size=1, max_size=6),
)
def test_chunks_of_any_size_give_the_same_windows(gaps, cuts, wanted):
    events = events_at(np.cumsum(gaps))
    buffer = EventBuffer(chunked(events, cuts))
    assert buffer.first_us == events.t[0]
    for start, length in sorted(wanted):
        buffer.forget(start)
        assert_same(buffer.window(start, start + length), make_window(events, start, start + length))


@settings(max_examples=40, deadline=None)
@given(
    gaps=st.lists(st.integers(0, 30), min_size=1, max_size=40),
    cuts=st.lists(st.integers(0, 40), max_size=6),
    time=st.integers(-10, 1300),
)
def test_reaches_says_whether_the_stream_goes_that_far(gaps, cuts, time):
    events = events_at(np.cumsum(gaps))
    assert EventBuffer(chunked(events, cuts)).reaches(time) == (events.t[-1] >= time)


def test_events_of_one_time_on_both_sides_of_a_chunk_boundary():
    events = events_at([0, 5, 5, 5, 5, 9])
    buffer = EventBuffer(chunked(events, [3]))
    assert_same(buffer.window(5, 6), make_window(events, 5, 6))


def test_only_the_chunks_that_are_asked_for_are_loaded():
    events = events_at(range(0, 1000, 10))
    taken = []

    def chunks():
        for first in range(0, 100, 10):
            taken.append(first)
            yield events.cut(first, first + 10)

    buffer = EventBuffer(chunks())
    assert taken == [0]
    buffer.window(0, 150)
    assert taken == [0, 10]
    assert buffer.seen == 20
    assert not buffer.reaches(2000)
    assert buffer.seen == 100


def test_chunks_that_are_over_are_let_go():
    alive = []

    def chunks():
        for k in range(20):
            chunk = events_at(range(100 * k, 100 * k + 100))
            alive.append(weakref.ref(chunk))
            yield chunk
            del chunk

    buffer = EventBuffer(chunks())
    for start in range(0, 2000, 50):
        buffer.forget(start)
        buffer.window(start, start + 50)
        assert sum(chunk() is not None for chunk in alive) <= 3
    assert buffer.seen == 2000


def test_a_gap_is_an_empty_window():
    events = events_at([0, 1, 2, 5000, 5001])
    buffer = EventBuffer(chunked(events, [3]))
    assert len(buffer.window(100, 200)) == 0
    assert len(buffer.window(4990, 5010)) == 2
    assert len(buffer.window(6000, 6100)) == 0


@pytest.mark.parametrize("chunks", [[], [events_at([])], [events_at([]), events_at([])]])
def test_a_stream_without_events(chunks):
    buffer = EventBuffer(iter(chunks))
    assert buffer.first_us is None
    assert buffer.seen == 0
    assert not buffer.reaches(0)


def test_empty_chunks_are_passed_over():
    events = events_at(range(20))
    buffer = EventBuffer(iter([events.cut(0, 0), events.cut(0, 7), events.cut(7, 7), events.cut(7, 20)]))
    assert buffer.first_us == 0
    assert_same(buffer.window(3, 15), make_window(events, 3, 15))
