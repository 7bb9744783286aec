"""Lags: estimated from the known modules, they make the pose and the agreement better."""

import numpy as np
import pytest
from scenes import scene

from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.fit.align import align, fine_levels
from evqr.fit.detection import Target
from evqr.fit.lag import estimate_lags
from evqr.fit.region import regions_of
from evqr.fit.targets import Targets
from evqr.simulate import SensorConfig

CONFIG = ReadConfig()


def estimated(made, workspace, see):
    """What is seen, the alignment without lags, the lags [px], and the alignment with them."""
    seen = see(made)
    without = align(
        seen.image,
        seen.in_cells[None],
        seen.space,
        fine_levels(CONFIG.align),
        CONFIG.align,
        workspace=workspace,
    )
    target, batch = Target(seen.space, seen.pose, seen.motion), EventBatch.of([seen.window])
    lag_px, found = estimate_lags(
        batch, Targets([target]), regions_of([seen.region]), without.pose, CONFIG, workspace=workspace
    )
    return seen, without, lag_px[0], found


@pytest.mark.parametrize(
    ("preset", "speed", "gain"), [("fast", 4.0, 0.01), ("fast", 10.0, 0.02), ("hard", 8.0, 0.02)]
)
def test_pixels_that_lag_are_seen_to(preset, speed, gain, workspace, see):
    seen, without, lag_px, found = estimated(scene(preset=preset, speed_px_ms=speed), workspace, see)
    assert (lag_px > 0.25).all()
    assert lag_px[1] > lag_px[0]  # the simulated pixels are slow in the dark, like real ones
    assert found.score[0] > without.score[0] + gain
    assert seen.modules_off(found.pose[0]) < 0.6 * seen.modules_off(without.pose[0])
    assert seen.modules_off(found.pose[0]) < 0.25


def test_lag_grows_with_the_time_constant(workspace, see):
    lags = [
        estimated(
            scene(preset=SensorConfig(tau_us=tau, tau_follows_light=False), speed_px_ms=10.0), workspace, see
        )[2].mean()
        for tau in (50.0, 200.0)
    ]
    # 10 px/ms times tau; the pairs that are tried are a factor 1.6 apart
    assert 0.25 < lags[0] < 1.6
    assert 1.2 < lags[1] < 3.2
    assert lags[1] > 1.5 * lags[0]


def test_a_clean_scene_has_almost_none(workspace, see):
    seen, without, lag_px, found = estimated(scene(), workspace, see)
    # the optics blur too, which small lags sharpen a little
    assert lag_px.mean() < 0.2 * seen.module_px
    assert found.score[0] < without.score[0] + 0.01
    assert seen.modules_off(found.pose[0]) < 0.12


def test_an_inverted_code_lags_alike(workspace, see):
    _, without, lag_px, found = estimated(scene(preset="fast", invert=True), workspace, see)
    assert (lag_px > 0.25).all()
    assert found.score[0] > without.score[0]


def test_the_alignment_is_that_of_one_hypothesis_on_a_fresh_buffer(workspace, see):
    """Two estimates in a row are the same: nothing of the first is left in the buffers."""
    made = scene(preset="fast")
    _, _, lag_px, found = estimated(made, workspace, see)
    estimated(scene(), workspace, see)
    _, _, again_px, again = estimated(made, workspace, see)
    np.testing.assert_array_equal(lag_px, again_px)
    np.testing.assert_array_equal(found.pose, again.pose)
    assert found.pose.shape == (1, 3, 3)
    assert found.score.shape == found.noise.shape == (1,)
