"""The same scene through eventcv's frame-based sensor (v2e's pixel model): the statistics agree.

Refractory times are left out: v2e's pixels remember what changed meanwhile, ours, held in reset, forget it.
"""

import dataclasses

import numpy as np
import pytest

from evqr.simulate import CodePlacement, SceneConfig, SensorConfig
from evqr.simulate.geometry import plan_motion, transform
from evqr.simulate.printed import make_symbol
from evqr.simulate.sensor import RUN_IN_PX, RawEvents, add_noise, draw_pixels, read_out, run_pixels
from evqr.simulate.texture import TEXELS, draw_background, draw_object

eventcv = pytest.importorskip("eventcv", reason="needs the extra formats: pip install 'evqr[formats]'")

# v2e's response is logarithmic above 20/255 of full light only: a print of 0.35 stays above that.
SCENE = SceneConfig(
    codes=(CodePlacement(text="same scene", module_px=5.0, angle=25.0),),
    width=200,
    height=170,
    duration_us=4000,
    black=0.35,
)
#: Travel between two frames [px].
FRAME_PX = 0.125


def sample(image, u, v):
    """Bilinear interpolation, edges continued."""
    column, row = (
        np.clip(np.floor(c).astype(int), 0, n - 2) for c, n in ((u, image.shape[1]), (v, image.shape[0]))
    )
    du, dv = np.clip(u - column, 0, 1), np.clip(v - row, 0, 1)
    above = image[row, column] * (1 - du) + image[row, column + 1] * du
    below = image[row + 1, column] * (1 - du) + image[row + 1, column + 1] * du
    return above * (1 - dv) + below * dv


def draw(scene):
    """Motion, texture and background of a scene."""
    symbols = [make_symbol(placement) for placement in scene.codes]
    rng = np.random.default_rng(scene.seed)
    return plan_motion(scene, symbols), draw_object(scene, symbols, rng), draw_background(scene, rng)


def watch(scene, sensor):
    """Events of our sensor, whose pixels all start at level 0 as eventcv's do."""
    motion, texture, background = draw(scene)
    rng = np.random.default_rng(scene.seed)
    pixel = draw_pixels(scene, sensor, rng)
    pixel[..., 2] = 0.0
    raw = run_pixels(scene, sensor, motion, texture, background, pixel)
    return read_out(raw, scene, sensor, motion, rng)


def render(scene):
    """Frames of a scene from the run-in on, as linear light, and their times [us]."""
    motion, texture, background = draw(scene)
    cover = np.outer(texture.cover_across, texture.cover_along)
    rows, columns = np.mgrid[: scene.height, : scene.width].astype(float)
    times = np.arange(-RUN_IN_PX / motion.speed, scene.duration_us + 1, FRAME_PX / motion.speed)
    frames = []
    for t in times:
        at = transform(np.linalg.inv(motion.object_to_image(t)), np.stack([columns, rows], -1))
        u, v = np.moveaxis(at * TEXELS + texture.origin, -1, 0)
        frames.append(sample(texture.light, u, v) + (1 - sample(cover, u, v)) * background)
    return np.stack(frames), times


@pytest.fixture(scope="module")
def frames():
    light, times = render(SCENE)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055), times


def pixel_counts(x, y):
    return np.bincount(
        np.asarray(y, int) * SCENE.width + np.asarray(x, int), minlength=SCENE.width * SCENE.height
    )


@pytest.mark.parametrize(
    ("sensor", "options", "count", "similarity"),
    [
        # With equal thresholds the grain alone would decide whether a return to white gives a last event.
        (SensorConfig(off_to_on=1.1), {"neg_thres": 0.22, "cutoff_hz": 0.0}, 0.01, 0.98),
        (
            SensorConfig(threshold=0.3, off_to_on=0.8),
            {"pos_thres": 0.3, "neg_thres": 0.24, "cutoff_hz": 0.0},
            0.02,
            0.98,
        ),
        # v2e's dark pixels are faster than inversely proportional (20/275 is added to the light).
        (SensorConfig(off_to_on=1.1, tau_us=159.0), {"neg_thres": 0.22, "cutoff_hz": 1000.0}, 0.06, 0.95),
    ],
    ids=["ideal", "high-thresholds", "lag"],
)
def test_counts_polarities_and_their_places_agree(frames, sensor, options, count, similarity):
    light, times = frames
    setting = {
        "sigma_thres": 0.0,
        "refractory_us": 0,
        "leak_rate_hz": 0.0,
        "shot_noise_rate_hz": 0.0,
    } | options
    stream = eventcv.simulate(
        light.astype(np.float32), fps=1e6 / (times[1] - times[0]), upsample="off", **setting
    )
    x, y, t, p = stream.numpy().astype(np.int64).T
    recorded = t >= -times[0]
    x, y, p = x[recorded], y[recorded], p[recorded]
    ours = watch(SCENE, sensor)

    for sign in (-1, 1):
        mine = pixel_counts(ours.x[ours.p == sign], ours.y[ours.p == sign])
        theirs = pixel_counts(x[(p > 0) == (sign > 0)], y[(p > 0) == (sign > 0)])
        assert np.corrcoef(mine, theirs)[0, 1] > similarity
    assert len(ours) == pytest.approx(len(p), rel=count)
    assert (ours.p > 0).mean() == pytest.approx((p > 0).mean(), abs=0.01)


def test_background_activity_has_eventcvs_rate():
    # v2e gives a dark pixel the whole rate, and brighter ones less: look at a dark wall for 0.1 s.
    options = {"refractory_us": 0, "leak_rate_hz": 0.0, "cutoff_hz": 0.0, "sigma_thres": 0.0}
    wall = np.full((101, SCENE.height, SCENE.width), 0.02, np.float32)
    theirs = eventcv.simulate(wall, fps=1000.0, shot_noise_rate_hz=20.0, **options).numpy()
    still = dataclasses.replace(SCENE, codes=(), speed_px_ms=1.0, duration_us=100_000)
    none = RawEvents(t=np.empty(0), address=np.empty(0, np.int64))
    sensor, motion, rng = SensorConfig(background_hz=20.0), plan_motion(still, []), np.random.default_rng(1)
    ours = read_out(add_noise(none, still, sensor, motion, rng), still, sensor, motion, rng)
    assert len(ours) == pytest.approx(len(theirs), rel=0.06)
    assert (ours.p > 0).mean() == pytest.approx(theirs[:, 3].mean(), abs=0.03)
