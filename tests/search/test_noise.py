"""Whether events are spread as those of noise: told from counts that are made once."""

import numpy as np
import pytest
from scenes import noise, scene

from evqr.config import MotionConfig
from evqr.events.array import EventArray
from evqr.events.buffer import EventBuffer
from evqr.search.noise import NoiseCounts, noise_squares

VIEW = {"width": 200, "height": 160}
MS = 1_000


def counts_of(events, cfg=None):
    return NoiseCounts(EventBuffer.of(events), events.width, events.height, cfg or MotionConfig())


def test_noise_is_noise_in_windows_of_any_length():
    counts = counts_of(noise(60_000, 60 * MS, **VIEW))
    for start_us in range(0, 8 * MS, 1_700):
        for length_us in (MS, 4 * MS, 16 * MS, 50 * MS):
            assert counts.are_noise(start_us, start_us + length_us)


def test_what_moves_is_not_also_in_noise():
    made = scene(travel_px=12.0).events
    duration_us = int(made.t[-1]) + 1
    parts = made, noise(len(made) // 2, duration_us, width=made.width, height=made.height)
    t, x, y, p = (np.concatenate([getattr(part, name) for part in parts]) for name in "txyp")
    order = np.argsort(t, kind="stable")
    among = EventArray(t[order], x[order], y[order], p[order], made.width, made.height)
    for events in (made, among):
        counts = counts_of(events)
        assert not any(counts.are_noise(at, at + MS) for at in range(0, duration_us - MS, 700))


def test_few_events_coarse_slices_and_long_windows_are_not_judged():
    assert not counts_of(noise(100, 10 * MS, **VIEW)).are_noise(0, MS)
    assert not counts_of(noise(60_000, 60 * MS, **VIEW), MotionConfig(reduction=2)).are_noise(0, MS)
    assert not counts_of(noise(60_000, 100 * MS, **VIEW)).are_noise(0, 100 * MS)


def test_slices_are_counted_once_and_again_when_they_were_given_up(monkeypatch):
    events = noise(200_000, 200 * MS, **VIEW)
    counts, alone = counts_of(events), []
    counted = counts._count_slice
    monkeypatch.setattr(
        counts, "_count_slice", lambda number, window: (alone.append(number), counted(number, window))
    )
    for start_us in range(0, 190 * MS, 2 * MS):
        first_us = max(0, start_us + MS - 16 * MS)
        counts.are_noise(first_us, first_us + 16 * MS)
    assert alone == sorted(set(alone)) and len(alone) > 370
    assert counts.are_noise(0, 4 * MS) and alone[-8:] == list(range(8))


def test_where_too_many_events_would_be_counted_nothing_is_known():
    few = MotionConfig(most_events=2_000)
    counts = counts_of(noise(60_000, 60 * MS, **VIEW), few)
    assert not counts.are_noise(0, 16 * MS)
    assert sum(counts.are_noise(at, at + MS) for at in range(0, 16 * MS, MS)) >= 15
    assert counts.are_noise(0, 16 * MS)


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_squares_of_noise_are_within_their_bounds(share):
    rng, cells = np.random.default_rng(0), 4_000
    inside = 0
    for _ in range(200):
        cell, on = rng.integers(0, cells, 9_000), rng.random(9_000) < share
        squares = float((np.bincount(cell, np.where(on, 1, -1), cells) ** 2).sum())
        least, most = noise_squares(len(cell), int(on.sum()), cells)
        inside += least <= squares <= most
    assert inside >= 0.98 * 200
