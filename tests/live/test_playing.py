"""A recording that is played again and again."""

from __future__ import annotations

import itertools

import numpy as np

from evqr.events.array import EventArray
from evqr.live.pieces import Events, Sensor, TimePasses
from evqr.live.playing import PAUSE_US, Playing
from evqr.recording import open_recording


def test_again_and_again_with_times_that_go_on():
    t = np.array([1_000, 1_500, 9_000])
    events = EventArray(t, *np.ones((2, 3), np.uint16), np.ones(3, np.int8), 64, 48)
    with open_recording(events) as recording:
        playing = Playing(recording, "line", repeat=True)
        pieces = list(itertools.islice(playing.pieces(), 10))
        playing.stop()
        assert list(playing.pieces()) == [Sensor(64, 48)]
    got = np.concatenate([piece.columns.t for piece in pieces if isinstance(piece, Events)])
    period_us = 9_000 + PAUSE_US - 1_000
    assert got.tolist() == [at + turn * period_us for turn in range(3) for at in (1_000, 1_500, 9_000)]
    assert TimePasses(9_000 + PAUSE_US) in pieces and pieces.count(Sensor(64, 48)) == 1
