"""Noise and readout: rates, shares, delays."""

import numpy as np
import pytest

from evqr.simulate import SceneConfig, SensorConfig
from evqr.simulate.geometry import Motion
from evqr.simulate.sensor import RawEvents, add_noise, read_out

SCENE = SceneConfig(width=64, height=48, speed_px_ms=10.0, duration_us=200_000)
MOTION = Motion(
    plane_to_image=np.eye(3), direction=0.0, start=np.zeros(2), speed=0.01, duration_us=SCENE.duration_us
)
PIXELS = SCENE.width * SCENE.height
#: The run-in of 10 px counts as well.
LENGTH_S = 0.201
NONE = RawEvents(t=np.empty(0), address=np.empty(0, np.int64))


def rng():
    return np.random.default_rng(5)


def steady(n):
    """n events spread evenly over the recording, each at a pixel of its own if there are enough."""
    return RawEvents(t=np.linspace(0, SCENE.duration_us - 1000, n), address=2 * (np.arange(n) % PIXELS))


def test_background_activity_has_its_rate_and_no_polarity():
    noise = add_noise(NONE, SCENE, SensorConfig(background_hz=20.0), MOTION, rng())
    expected = 20.0 * LENGTH_S * PIXELS
    assert abs(len(noise.t) - expected) < 5 * expected**0.5
    assert abs((noise.address & 1).mean() - 0.5) < 5 * 0.5 / expected**0.5
    per_pixel = np.bincount(noise.address >> 1, minlength=PIXELS)
    assert per_pixel.var() == pytest.approx(per_pixel.mean(), rel=0.15)  # Poisson
    assert np.histogram(noise.t, 8)[0].std() < 3 * (expected / 8) ** 0.5


def test_hot_pixels_are_few_fast_and_of_one_polarity():
    noise = add_noise(NONE, SCENE, SensorConfig(hot_fraction=0.01, hot_hz=3000.0), MOTION, rng())
    pixels, counts = np.unique(noise.address >> 1, return_counts=True)
    assert len(pixels) == round(0.01 * PIXELS)
    assert len(np.unique(noise.address)) == len(pixels)
    assert counts.mean() == pytest.approx(3000.0 * LENGTH_S, rel=0.02)


def test_drops_take_their_share():
    left = add_noise(steady(50_000), SCENE, SensorConfig(drop_rate=0.4), MOTION, rng())
    assert abs(len(left.t) - 30_000) < 5 * (50_000 * 0.4 * 0.6) ** 0.5


def test_jitter_has_its_spread_and_no_bias():
    events = steady(20_000)
    shaken = add_noise(events, SCENE, SensorConfig(jitter_us=30.0), MOTION, rng())
    moved = shaken.t - events.t
    assert moved.std() == pytest.approx(30.0, rel=0.03)
    assert abs(moved.mean()) < 5 * 30.0 / 20_000**0.5


def test_events_come_out_sorted_cut_and_with_their_pixel_and_polarity():
    raw = RawEvents(
        t=np.array([7.6, -3.0, 2.2, 2.2, 200_001.0]),
        address=np.array([2 * (3 * 64 + 5) + 1, 0, 2 * (2 * 64 + 63), 2 * 64 + 1, 9]),
    )
    events = read_out(raw, SCENE, SensorConfig(), MOTION, rng())
    np.testing.assert_array_equal(events.t, [2, 2, 8])
    np.testing.assert_array_equal(events.x, [0, 63, 5])
    np.testing.assert_array_equal(events.y, [1, 2, 3])
    np.testing.assert_array_equal(events.p, [1, -1, 1])
    assert (events.t.dtype, events.x.dtype, events.p.dtype) == (np.int64, np.uint16, np.int8)
    assert (events.width, events.height) == (64, 48)


def test_a_scanned_sensor_stamps_each_row_at_its_turn():
    scan = 480.0
    raw = steady(5_000)
    events = read_out(raw, SCENE, SensorConfig(row_scan_us=scan), MOTION, rng())
    turn = events.y * scan / SCENE.height
    np.testing.assert_array_equal((events.t - turn) % scan, 0.0)
    # Every pixel fires at most twice here: match its first event with its first stamp.
    first = np.unique(events.y.astype(int) * SCENE.width + events.x, return_index=True)[1]
    delay = np.sort(events.t[first])[: PIXELS // 2] - raw.t[: PIXELS // 2]
    assert events.t.size > 4_900
    assert -scan < delay.min() and delay.max() < 2 * scan


def test_a_readout_at_its_limit_delays_events_and_then_loses_them():
    # 50 events at once every 100 us, through 1 event a microsecond: all come, the last 49 us late.
    burst = RawEvents(
        t=np.repeat(np.arange(0.0, 100_000.0, 100.0), 50), address=2 * np.arange(50_000) % (2 * PIXELS)
    )
    events = read_out(burst, SCENE, SensorConfig(readout_meps=1.0), MOTION, rng())
    assert len(events) == 50_000
    np.testing.assert_array_equal(events.t, (np.arange(1000)[:, None] * 100 + np.arange(50)).ravel())
    # Through 0.2 events a microsecond only 20 of each 50 can pass, and none waits longer than two queues.
    sensor = SensorConfig(readout_meps=0.2, readout_queue_us=100.0)
    events = read_out(burst, SCENE, sensor, MOTION, rng())
    assert len(events) == pytest.approx(20_000, rel=0.01)
    assert np.bincount(events.t // 1000).max() <= 201
    assert (events.t % 100).max() < 100 and events.t[-1] < 100_000 + 200


def test_an_empty_recording_is_empty():
    events = read_out(NONE, SCENE, SensorConfig(readout_meps=1.0, row_scan_us=40.0), MOTION, rng())
    assert len(events) == 0
