"""Local disorder is sorted and told; a clock that jumps back is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_files import make_events

from evqr.errors import RecordingError
from evqr.events.array import EventArray
from evqr.recording import open_recording
from evqr.recording.faults import Faults
from evqr.recording.ordering import MAX_DISORDER_US, in_order


def disordered(seed: int, count: int, jitter_us: int) -> EventArray:
    """Events whose places in the file, not their stamps, are shuffled within ``jitter_us``."""
    events = make_events(count, span_us=400_000, seed=seed)
    rng = np.random.default_rng(seed)
    order = np.argsort(events.t + rng.integers(0, jitter_us + 1, count), kind="stable")
    return EventArray(events.t[order], events.x[order], events.y[order], events.p[order], 64, 48)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 1000),
    count=st.integers(1, 400),
    jitter_us=st.sampled_from([0, 1, 35, 5_000, MAX_DISORDER_US]),
    chunk_events=st.integers(1, 500),
)
def test_equals_a_stable_sort_and_counts_the_late(seed, count, jitter_us, chunk_events):
    events = disordered(seed, count, jitter_us)
    chunks = [events.cut(i, i + chunk_events) for i in range(0, count, chunk_events)]
    disorder = Faults("name")
    sorted_chunks = list(in_order(chunks, chunk_events, disorder))

    order = np.argsort(events.t, kind="stable")
    for column in "txyp":
        joined = np.concatenate([getattr(chunk, column) for chunk in sorted_chunks])
        np.testing.assert_array_equal(joined, getattr(events, column)[order])
    back = np.maximum.accumulate(events.t) - events.t
    assert (disorder.late, disorder.worst_us) == (np.count_nonzero(back), back.max())
    assert max(map(len, sorted_chunks)) <= chunk_events


def test_sorting_is_told_and_so_is_how_much():
    t = np.arange(1000, 2000)
    t[[10, 11]] = t[[11, 10]]
    t[[20, 24]] = t[[24, 20]]
    xyp = np.zeros(1000, int), np.zeros(1000, int), np.ones(1000, int)
    with open_recording((t, *xyp), sensor=(64, 48), time_unit="us", chunk_events=100) as recording:
        assert np.all(np.diff(recording.read().t) == 1)
        recording.read()
        assert recording.notes == ("5 events out of order by up to 4 us were sorted",)


def test_nothing_is_held_back_longer_than_the_bound():
    events = make_events(20_000, span_us=20 * MAX_DISORDER_US)
    fed = []

    def chunks():
        for i in range(0, len(events), 100):
            fed.append(events.cut(i, i + 100))
            yield fed[-1]

    for chunk in in_order(chunks(), 100, Faults("name")):
        if len(fed) < 200:
            assert fed[-1].t[0] - chunk.t[-1] <= MAX_DISORDER_US


@pytest.mark.parametrize("chunk_events", [10, 1000])
def test_strictly_a_jump_back_is_refused(chunk_events):
    events = make_events(100, span_us=10)
    t = events.t + MAX_DISORDER_US + 11
    t[60] -= MAX_DISORDER_US + 11
    columns = t, events.x, events.y, events.p
    options = {"sensor": (64, 48), "time_unit": "us", "chunk_events": chunk_events, "strict": True}
    with open_recording(columns, **options) as recording:
        with pytest.raises(
            RecordingError, match=r"jump back by 50,0\d\d us to \d+ us at event 60; up to 50,000 us"
        ):
            recording.read()
