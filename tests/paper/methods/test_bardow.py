"""Optical flow and intensity at once: its cost goes down, its parts do what they say, and it shows a code."""

from dataclasses import replace

import numpy as np
import pytest

from evqr.events.array import EventArray
from evqr.events.window import make_window
from evqr.paper.methods.bardow import Bardow, BardowConfig, Volume
from evqr.paper.methods.pattern import find_code
from evqr.paper.methods.registry import make_method
from evqr.simulate import simulate

SMALL = BardowConfig(slices=8, reduction=1)


def window_of(rows, *, size=(6, 5), end_us=800):
    """A window of events (t, x, y, p) on a small sensor."""
    t, x, y, p = np.array(rows).T
    events = EventArray(
        t.astype(np.int64), x.astype(np.uint16), y.astype(np.uint16), p.astype(np.int8), size[0], size[1]
    )
    return make_window(events, 0, end_us)


def fields_of(volume):
    return [field.numpy().astype(np.float64) for field in (volume.luminance, volume.flow_x, volume.flow_y)]


def cost_of(volume, window, cfg):
    """The cost, straight from its formula, flow term and all."""
    luminance, u, v = fields_of(volume)
    weights, theta = cfg.weights, cfg.threshold

    def ahead(field, axis):
        return np.diff(field, axis=axis, append=np.take(field, [-1], axis=axis))

    across = sum(np.abs(ahead(f, axis)).sum() for f in (u, v) for axis in (0, 1))
    between = sum(np.abs(ahead(f, 2)).sum() for f in (u, v))
    slope_y, slope_x, change = (ahead(luminance, axis) for axis in range(3))
    flow = (slope_x * u + slope_y * v + change)[..., :-1]
    cost = weights[0] * across + weights[1] * between
    cost += weights[2] * (np.abs(slope_x).sum() + np.abs(slope_y).sum()) + weights[3] * np.abs(flow).sum()
    total, count = np.zeros((2, *luminance.shape))
    slot = (window.events.t * cfg.slices // (window.end_us - window.start_us)).astype(int)
    np.add.at(total, (window.events.y, window.events.x, slot), window.events.p)
    np.add.at(count, (window.events.y, window.events.x, slot), 1)
    for y, x in np.ndindex(luminance.shape[:2]):
        last = 0
        for k in range(luminance.shape[2]):
            step = luminance[y, x, k] - luminance[y, x, last]
            if count[y, x, k]:
                cost += abs(step - theta * total[y, x, k]) if k else 0.0
                last = k
            else:
                cost += weights[4] * max(abs(step) - theta, 0.0)
    return float(cost)


def test_an_event_alone_is_a_step_of_the_threshold():
    cfg = replace(SMALL, weights=(0.0, 0.0, 0.0, 0.0, 0.1), threshold=0.3)
    volume = Volume(window_of([(450, 2, 2, 1), (650, 2, 2, -1), (450, 3, 1, -1)]), cfg, "cpu")
    for _ in range(400):
        volume.iterate()
    luminance = volume.luminance.numpy()
    changes = luminance - luminance[..., :1]
    np.testing.assert_allclose(changes[2, 2, [4, 6]], [0.3, 0.0], atol=1e-3)
    assert changes[1, 3, 4] == pytest.approx(-0.3, abs=1e-3)
    assert np.abs(changes[2, 2, :4]).max() <= 0.301 and np.abs(changes[0]).max() < 1e-6


def test_the_cost_goes_down():
    rng = np.random.default_rng(2)
    rows = [(100 * k + 50, k % 6, y, 1) for k in range(8) for y in range(1, 4)]
    rows += list(
        zip(*(rng.integers(0, top, 10) for top in (800, 6, 5)), rng.choice([-1, 1], 10), strict=True)
    )
    window = window_of(sorted(rows))
    volume = Volume(window, SMALL, "cpu")
    start = cost_of(volume, window, SMALL)
    costs = []
    for iteration in range(300):
        if iteration % 5 == 0:
            volume.relinearise()
        volume.iterate()
        costs.append(cost_of(volume, window, SMALL))
    assert costs[9] < 0.9 * start
    assert costs[-1] < 0.75 * start and costs[-1] <= min(costs[:50])


def test_a_region_holds_the_events_and_the_image_has_the_sensor_s_size():
    rows = [(10 * k, 30 + k % 9, 20 + k % 7, 1) for k in range(80)]
    volume = Volume(window_of(rows, size=(64, 48)), replace(SMALL, reduction=2), "cpu")
    assert volume.luminance.shape[0] < 24 and volume.luminance.shape[1] < 32
    volume.iterate()
    image = volume.image()
    assert image.shape == (48, 64) and not image[:8].any() and not image[:, :8].any() and image.any()
    assert Volume(window_of(rows[:0] or [(-5, 0, 0, 1)]), SMALL, "cpu").luminance.shape[2] == 8


def test_a_code_shows_in_the_middle_slice():
    made = simulate(
        "FLOW", version=1, ec="H", angle=30.0, module_px=6.0, speed_px_ms=5.0, width=240, height=200,
        duration_us=8000, seed=4, threads=1,
    )  # fmt: skip
    method = Bardow(BardowConfig(slices=32), iterations=15)
    seen = []
    outcome = method.read(make_window(made.events, 0, 8000), lambda i, image, _: seen.append(i) or True)
    assert method.windows == 32 and seen == list(range(1, len(seen) + 1)) and len(seen) <= 15
    modules = find_code(outcome.image, 1)
    true = np.where(made.truth["truth"]["modules"] > 0, -1, 1)
    assert modules is not None and np.mean(np.sign(modules) == true) > 0.95


def test_the_row_at_full_resolution_differs_in_that_alone():
    half, full = (make_method(name, 2).cfg for name in ("bardow", "bardow_full"))
    assert (half.reduction, full.reduction) == (2, 1) and replace(half, reduction=1) == full
