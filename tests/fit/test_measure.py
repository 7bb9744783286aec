"""A code whose pose is nearly known, measured in one sequence: as stage by stage, and in a graph."""

import numpy as np
import pytest
from scenes import at, middle_us, motion_at, scene, window_of
from steps import deposit, normal_equations, sharpen

from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.fit.align import align, fine_levels
from evqr.fit.detection import Target
from evqr.fit.image import cells_for
from evqr.fit.measure import Measure, measure
from evqr.fit.modules import NormalEquations
from evqr.fit.region import Region, region_around, regions_of
from evqr.fit.tables import Codes, room_for
from evqr.fit.targets import Targets
from evqr.symbol import qr
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded

CONFIG = ReadConfig()
SPACE = qr.space(2)
LAG_PX = (0.4, 0.7)


def known(made, time):
    """What following knows of a window: the window, targets that are a little off, and regions."""
    truth = made.truth["truth"]
    window = window_of(made, 2.0, middle=time)
    motion = motion_at(truth, window.middle_us)
    pose = at(truth, "H", window.middle_us)
    region = region_around(pose, SPACE, CONFIG.align)
    off = np.eye(3)
    off[:2, 2] = 0.3, -0.2
    targets = Targets([Target(SPACE, off @ pose, motion, motion.tau_us(LAG_PX))])
    return window, targets, regions_of([region])


@pytest.fixture(scope="module")
def made():
    return scene(preset="fast")


def assert_same(measured, found, equations):
    np.testing.assert_array_equal(measured.alignment.pose, found.pose)
    np.testing.assert_array_equal(measured.alignment.score, found.score)
    np.testing.assert_array_equal(measured.equations[0].rhs, equations.rhs)
    np.testing.assert_array_equal(measured.equations[0].stencil, equations.stencil)


@pytest.mark.parametrize("deposited", [False, True])
def test_it_is_the_stages_one_by_one(made, deposited, workspace):
    window, targets, regions = known(made, middle_us(made))
    (target,), (row,) = targets.targets, regions.tolist()
    region = Region(*row[:3], *map(int, row[3:]))
    motion, pose = target.motion, region.from_px @ target.pose
    one = CONFIG.align
    deposited_cells = deposit(window, motion, region, workspace=workspace)
    image = sharpen(deposited_cells, motion, region, [target.lag_px], workspace=workspace)
    found = align(image, pose[None], SPACE, fine_levels(one), one, workspace=workspace)
    equations = normal_equations(
        image, found.pose[0], found.gain[0], SPACE, one.sigma, CONFIG.modules, workspace=workspace
    )
    if not deposited:  # the cells hold another window then
        deposit(window_of(made, 1.0, middle=middle_us(made)), motion, region, workspace=workspace)
    measured = measure(EventBatch.of([window]), targets, regions, CONFIG, workspace=workspace)
    assert_same(measured, found, equations)
    assert measured.alignment.score[0] > 0.8


def test_whole_windows_run_as_one_captured_graph(made, workspace):
    """From events to modules; captured on one window, it serves the next one, on CPUs and GPUs alike."""
    import warp as wp

    time = middle_us(made)
    window, targets, regions = known(made, time)
    batch, nothing = EventBatch.of([window]), [NormalEquations.nothing(SPACE)]
    events, cells = workspace.events(batch), cells_for(regions, workspace=workspace)
    codes, (level,) = Codes.of(workspace), fine_levels(CONFIG.align)
    number, room = codes.number(SPACE), room_for([SPACE])
    poses, modules = codes.poses(level, CONFIG.align, [number]), codes.modules(CONFIG.modules, [number])
    step = Measure(events, cells, poses, None, modules, room, CONFIG, workspace, solved=True)
    step.write(batch, targets, regions, [number], nothing)
    step.launch()  # loads what nothing else has used
    with wp.ScopedCapture(device=workspace.device) as capture:
        step.launch()
    for moment in (time, time + 400.0):
        window, targets, regions = known(made, moment)
        batch = EventBatch.of([window])
        assert cells_for(regions, workspace=workspace) is cells and workspace.events(batch) is events
        step.write(batch, targets, regions, [number], nothing)
        wp.capture_launch(capture.graph)
        found = step.read()
        again = measure(EventBatch.of([window]), targets, regions, CONFIG, workspace=workspace)
        assert_same(again, found.alignment, found.equations[0])
        (fused,) = found.fused
        assert fused is not None
        outcome = decode_grid(fused.estimate.q, SPACE)
        assert isinstance(outcome, Decoded)
        assert outcome.text == made.scene.codes[0].text
