"""The pixel kernel against closed forms and against a plain integration of the pixel's equations."""

from math import erf

import numpy as np
import pytest

from evqr.simulate import SceneConfig, SensorConfig
from evqr.simulate.geometry import Motion
from evqr.simulate.sensor import RUN_IN_PX, draw_pixels, run_pixels
from evqr.simulate.texture import TEXELS, Texture

SIZE = 16
SPEED = 0.002  # px/us
DURATION_US = 8000
#: Where the object's centre is at t = 0 [px]: far to the right, so that all pixels walk over its left half.
CENTRE = 40.0
HALF_PX = 60.0
#: float32 in the pixels' clocks and levels.
TOLERANCE_US = 1.0
#: Linear interpolation of the log light between knots 1/6 px apart, for an edge blurred by 2 px: 0.004 px.
EDGE_TOLERANCE_US = 0.004 / SPEED


def run(light_at, sensor, *, seed=0, threads=1, rows=SIZE):
    """Events of pixels that watch light_at(px along the object), and what each pixel was drawn to be."""
    scene = SceneConfig(width=SIZE, height=rows, speed_px_ms=1000 * SPEED, duration_us=DURATION_US)
    half = np.array([HALF_PX, rows])
    columns = np.arange(2 * int(half[0] * TEXELS[0]) + 1)
    lines = 2 * int(half[1] * TEXELS[1]) + 1
    light = light_at((columns - half[0] * TEXELS[0]) / TEXELS[0])
    texture = Texture(
        light=np.tile(light.astype(np.float32), (lines, 1)),
        cover_along=np.ones(len(columns), np.float32),
        cover_across=np.ones(lines, np.float32),
        origin=half * TEXELS,
    )
    motion = Motion(
        plane_to_image=np.eye(3),
        direction=0.0,
        start=np.array([CENTRE, rows / 2]),
        speed=SPEED,
        duration_us=DURATION_US,
    )
    pixel = draw_pixels(scene, sensor, np.random.default_rng(seed))
    background = np.ones((rows, SIZE), np.float32)
    return run_pixels(scene, sensor, motion, texture, background, pixel, threads), pixel


def object_px(x, t):
    """Where pixel x looks on the object."""
    return x - CENTRE - SPEED * t


def start_us(x):
    """When pixel x begins its walk: at the next texture column before the run-in."""
    along = (object_px(x, -RUN_IN_PX / SPEED) + HALF_PX) * TEXELS[0]
    return -RUN_IN_PX / SPEED - (np.ceil(along) - along) / (TEXELS[0] * SPEED)


def of_pixel(raw, x, y):
    """Times and polarities of one pixel, in order of time."""
    mine = raw.address >> 1 == y * SIZE + x
    order = np.argsort(raw.t[mine])
    return raw.t[mine][order], np.where(raw.address[mine][order] & 1, 1, -1)


@pytest.mark.parametrize("slope", [0.08, -0.3])
def test_a_ramp_of_log_light_gives_events_at_equal_steps(slope):
    raw, pixel = run(lambda u: np.exp(slope * u / 2), SensorConfig(threshold_spread=0.03, off_to_on=1.3))
    rate = -slope / 2 * SPEED  # log units a microsecond at a pixel
    for x, y in ((0, 0), (7, 3), (15, 15)):
        t, p = of_pixel(raw, x, y)
        on, off, level = pixel[y, x].astype(float)
        step = on if rate > 0 else -off
        expected = start_us(x) + (step * np.arange(1, len(t) + 1) - level) / rate
        assert len(t) == int((rate * (DURATION_US - start_us(x)) + level) / step) > 1
        np.testing.assert_allclose(t, expected, atol=TOLERANCE_US)
        assert (p == np.sign(rate)).all()


def test_a_blurred_edge_gives_events_where_the_closed_form_crosses():
    sigma = 2.0

    def light(u):
        return 0.1 + 0.75 * np.array([0.5 * (1 + erf((v + 35.0) / sigma / 2**0.5)) for v in u])

    theta = 0.2
    raw, pixel = run(light, SensorConfig(threshold=theta))
    seen = 0
    for x in range(SIZE):
        t, p = of_pixel(raw, x, 5)
        before = np.log(light([object_px(x, start_us(x))]))[0] - pixel[5, x, 2]
        level = np.log(light(object_px(x, t)))
        miss = np.diff(np.append(before, level)) - p * theta
        slope = np.abs(np.log(light(object_px(x, t + 1))) - np.log(light(object_px(x, t - 1)))) / 2
        # A step of light is right when the times at both its ends are.
        assert (np.abs(miss) <= EDGE_TOLERANCE_US * (slope + np.append(0.0, slope[:-1])) + 1e-5).all()
        seen += len(t)
    assert seen > 100


