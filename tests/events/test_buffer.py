"""The buffer of a stream: the same windows however the stream was cut into chunks, in bounded memory."""

import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import events_at

from evqr.events.array import EventArray
from evqr.events.buffer import SMALLEST_BLOCK, EventBuffer
from evqr.events.window import make_window

COLUMNS = "xytp"


def chunked(events, cuts):
    """The events in pieces, some of them empty."""
    bounds = [0, *sorted(min(c, len(events)) for c in cuts), len(events)]
    return [events.cut(a, b) for a, b in itertools.pairwise(bounds)]


def of(*chunks):
    buffer = EventBuffer(64, 48)
    for chunk in chunks:
        buffer.push(chunk)
    return buffer


def assert_same(a, b):
    assert (a.start_us, a.end_us, a.width, a.height) == (b.start_us, b.end_us, b.width, b.height)
    for column in COLUMNS:
        np.testing.assert_array_equal(getattr(a, column), getattr(b, column))
        assert getattr(a.events, column).dtype == getattr(b.events, column).dtype
    np.testing.assert_array_equal(a.packed.stamp, b.packed.stamp)


# ---- windows


@given(
    gaps=st.lists(st.integers(0, 9), min_size=30, max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=8),
    wanted=st.lists(st.tuples(st.integers(-20, 250), st.integers(1, 150)), min_size=1, max_size=6),
)
def test_chunks_of_any_size_give_the_same_windows(gaps, cuts, wanted):
    events = events_at(np.cumsum(gaps))
    buffer = of(*chunked(events, cuts))
    assert (buffer.first_us, buffer.last_us, buffer.pushed) == (events.t[0], events.t[-1], len(events))
    buffer.close()
    for start, length in sorted(wanted):
        buffer.forget(start)
        assert_same(buffer.window(start, start + length), make_window(events, start, start + length))
        assert buffer.count_before(start) == events.first_at(start)


@given(
    gaps=st.lists(st.integers(0, 9), min_size=1, max_size=80),
    cuts=st.lists(st.integers(0, 80), max_size=40),
    length=st.integers(1, 40),
)
def test_windows_are_whole_while_events_come_and_go(gaps, cuts, length):
    """Each window as soon as the stream reaches its end, and what is before it forgotten."""
    events = events_at(np.cumsum(gaps))
    buffer, start, kept = EventBuffer(64, 48), int(events.t[0]), []
    for chunk in chunked(events, cuts):
        buffer.push(chunk)
        while buffer.reaches(start + length):
            kept.append(buffer.window(start, start + length))
            start += length
            buffer.forget(start)
    for window in kept:  # what came later has changed none of them
        assert_same(window, make_window(events, window.start_us, window.end_us))


@given(
    gaps=st.lists(st.integers(0, 3), min_size=2, max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=60),
    starts=st.tuples(st.integers(0, 60), st.integers(0, 60)),
    lengths=st.tuples(st.integers(1, 60), st.integers(1, 60)),
)
def test_windows_know_whether_they_begin_with_the_same_event(gaps, cuts, starts, lengths):
    events = events_at(np.cumsum(gaps))
    buffer, windows = EventBuffer(64, 48), []
    for chunk in chunked(events, cuts):  # cut as early as can be: before and after a block has moved
        buffer.push(chunk)
        for start, length in zip(starts, lengths, strict=True):
            if buffer.reaches(start + length):
                windows.append(buffer.window(start, start + length))
    for a, b in itertools.combinations(windows, 2):
        same = events.first_at(a.start_us) == events.first_at(b.start_us)
        shorter, longer = sorted((a.packed, b.packed), key=len)
        assert shorter.begin(longer) == same


def test_windows_of_two_streams_begin_with_different_events():
    events = events_at(range(50))
    a, b = (EventBuffer.of(events).window(0, 20) for _ in range(2))
    assert not a.packed.begin(b.packed)


def test_events_of_one_time_on_both_sides_of_a_chunk_boundary():
    events = events_at([0, 5, 5, 5, 5, 9])
    assert_same(of(*chunked(events, [3])).window(5, 6), make_window(events, 5, 6))


def test_a_gap_is_an_empty_window():
    buffer = EventBuffer.of(events_at([0, 1, 2, 5000, 5001]))
    assert len(buffer.window(100, 200)) == 0
    assert len(buffer.window(4990, 5010)) == 2
    assert len(buffer.window(6000, 6100)) == 0


def test_the_arrays_of_the_caller_are_free_again():
    events = events_at(range(100))
    buffer = EventBuffer(64, 48)
    store = EventArray(*(getattr(events, column).copy() for column in "txyp"), 64, 48)
    buffer.push(store)
    for column in COLUMNS:
        getattr(store, column)[:] = 0
    assert_same(buffer.window(0, 99), make_window(events, 0, 99))


