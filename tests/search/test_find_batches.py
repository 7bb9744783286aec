"""Windows searched side by side: what is found in each does not depend on the others, to the bit."""

import pytest
from scenes import motion_at, noise, scene, window_of

from evqr.events.batch import EventBatch
from evqr.events.window import make_window
from evqr.fit.detection import NotFound
from evqr.motion import Motion
from evqr.solver import Solver


@pytest.mark.parametrize("count", [3, 6])
def test_a_batch_finds_what_each_window_shows_alone(count):
    windows, motions = [], []
    for seed, sensor in enumerate(((320, 240), (256, 200))):
        made = scene(seed=seed, width=sensor[0], height=sensor[1])
        windows.append(window_of(made))
        motions.append(motion_at(made.truth["truth"], windows[-1].middle_us))
    windows.append(make_window(noise(9_000, 1_000), 0, 1_000))
    motions.append(Motion([2000.0, 500.0], windows[-1].middle_us))
    windows, motions = 2 * windows, 2 * motions
    solver = Solver()
    together = solver.find(EventBatch.of(windows[:count]), motions[:count])
    assert [isinstance(found, NotFound) for found in together[:3]] == [False, False, True]
    for window, motion, found in zip(windows, motions, together, strict=False):
        (alone,) = solver.find(EventBatch.of([window]), [motion])
        assert found == alone