def integrate(log_light, start, sensor, thresholds, level):
    """Events of one pixel by steps of 0.05 us: the pixel model's specification, without any cleverness."""
    step = 0.05
    times = np.arange(start, DURATION_US, step)
    knots = np.arange(start, DURATION_US + 200.0, 1 / (TEXELS[0] * SPEED))
    logs = np.interp(times, knots, log_light(knots))
    lights = np.exp(log_light(knots))
    lights = ((lights[1:] + lights[:-1]) / 2)[np.searchsorted(knots, times, side="right") - 1]
    on, off = thresholds
    leak = sensor.leak_hz * 1e-6 * on * step
    y = logs[0]
    free_at, events = -np.inf, []
    if not sensor.tau_follows_light:
        lights = np.ones_like(lights)
    for t, x, light in zip(times[1:], logs[1:], lights[:-1], strict=True):
        moved = (x - y) * (1.0 - np.exp(-step * light / sensor.tau_us)) if sensor.tau_us else x - y
        y += moved
        if t < free_at:
            continue
        level += (moved + leak) * min(1.0, (t - free_at) / step)
        if level >= on or level <= -off:
            over = level - on if level >= on else level + off
            events.append((t - step * over / (moved + leak), 1 if level >= on else -1))
            level, free_at = (0.0 if sensor.refractory_us else over), events[-1][0] + sensor.refractory_us
    return np.array(events).reshape(-1, 2).T


@pytest.mark.parametrize(
    "sensor",
    [
        SensorConfig(tau_us=150.0),
        SensorConfig(tau_us=150.0, tau_follows_light=False),
        SensorConfig(threshold=0.1, tau_us=60.0, refractory_us=90.0, off_to_on=1.4, threshold_spread=0.02),
        SensorConfig(refractory_us=120.0, leak_hz=600.0),
    ],
    ids=["lag-by-light", "lag", "lag-refractory", "leak"],
)
def test_events_agree_with_a_plain_integration(sensor):
    def log_light(u):
        return -1.2 + 0.9 * np.sin(1.3 * u) + 0.3 * np.sin(3.1 * u)

    raw, pixel = run(lambda u: np.exp(log_light(u)), sensor)
    x, y = 3, 9
    on, off, level = pixel[y, x].astype(float)
    start = start_us(x)
    expected_t, expected_p = integrate(lambda t: log_light(object_px(x, t)), start, sensor, (on, off), level)
    t, p = of_pixel(raw, x, y)
    assert len(t) > 20
    np.testing.assert_array_equal(p, expected_p)
    np.testing.assert_allclose(t, expected_t, atol=TOLERANCE_US)


def test_a_lagging_pixel_follows_a_ramp_by_the_closed_form():
    slope, tau = 0.3, 400.0
    raw, pixel = run(lambda u: np.exp(slope * u / 4), SensorConfig(tau_us=tau, tau_follows_light=False))
    rate = -slope / 4 * SPEED
    for x in (2, 11):
        t, _ = of_pixel(raw, x, 4)
        since = t - start_us(x)
        level = pixel[4, x, 2] + rate * (since - tau * (1 - np.exp(-since / tau)))
        crossed = -pixel[4, x, 1] * np.arange(1, len(t) + 1)
        assert len(t) > 2
        np.testing.assert_allclose((level - crossed) / rate, 0.0, atol=TOLERANCE_US)


def test_no_two_events_of_a_pixel_are_closer_than_the_refractory_time():
    def stripes(u):
        return np.where(np.floor(u) % 2 == 0, 0.05, 0.9)

    free, _ = run(stripes, SensorConfig())
    held, _ = run(stripes, SensorConfig(refractory_us=70.0))
    gaps = [np.concatenate([np.diff(of_pixel(raw, x, 1)[0]) for x in range(SIZE)]) for raw in (free, held)]
    assert gaps[0].min() < 20.0
    assert gaps[1].min() >= 70.0 - 1e-3


def test_leak_makes_still_pixels_fire_on_events_at_its_rate():
    raw, pixel = run(lambda u: np.full_like(u, 0.5), SensorConfig(leak_hz=500.0, off_to_on=1.5))
    assert (raw.address & 1).all()
    for x in range(SIZE):
        t, _ = of_pixel(raw, x, 2)
        first = start_us(x) + 2000.0 * (1 - pixel[2, x, 2] / pixel[2, x, 0])
        np.testing.assert_allclose(t, np.arange(first, DURATION_US, 2000.0), atol=TOLERANCE_US)


def test_threads_and_band_capacity_do_not_change_the_events(monkeypatch):
    def stripes(u):
        return np.where(np.floor(u / 2) % 2 == 0, 0.1, 0.9)

    sensor = SensorConfig(tau_us=50.0, threshold_spread=0.03)
    one, _ = run(stripes, sensor, rows=130)
    monkeypatch.setattr("evqr.simulate.sensor.EVENTS_PER_PIXEL", 1)
    three, _ = run(stripes, sensor, rows=130, threads=3)
    assert len(one.t) > 130 * SIZE
    np.testing.assert_array_equal(one.t, three.t)
    np.testing.assert_array_equal(one.address, three.address)