def test_threads_may_cut_windows_while_events_come():
    events = events_at(np.arange(60_000) // 3)
    buffer, step = EventBuffer(64, 48), 400

    def cut(start):
        return buffer.window(start, start + step)

    with ThreadPoolExecutor(4) as pool:
        windows, start = [], 0
        for first in range(0, len(events), 97):
            buffer.push(events.cut(first, first + 97))
            while buffer.reaches(start + step):
                windows.append(pool.submit(cut, start))
                start += step
            if len(windows) > 8:  # those before are done
                buffer.forget(windows[-8].result().start_us)
    assert len(windows) == 49
    for future in windows:
        window = future.result()
        assert_same(window, make_window(events, window.start_us, window.end_us))


# ---- how far the stream goes


@given(
    gaps=st.lists(st.integers(0, 30), min_size=1, max_size=40),
    cuts=st.lists(st.integers(0, 40), max_size=6),
    time=st.integers(-10, 1300),
)
def test_reaches_says_whether_the_stream_goes_that_far(gaps, cuts, time):
    events = events_at(np.cumsum(gaps))
    buffer = of(*chunked(events, cuts))
    assert buffer.reaches(time) == (events.t[-1] >= time)
    buffer.close()
    assert buffer.reaches(time) == (events.t[-1] >= time)


def test_time_may_pass_without_events():
    buffer = of(events_at([0, 10]))
    with pytest.raises(ValueError, match="a window to 500 us ends after what has come, up to 10 us"):
        buffer.window(5, 500)
    buffer.advance(500)
    assert buffer.reaches(500)
    assert buffer.last_us == 10
    assert len(buffer.window(5, 500)) == 1
    buffer.advance(200)  # said already
    assert buffer.reaches(500)
    with pytest.raises(ValueError, match="events must come in order of time: 499 us came after 500 us"):
        buffer.push(events_at([499]))
    buffer.push(events_at([500, 502]))
    assert buffer.last_us == 502


def test_the_first_event_from_a_time_on():
    buffer = EventBuffer(64, 48)
    assert buffer.first_from(0) is None
    buffer.push(events_at([5, 7]))
    buffer.forget(6)
    buffer.push(events_at([7, 9]))
    assert [buffer.first_from(time) for time in (6, 7, 7.5, 9, 10)] == [7, 7, 9, 9, None]


def test_a_closed_stream_has_windows_beyond_its_end():
    buffer = of(events_at([0, 10]))
    buffer.close()
    assert len(buffer.window(5, 500)) == 1
    with pytest.raises(ValueError, match="closed"):
        buffer.push(events_at([20]))


@pytest.mark.parametrize("chunks", [[], [events_at([])], [events_at([]), events_at([])]])
def test_a_stream_without_events(chunks):
    buffer = of(*chunks)
    assert (buffer.first_us, buffer.last_us, buffer.pushed) == (None, None, 0)
    assert not buffer.reaches(0)
    buffer.close()
    assert len(buffer.window(0, 100)) == 0


def test_empty_chunks_are_passed_over():
    events = events_at(range(20))
    buffer = of(events.cut(0, 0), events.cut(0, 7), events.cut(7, 7), events.cut(7, 20))
    assert buffer.first_us == 0
    assert_same(buffer.window(3, 15), make_window(events, 3, 15))


def test_misuse_is_refused():
    buffer = of(events_at([5, 9]))
    with pytest.raises(ValueError, match="8 us came after 9 us"):
        buffer.push(events_at([8]))
    with pytest.raises(ValueError, match="sensor 64x48, got 32x48"):
        buffer.push(EventArray(*(np.zeros(1, d) for d in ("i8", "u2", "u2", "i1")), 32, 48))
    buffer.forget(7)
    with pytest.raises(ValueError, match="from 6 us begins in what is forgotten, up to 7 us"):
        buffer.window(6, 8)
    buffer.forget(3)  # what is forgotten does not come back
    with pytest.raises(ValueError, match="forgotten"):
        buffer.window(6, 8)


# ---- costs


def blocks_of(windows):
    """The blocks that windows are views of, each once."""
    return {id(window.events.t.base): window.events.t.base for window in windows}.values()


def test_small_chunks_cost_no_copies():
    """As many events as 60 smallest blocks hold, all of them wanted: the blocks double, so few are made."""
    events, chunk = events_at(range(60 * SMALLEST_BLOCK)), 500
    buffer, windows = EventBuffer(64, 48), []
    for first in range(0, len(events), chunk):
        buffer.push(events.cut(first, first + chunk))
        windows.append(buffer.window(first, first + 1))
    blocks = blocks_of(windows)
    assert len(blocks) <= 10
    assert sum(len(block) for block in blocks) <= 5 * len(events)


@pytest.mark.parametrize("chunk", [10, 3_000, 50_000])
def test_what_is_forgotten_is_let_go(chunk):
    """A stream a hundred times as long as what is wanted of it: no block is larger than that and a chunk."""
    wanted, steps = 5_000, 300 if chunk == 10 else 60
    buffer, first = EventBuffer(64, 48), 0
    for _ in range(steps):
        buffer.push(events_at(np.arange(first, first + chunk)))
        first += chunk
        buffer.forget(first - wanted)
        newest = buffer.window(first - 2, first - 1)
        assert len(newest.events.t.base) <= max(SMALLEST_BLOCK, 2 * (wanted + chunk) + chunk)
    assert buffer.pushed == steps * chunk
