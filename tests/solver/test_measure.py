"""A code whose pose is nearly known, measured in one sequence: as stage by stage, and in a graph."""

import numpy as np
import pytest
from scenes import at, middle_us, scene, window_of
from steps import deposit, normal_equations, sharpen

from evqr.codespace import code_space
from evqr.config import ReadConfig
from evqr.decode import Decoded, decode_grid
from evqr.measure import Measure, measure
from evqr.model import QUIET_MODULES, lattice, profiles
from evqr.region import depositing, region_around
from evqr.stage_one import align, fine_levels
from evqr.stage_two import REACH, SUPPORT

CONFIG = ReadConfig()
LAG_PX = (0.4, 0.7)
DAMPING = 0.1


def known(made, time):
    """What following knows of a window: the window, velocity, region and pose in its cells, a little off."""
    truth = made.truth["truth"]
    window = window_of(made, 2.0, middle=time)
    velocity = at(truth, "velocity", window.middle_us)
    pose = at(truth, "H", window.middle_us)
    region = region_around(pose, 25, CONFIG.stage_one)
    off = np.eye(3)
    off[:2, 2] = 0.3, -0.2
    return window, velocity, region, region.from_px @ (off @ pose)


@pytest.fixture(scope="module")
def made():
    return scene(preset="fast")


def solving(step, peak, workspace):
    """Launches that build the whole of stage two's equations from what ``step`` leaves, and solve them.

    ``peak`` is the size of the matrix's entries, as an earlier window knows it.
    """
    cfg, samples, backend = CONFIG.stage_two, CONFIG.stage_two.samples, workspace.backend
    space, inner = code_space(2), slice(QUIET_MODULES, -QUIET_MODULES)
    n, k = 25 + 2 * QUIET_MODULES, 2 * REACH + 1
    free, start = np.zeros((n, n), np.int32), np.zeros((1, n, n), np.float32)
    free[inner, inner] = ~space.known
    start[0, inner, inner] = np.where(space.known, space.values - 1.0, -1.0)
    profile, slope, _ = profiles(
        (np.arange(SUPPORT * samples) + 0.5) / samples - SUPPORT // 2, CONFIG.stage_one.sigma
    )
    axis = lattice(25, samples)
    axis, profile, slope, damping = (
        workspace.put(np.asarray(f, np.float32)) for f in (axis, profile, slope, [DAMPING * peak])
    )
    free, q = workspace.put(free), workspace.put(start)
    stencil = workspace.empty(1, k, k)
    # the damping pulls q to 0, not q - 1: that moves the right-hand side
    terms, rhs = workspace.put(np.ones((2, n, n), np.float32)), workspace.empty(1, n, n)
    weight = workspace.put(np.array([[1.0, DAMPING * peak]], np.float32))
    sampled, rows = workspace.empty(1, n * samples, n * samples), workspace.empty(1, 2, n * samples, n)
    scratch = [workspace.empty(1, n, n) for _ in range(4)] + [workspace.empty(1, 4, n) for _ in range(2)]
    iterations = workspace.empty(1, dtype=np.int32)

    def launch():
        backend.code_normal_equations(
            step.sharpen.images, step.align.pose, axis, profile, slope, step.align.gain, samples, sampled,
            rows, stencil, terms[:1],
        )  # fmt: skip
        backend.mix_images(terms, weight, rhs)
        backend.solve_code(
            rhs, stencil, damping, free, q, tuple(scratch), iterations, max_iterations=cfg.max_iterations,
            tolerance=cfg.tolerance,
        )  # fmt: skip

    return launch, q


def assert_same(measured, found, equations):
    np.testing.assert_array_equal(measured.found.pose, found.pose)
    np.testing.assert_array_equal(measured.found.score, found.score)
    np.testing.assert_array_equal(measured.equations.rhs, equations.rhs)
    np.testing.assert_array_equal(measured.equations.stencil, equations.stencil)


@pytest.mark.parametrize("from_events", [True, False])
def test_it_is_the_stages_one_by_one(made, from_events, workspace):
    window, velocity, region, pose = known(made, middle_us(made))
    one = CONFIG.stage_one
    cells = deposit(window, velocity, region, workspace=workspace)
    image = sharpen(cells, velocity, region, [LAG_PX], workspace=workspace)
    found = align(image, pose[None], 2, fine_levels(one), one, workspace=workspace)
    equations = normal_equations(
        image, found.pose[0], found.gain[0], 2, one.sigma, CONFIG.stage_two, workspace=workspace
    )
    measured = measure(
        window, velocity, region, pose, 2, LAG_PX, CONFIG, workspace=workspace, from_events=from_events
    )
    assert_same(measured, found, equations)
    assert measured.found.score[0] > 0.8


def test_whole_windows_run_as_one_captured_graph(made, workspace):
    """From events to modules; captured on one window, it serves the next one, on CPUs and GPUs alike."""
    import warp as wp

    time = middle_us(made)
    window, velocity, region, pose = known(made, time)
    first = measure(window, velocity, region, pose, 2, LAG_PX, CONFIG, workspace=workspace)
    events = depositing(window, velocity, region, workspace=workspace)
    step = Measure(events, True, 2, CONFIG, workspace)
    solve, q = solving(step, first.equations.stencil[REACH, REACH], workspace)
    solve()  # loads what nothing else has used
    with wp.ScopedCapture(device=workspace.device) as capture:
        step.launch()
        solve()
    for moment in (time, time + 400.0):
        window, velocity, region, pose = known(made, moment)
        assert depositing(window, velocity, region, workspace=workspace) is events
        step.sharpen.write(velocity, region, [LAG_PX])
        step.align.write(pose[None], 0)
        wp.capture_launch(capture.graph)
        found = step.align.read()
        equations = step.equations.read(found.gain[0])
        again = measure(window, velocity, region, pose, 2, LAG_PX, CONFIG, workspace=workspace)
        assert_same(again, found, equations)
        inner = slice(QUIET_MODULES, -QUIET_MODULES)
        outcome = decode_grid(workspace.get(q)[0, inner, inner] + 1.0)
        assert isinstance(outcome, Decoded)
        assert outcome.text == made.scene.codes[0].text
