"""Windows: times relative to the middle, and what is kept of them."""

import numpy as np
import pytest
from scenes import events_at

from evqr.events.array import EventArray
from evqr.events.window import make_window

COLUMNS = "xytp"


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


@pytest.mark.parametrize("step", [1, 2, 7])
def test_a_window_is_thinned_with_its_stamps(step):
    t, rng = np.arange(100, 150, dtype=np.int64), np.random.default_rng(1)
    x, y = rng.integers(0, 40, (2, 50)).astype(np.uint16)
    events = EventArray(t, x, y, rng.choice([-1, 1], 50).astype(np.int8), 40, 40)
    window = make_window(events, 100, 200)
    some = window.thinned(step)
    assert (some.start_us, some.end_us, len(some)) == (100, 200, -(-50 // step))
    np.testing.assert_array_equal(some.events.t, t[::step])
    np.testing.assert_array_equal(some.packed.x, x[::step])
    np.testing.assert_array_equal(some.packed.stamp, window.packed.stamp[::step])


def test_keep_takes_what_the_mask_says_and_the_same_bounds():
    window = make_window(events_at(range(50)), 10, 40)
    kept = window.keep(window.p > 0)
    assert len(kept) == 15
    assert (kept.p > 0).all()
    assert (kept.start_us, kept.end_us, kept.width, kept.height) == (10, 40, 64, 48)
    np.testing.assert_array_equal(kept.t, window.t[window.p > 0])
