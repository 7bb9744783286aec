"""Batches: every window's events as they were, and those that windows share packed once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evqr.events.array import EventArray
from evqr.events.batch import LONGEST_US, EventBatch
from evqr.events.buffer import EventBuffer
from evqr.events.window import Window, make_window


def stream(seed, count=400, start_us=0):
    rng = np.random.default_rng(seed)
    t = start_us + np.sort(rng.integers(0, 1000, count))
    x, y = rng.integers(0, 60, (2, count)).astype(np.uint16)
    return EventArray(t, x, y, rng.choice(np.array([-1, 1], np.int8), count), 64, 64)


def unpacked(batch, k):
    """Columns, rows, times from the middle and polarities of a window of a batch."""
    first, last = batch.window_ptr[k]
    stamp = batch.events.stamp[first:last]
    return (
        batch.events.x[first:last],
        batch.events.y[first:last],
        (stamp - (np.uint32(batch.t_ref_us[k]) << np.uint32(1))).view(np.int32) >> 1,
        np.where(stamp & 1, 1, -1),
    )


bounds = st.tuples(st.integers(-50, 1050), st.integers(0, 400)).map(lambda b: (b[0], b[0] + b[1]))


@given(st.lists(st.tuples(st.integers(0, 2), bounds), max_size=12))
def test_each_window_has_its_events_and_shared_ones_are_packed_once(cuts):
    shift = (1 << 31) - 500, (1 << 32) - 500, -500  # where the stamps of times begin anew
    arrays = [stream(seed, start_us=shift[seed]) for seed in range(3)]
    buffers = [EventBuffer.of(events) for events in arrays]
    windows = [buffers[k].window(shift[k] + a, shift[k] + b) for k, (a, b) in cuts]
    batch = EventBatch.of(windows)
    assert len(batch) == len(windows)
    for k, window in enumerate(windows):
        x, y, t, p = unpacked(batch, k)
        events = window.events
        np.testing.assert_array_equal(x, events.x)
        np.testing.assert_array_equal(y, events.y)
        np.testing.assert_array_equal(t, events.t - window.middle_us)
        np.testing.assert_array_equal(p, events.p)
    used = [np.zeros(len(events), bool) for events in arrays]
    for (k, _), window in zip(cuts, windows, strict=True):
        first = window.origin[1]
        used[k][first : first + len(window)] = True
    assert len(batch.events) == sum(mask.sum() for mask in used)


def test_windows_of_unknown_origin_do_not_share():
    events = stream(3)
    window = make_window(events, 100, 300)
    batch = EventBatch.of([window, window])
    assert len(batch.events) == 2 * len(window)


def test_picked_windows_share_the_events():
    buffer = EventBuffer.of(stream(4))
    batch = EventBatch.of([buffer.window(0, 200), buffer.window(100, 500)])
    assert batch.pick([0, 1]) is batch
    picked = batch.pick([1, 1, 0])
    assert picked.parts is batch.parts
    assert picked.windows == (batch.windows[1], batch.windows[1], batch.windows[0])
    np.testing.assert_array_equal(picked.window_ptr, batch.window_ptr[[1, 1, 0]])
    np.testing.assert_array_equal(picked.t_ref_us, batch.t_ref_us[[1, 1, 0]])


def test_eight_bytes_an_event():
    events = EventBatch.of([make_window(stream(5), 0, 1000)]).events
    assert events.x.nbytes + events.y.nbytes + events.stamp.nbytes == 8 * len(events)


def test_a_window_that_has_all_events_gives_them_as_they_are():
    """Views of what the stream holds, so that nothing is copied."""
    buffer = EventBuffer.of(stream(4))
    long, short, other = (buffer.window(a, b) for a, b in ((100, 600), (100, 300), (601, 700)))
    batch = EventBatch.of([short, long, short])
    assert batch.events is long.packed and EventBatch.of([short]).events is short.packed
    assert np.shares_memory(batch.events.x, long.events.x)
    assert np.shares_memory(batch.events.stamp, short.packed.stamp)
    assert short.packed.begin(long.packed) and not long.packed.begin(short.packed)
    assert not other.packed.begin(long.packed)
    assert not np.shares_memory(EventBatch.of([long, other]).events.x, long.events.x)


def test_a_window_that_is_too_long_is_refused():
    events = stream(6)
    window = Window(events, 0, LONGEST_US + 1)
    with pytest.raises(ValueError, match="at most 2147483647 us, got 0 us to 2147483648 us"):
        EventBatch.of([window])


def test_no_windows():
    batch = EventBatch.of([])
    assert len(batch) == 0 and len(batch.events) == 0 and batch.window_ptr.shape == (0, 2)
