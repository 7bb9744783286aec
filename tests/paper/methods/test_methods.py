"""What the methods have in common, and each on one scene that it reads."""

import numpy as np
import pytest

from evqr.events.array import EventArray
from evqr.events.window import make_window
from evqr.paper.methods.camera import Camera
from evqr.paper.methods.decay import Decay, DecayConfig, accumulate
from evqr.paper.methods.descent import Descent
from evqr.paper.methods.evqr import Own
from evqr.paper.methods.integrate import Integrate
from evqr.paper.methods.method import cut, unwatched
from evqr.paper.methods.pattern import find_code
from evqr.paper.methods.without_qr import WithoutQr, WithoutQrConfig, descend
from evqr.simulate import simulate
from evqr.symbol import qr
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded

TEXT, VERSION, SPEED_PX_MS = "METHODS", 2, 5.0


@pytest.fixture(scope="module")
def recording():
    return simulate(
        TEXT, version=VERSION, ec="H", angle=30.0, module_px=5.0, speed_px_ms=SPEED_PX_MS, width=320,
        height=240, duration_us=8000, seed=3, threads=1,
    )  # fmt: skip


@pytest.fixture(scope="module")
def window(recording):
    return make_window(recording.events, 3000, 3250)


def true_modules(recording):
    return np.where(recording.truth["truth"]["modules"] > 0, -1, 1)


def text_of(modules):
    outcome = decode_grid(modules, qr.space(qr.version_of(len(modules))), effort="full")
    return outcome.text if isinstance(outcome, Decoded) else None


def draw(modules, size=6, angle=0.0, shape=(240, 320)):
    """An image of a code: light 1, dark 0, bilinear between the pixels' centres."""
    ringed = np.pad(modules > 0, 4, constant_values=True).astype(float)
    y, x = np.mgrid[: shape[0], : shape[1]] - np.array([[[shape[0] / 2]], [[shape[1] / 2]]])
    c, s = np.cos(np.deg2rad(angle)) / size, np.sin(np.deg2rad(angle)) / size
    u, v = (c * x + s * y + len(ringed) / 2).astype(int), (-s * x + c * y + len(ringed) / 2).astype(int)
    inside = (u >= 0) & (v >= 0) & (u < len(ringed)) & (v < len(ringed))
    return np.where(inside, ringed[v.clip(0, len(ringed) - 1), u.clip(0, len(ringed) - 1)], 0.5)


def test_parts_of_a_window_are_windows_of_their_own(recording):
    whole = make_window(recording.events, 1000, 1900)
    parts = [cut(whole, 3, index) for index in range(3)]
    assert [(part.start_us, part.end_us) for part in parts] == [(1000, 1300), (1300, 1600), (1600, 1900)]
    assert sum(len(part) for part in parts) == len(whole)
    for part in parts:
        alone = make_window(recording.events, part.start_us, part.end_us)
        np.testing.assert_array_equal(part.x, alone.x)
        np.testing.assert_allclose(part.t, alone.t, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 30.0, 45.0, 130.0])
@pytest.mark.parametrize("size", [4, 6.5])
def test_pattern_matching_reads_a_clear_image_at_any_angle(recording, angle, size):
    modules = true_modules(recording)
    found = find_code(draw(modules, size, angle) * 40.0 - 7.0, VERSION)
    assert found is not None
    np.testing.assert_array_equal(np.sign(found), modules)


def test_pattern_matching_finds_nothing_where_nothing_is():
    assert find_code(np.zeros((100, 120)), VERSION) is None
    assert find_code(np.random.default_rng(0).normal(size=(200, 200)), VERSION) is None
    assert find_code(np.zeros((10, 12)) + np.eye(10, 12), VERSION) is None


def test_the_camera_gives_its_frame_back():
    frame = np.arange(12, dtype=np.uint8).reshape(3, 4)
    np.testing.assert_array_equal(Camera().read(frame, unwatched).image, frame)


@pytest.mark.parametrize("windows", [1, 4])
def test_own_reads(recording, windows):
    method = Own(windows=windows)
    seen = []
    outcome = method.read(
        make_window(recording.events, 3000, 3000 + 250 * windows),
        lambda i, q, _: seen.append(q.shape) or True,
    )
    assert outcome.text == TEXT and outcome.windows == 1 and outcome.confidence > 0.999
    assert seen == [(25, 25)]


