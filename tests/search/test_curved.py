"""Codes on cylinders, which are unrolled."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evqr.config import ReadConfig
from evqr.events.array import EventArray
from evqr.events.batch import EventBatch
from evqr.events.window import make_window
from evqr.motion import Motion
from evqr.search.curved import Bend, bends_of, unrolled
from evqr.search.tilted import Patterns
from evqr.solver import Solver
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded
from evqr.symbology import Symbology
from tests.scenes import middle_us, motion_at, scene, window_of


def bent(x, y, bend):
    """Where places of a print are seen: the definition."""
    (n_x, n_y), radius = bend.across, bend.radius
    x, y = x - bend.crest[0], y - bend.crest[1]
    way = n_x * x + n_y * y
    seen = radius * np.sin(way / radius) - way
    return x + n_x * seen + bend.crest[0], y + n_y * seen + bend.crest[1]


def patterns_on(bend, *, modules=18.0, module_px=4.0, angle=0.4, worst=0.8):
    """Three patterns of a code in the middle of the crest, and their shapes, by differences."""
    cos, sin = module_px * np.cos(angle), module_px * np.sin(angle)
    u, v = np.array([cos, sin]), np.array([-sin, cos])
    places = np.array([bend.crest + 0.5 * modules * (a * u + b * v) for a, b in ((-1, -1), (1, -1), (-1, 1))])

    def at(place):
        return np.array(bent(place[0], place[1], bend))

    centre = np.array([at(place) for place in places])
    shape = np.array([[(at(p + 0.01 * w) - at(p - 0.01 * w)) / 0.02 for w in (u, v)] for p in places])
    return Patterns(
        np.array([[0, 1, 2]]), np.zeros(1, np.intp), np.zeros(1, np.bool_), np.array([worst]), centre[None],
        np.moveaxis(shape, 1, 2)[None], np.ones((1, 2)),
    )  # fmt: skip


@settings(max_examples=12, deadline=None)
@given(turn=st.floats(0.0, 3.1), radius=st.floats(50.0, 80.0), angle=st.floats(0.0, 6.2))
def test_a_bend_follows_from_three_patterns(turn, radius, angle):
    bend = Bend((160.0, 120.0), (np.cos(turn), np.sin(turn)), radius, 100.0)
    (found,) = bends_of(patterns_on(bend, angle=angle), 0)
    x, y = np.meshgrid(np.linspace(120.0, 200.0, 5), np.linspace(80.0, 160.0, 5))
    inside = np.hypot(x - 160.0, y - 120.0) < 45.0
    here, there = bent(x[inside], y[inside], bend), bent(x[inside], y[inside], found)
    assert np.abs(np.array(here) - np.array(there)).max() < 2.5


def test_patterns_that_are_not_clear_suggest_nothing():
    bend = Bend((160.0, 120.0), (1.0, 0.0), 60.0, 100.0)
    assert not bends_of(patterns_on(bend, worst=0.5), 0)
    assert not bends_of(patterns_on(bend), 1)


def test_events_go_to_where_they_are_on_the_print():
    rng = np.random.default_rng(3)
    bend, motion = Bend((160.0, 120.0), (0.6, 0.8), 60.0, 90.0), Motion(np.array([3000.0, -1000.0]), 500.0)
    t = np.sort(rng.integers(0, 1000, 400))
    x, y = rng.integers(130, 190, 400), rng.integers(90, 150, 400)
    p = rng.choice(np.array([-1, 1], np.int8), 400)
    window = make_window(EventArray(t, x.astype(np.uint16), y.astype(np.uint16), p, 320, 240), 0, 1000)
    flat = unrolled(window, motion, bend).events
    assert (flat.t == 500).all() and (flat.width, flat.height) == (320, 240)
    assert len(flat) == 400
    again = bent(flat.x.astype(np.float64), flat.y.astype(np.float64), bend)
    seconds = (t - 500) * 1e-6
    # a pixel on the print is at most as wide where it is seen
    assert np.abs(again[0] - (x - 3000.0 * seconds)).max() < 0.75
    assert np.abs(again[1] - (y + 1000.0 * seconds)).max() < 0.75
    np.testing.assert_array_equal(flat.p, p)


def rolled(events, time_us, velocity, bend):
    """A flat scene's events where they are seen when it is printed on a cylinder that moves along."""
    seconds = (events.t - time_us) * 1e-6
    x, y = events.x - velocity[0] * seconds, events.y - velocity[1] * seconds
    way = np.abs(bend.across[0] * (x - bend.crest[0]) + bend.across[1] * (y - bend.crest[1]))
    there = way < 1.4 * bend.radius
    x, y = bent(x, y, bend)
    x, y = np.rint(x + velocity[0] * seconds), np.rint(y + velocity[1] * seconds)
    there &= (x >= 0) & (y >= 0) & (x < events.width) & (y < events.height)
    return EventArray(
        events.t[there], x[there].astype(np.uint16), y[there].astype(np.uint16), events.p[there],
        events.width, events.height,
    )  # fmt: skip


@pytest.mark.parametrize(("turn", "radius"), [(0.0, 0.5), (0.25, 0.6)])
def test_a_code_on_a_cylinder_is_read_in_one_window(turn, radius):
    made = scene("ROUND", ec="H", module_px=4.4, angle=10.0, travel_px=4.0)
    truth, middle = made.truth["truth"], middle_us(made)
    motion = motion_at(truth, middle)
    way = np.deg2rad(10.0) + turn
    bend = Bend((159.5, 119.5), (np.cos(way), np.sin(way)), radius * 25 * 4.4, 200.0)
    events = rolled(made.events, middle, motion.velocity, bend)
    half = (window_of(made).end_us - window_of(made).start_us) // 2
    window = make_window(events, middle - half, middle + half)
    solver = Solver(ReadConfig(symbologies=(Symbology.QR_CODE,)))
    (found,) = solver.find(EventBatch.of([window]), [motion])
    assert isinstance(found, tuple) and found[0].score > 0.8
    (estimate,) = solver.solve(found[:1])
    read = decode_grid(estimate.q, found[0].space)
    assert isinstance(read, Decoded) and read.payload.text == "ROUND"
