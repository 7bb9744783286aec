"""Pixels that fire all the time are left out; what moves, flickers or floods the view is not."""

import itertools

import numpy as np
import pytest
from scenes import noise, scene

from evqr import LineConfig, ReadConfig, Reader
from evqr.events.array import EventArray
from evqr.line.hot_pixels import SPAN_US, SPANS, HotPixels

WIDTH, HEIGHT = 64, 48


def of(t, x, y):
    order = np.argsort(t, kind="stable")
    t, x, y = (np.asarray(values)[order] for values in (t, x, y))
    p = np.where(np.arange(len(t)) % 2, 1, -1).astype(np.int8)
    return EventArray(t.astype(np.int64), x.astype(np.uint16), y.astype(np.uint16), p, WIDTH, HEIGHT)


def together(*parts):
    return of(*(np.concatenate([getattr(part, name) for part in parts]) for name in "txy"))


def hot(x, y, hz, start_us, end_us):
    t = np.arange(start_us, end_us, 1e6 / hz).astype(np.int64)
    return of(t, np.full(len(t), x), np.full(len(t), y))


def background(end_us, seed=0, hz=20.0):
    return noise(int(WIDTH * HEIGHT * hz * end_us * 1e-6), end_us, seed=seed, width=WIDTH, height=HEIGHT)


def run(events, cuts=(), least_hz=500.0):
    pixels = HotPixels(WIDTH, HEIGHT, least_hz)
    bounds = [0, *sorted(cuts), len(events)]
    kept = [piece for a, b in itertools.pairwise(bounds) for piece in pixels.without(events.cut(a, b))]
    return kept, pixels


def times_of(kept, x, y):
    return np.concatenate([piece.t[(piece.x == x) & (piece.y == y)] for piece in kept])


@pytest.fixture(scope="module")
def events():
    return together(
        background(1_000_000),
        hot(30, 20, 4_000.0, 0, 1_000_000),
        hot(0, 47, 1_000.0, 250_000, 1_000_000),
        hot(10, 10, 200.0, 0, 1_000_000),
    )


def test_they_are_left_out_once_they_have_stood_out_for_some_spans(events):
    kept, pixels = run(events)
    assert sorted(pixels.pixels) == [(0, 47), (30, 20)]
    known_us = SPANS * SPAN_US
    assert times_of(kept, 30, 20).max() < known_us
    assert times_of(kept, 0, 47).max() < 250_000 + known_us + SPAN_US
    assert len(times_of(kept, 10, 10)) >= 200
    lost = len(events) - sum(map(len, kept))
    assert lost == pytest.approx(4_000 * 0.7 + 1_000 * 0.4, rel=0.15)


def test_how_events_are_cut_does_not_matter(events):
    whole = run(events)[0]
    cuts = np.sort(np.random.default_rng(3).integers(0, len(events), 200)).tolist()
    parts = run(events, cuts)[0]
    for name in "txy":
        assert np.array_equal(
            *(np.concatenate([getattr(piece, name) for piece in kept]) for kept in (whole, parts))
        )


def test_one_that_has_calmed_down_is_let_in_again():
    events = together(
        background(1_500_000), hot(30, 20, 4_000.0, 0, 600_000), hot(30, 20, 50.0, 600_000, 1_500_000)
    )
    kept, pixels = run(events)
    assert pixels.pixels == []
    times = times_of(kept, 30, 20)
    assert not ((times > 300_000) & (times < 800_000)).any() and (times > 1_000_000).sum() > 20


def test_what_moves_flickers_or_floods_is_not_hot():
    code = scene(
        version=1, module_px=2.2, width=WIDTH, height=HEIGHT, travel_px=60.0, speed_px_ms=0.1, angle=0.0,
        direction=0.0,
    ).events  # fmt: skip
    _, pixels = run(code)
    assert pixels.pixels == [] and int(code.t[-1]) > 5 * SPAN_US
    # stripes on a belt without an end: each pixel of some rows fires 1500 times a second
    x, y, k, n = np.meshgrid(np.arange(WIDTH), np.arange(10, 30), np.arange(150), np.arange(6))
    stripes = of((4_000 * k + 500 * (x % 8) + 20 * n).ravel(), x.ravel(), y.ravel())
    _, pixels = run(together(stripes, hot(5, 45, 4_000.0, 0, 600_000)))
    assert pixels.pixels == [(5, 45)]
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    flashes = [of(5_000 * k + rng.integers(0, 300, x.size), x.ravel(), y.ravel()) for k in range(120)]
    _, pixels = run(together(*flashes))
    assert pixels.pixels == []


def test_a_reader_leaves_them_out():
    still = background(600_000)
    events = together(still, hot(30, 20, 4_000.0, 0, 600_000))
    counts = {}
    for least_hz in (500.0, None):
        reader = Reader((WIDTH, HEIGHT), ReadConfig(line=LineConfig(hot_pixel_hz=least_hz)))
        for start in range(0, 600_000, 50_000):
            reader.push(events.between(start, start + 50_000))
        counts[least_hz] = reader.statistics.events, reader.hot_pixels
        reader.close()
    assert counts[None] == (len(events), [])
    assert counts[500.0][1] == [(30, 20)] and counts[500.0][0] < len(events) - 1_000