def test_the_paper_s_descent_reads_and_shows_its_iterations(window):
    seen = []
    outcome = Descent(VERSION).read(window, lambda i, q, _: seen.append(i) or i >= 8)
    assert outcome.text == TEXT and outcome.converged
    assert seen == list(range(1, len(seen) + 1)) and 8 <= len(seen) <= 60


def test_integrating_reads(window):
    outcome = Integrate().read(window, unwatched)
    assert outcome.image is not None and outcome.text == TEXT


def test_decaying_events():
    events = EventArray(
        np.array([0, 50, 100]), np.array([0, 1, 1], np.uint16), np.array([0, 0, 0], np.uint16),
        np.array([1, -1, -1], np.int8), 2, 1,
    )  # fmt: skip
    image = accumulate(make_window(events, 0, 100 + 1), 1e-4)
    assert image.shape == (1, 2)
    np.testing.assert_allclose(image[0, 0], np.exp(-1.01), rtol=1e-4)
    np.testing.assert_allclose(image[0, 1], -np.exp(-0.51) - np.exp(-0.01), rtol=1e-4)


def test_decaying_events_are_those_of_dv_processing():
    dv = pytest.importorskip("dv_processing", reason="dv-processing is not installed")
    rng = np.random.default_rng(0)
    t, x, y = np.sort(rng.integers(0, 4000, 2000)), rng.integers(0, 16, 2000), rng.integers(0, 12, 2000)
    p = rng.choice(np.array([-1, 1], np.int8), 2000)
    t[-1] = 4000  # theirs stands at the last event, which is outside of our window
    store = dv.EventStore()
    for event in zip(t.tolist(), x.tolist(), y.tolist(), (p > 0).tolist(), strict=True):
        store.push_back(*event)
    theirs = dv.Accumulator(
        (16, 12), dv.Accumulator.Decay.EXPONENTIAL, 1000.0, True, 1.0, 1e6, 0.0, -1e6, False
    )
    theirs.accept(store)
    theirs.generateFrame()
    events = EventArray(t, x.astype(np.uint16), y.astype(np.uint16), p, 16, 12)
    ours = accumulate(make_window(events, 0, 4000), 1e-3)
    ours[y[-1], x[-1]] += p[-1]
    np.testing.assert_allclose(ours, theirs.getPotentialSurface(), atol=1e-5)


def test_a_decaying_accumulator_reads_what_came_long_enough(recording):
    method = Decay(DecayConfig(windows=7))
    outcome = method.read(make_window(recording.events, 500, 500 + 250 * method.windows), unwatched)
    assert method.windows == 28 and outcome.text == TEXT


def test_descending_without_the_code_is_the_derivative_of_equation_7():
    rng = np.random.default_rng(0)
    luminance, events, direction = rng.normal(size=(3, 9, 11)).astype(np.float32)
    motion, turn = np.array([1.5, -0.7]), np.array([0.3, 0.4])
    cfg = WithoutQrConfig()
    step, adj_motion = descend(luminance, events, motion, cfg)

    def cost(image, m):
        padded = np.pad(image.astype(np.float64), 1, mode="edge")
        dx, dy = (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2, (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2
        residual = m[0] * dx + m[1] * dy + events
        slopes = np.square(np.diff(image, axis=0)).sum() + np.square(np.diff(image, axis=1)).sum()
        return (np.square(residual).sum() / 2, cfg.smoothness * slopes / 2)

    scale = 1.0 / (motion @ motion + 8.0 * cfg.smoothness)
    h = 1e-2
    ahead, behind = (sum(cost(luminance + s * h * direction, motion)) for s in (1, -1))
    assert scale * (ahead - behind) / (2 * h) == pytest.approx(float((step * direction).sum()), rel=1e-3)
    ahead, behind = (cost(luminance, motion + s * h * turn)[0] for s in (1, -1))
    assert scale * (ahead - behind) / (2 * h) == pytest.approx(float(adj_motion @ turn), rel=1e-3)


def test_without_the_code_space_the_image_shows_the_code(window, recording):
    seen = []
    outcome = WithoutQr().read(window, lambda i, image, _: seen.append(i) or True)
    assert outcome.converged and 5 < len(seen) < 300
    modules = find_code(outcome.image, VERSION)
    assert np.mean(np.sign(modules) == true_modules(recording)) > 0.97
    assert text_of(modules) == TEXT


def test_methods_say_that_there_is_nothing(recording):
    empty = make_window(recording.events, -10, -5)
    for method in (Own(), Descent(VERSION), Integrate(), WithoutQr()):
        outcome = method.read(empty, unwatched)
        assert outcome.text is None and not outcome.converged, method
