"""`summarise` counts right, whatever the chunks, and finds what is wrong with a recording."""

import numpy as np
import pytest
from recording_files import HEIGHT, WIDTH, make_events

from evqr.events.array import EventArray
from evqr.recording import open_recording, summarise


def info_of(t, x, y, p, *, chunk_events=1 << 20):
    columns = np.asarray(t), np.asarray(x), np.asarray(y), np.asarray(p)
    with open_recording(
        columns, sensor=(WIDTH, HEIGHT), time_unit="us", chunk_events=chunk_events
    ) as recording:
        return summarise(recording)


@pytest.mark.parametrize("chunk_events", [7, 100, 1 << 20])
def test_figures(chunk_events):
    events = make_events(5000, span_us=50_000)
    info = info_of(events.t, events.x, events.y, events.p, chunk_events=chunk_events)
    assert (info.events, info.on, info.off) == (5000, np.sum(events.p == 1), np.sum(events.p == -1))
    assert (info.t_first_us, info.t_last_us) == (events.t[0], events.t[-1])
    assert info.duration_us == events.t[-1] - events.t[0]
    assert info.mean_rate == pytest.approx(5000 / info.duration_us * 1e6)
    assert info.peak_rate == np.bincount(events.t // 1000).max() * 1000
    assert (info.width, info.height, info.time_unit, info.time_unit_reason) == (
        WIDTH,
        HEIGHT,
        "us",
        "as asked",
    )
    assert info.suspicious == ()


def good(count=5000) -> EventArray:
    return make_events(count, span_us=50_000)


@pytest.mark.parametrize("chunk_events", [1000, 1 << 20])
def test_suspicions(chunk_events):
    def suspicions(**changes):
        events = good()
        columns = {"t": events.t, "x": events.x, "y": events.y, "p": events.p} | changes
        info = info_of(**columns, chunk_events=chunk_events)
        return " ".join((*info.notes, *info.suspicious))

    events = good()
    assert "no event says brighter: the polarity may have been lost" in suspicions(p=np.zeros(5000, bool))
    assert "no event says darker" in suspicions(p=np.ones(5000))
    few = np.where(np.arange(5000) % 500 == 0, 1, -1)
    assert "only 10 of 5,000 events say brighter" in suspicions(p=few)

    late = np.where(np.arange(5000) < 3000, events.t, events.t + 30_000)
    silence = late[3000] - late[2999]
    assert f"no event for {silence:,} us of {late[-1] - late[0]:,} us, from {late[2999]} us" in suspicions(
        t=late
    )

    stuck = np.arange(5000) % 4 == 0
    hot = suspicions(x=np.where(stuck, 5, events.x), y=np.where(stuck, 7, events.y))
    assert "1 hot pixels make 25.0% of all events, worst at x 5, y 7" in hot
    assert "no event beyond x 31, y 47: is the sensor really 64x48?" in suspicions(x=events.x // 2)

    swapped = events.t.copy()
    swapped[[50, 60]] = swapped[[60, 50]]
    assert "events out of order by up to" in suspicions(t=swapped)


def test_one_instant():
    info = info_of([5, 5], [0, 1], [0, 1], [0, 1])
    assert (info.duration_us, info.mean_rate) == (0, 2e6)
