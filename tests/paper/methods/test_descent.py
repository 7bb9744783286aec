"""The paper's gradient descent: derivatives against central differences, steps that go down, a reading."""

import numpy as np
import pytest

from evqr import simulate
from evqr.events.window import make_window
from evqr.launched import LAUNCHED
from evqr.motion import Motion
from evqr.paper.methods.descent import (
    DescentConfig,
    Problem,
    descend_pose,
    read_window,
)
from evqr.simulate.geometry import transform
from evqr.workspace import Workspace
from evqr_kernels.registry import get_backend

VERSION = 1
SPEED = np.array([3.0, 2.0])  # [px/ms]
MOTION = Motion(1e3 * SPEED)
MIDDLE_US = 2000


@pytest.fixture(scope="module")
def workspace():
    backend = get_backend("auto")
    backend.load("cpu", LAUNCHED)
    return Workspace(backend, "cpu")


@pytest.fixture(scope="module")
def recording():
    return simulate.simulate(
        "GO DOWN",
        version=VERSION,
        ec="H",
        angle=30.0,
        direction=np.rad2deg(np.arctan2(SPEED[1], SPEED[0])),
        speed_px_ms=np.hypot(*SPEED),
        module_px=5.0,
        width=200,
        height=200,
        duration_us=2 * MIDDLE_US,
        seed=2,
    )


@pytest.fixture(scope="module")
def window(recording):
    return make_window(recording.events, MIDDLE_US - 250, MIDDLE_US + 250)


@pytest.fixture(scope="module")
def pose(recording):
    truth = recording.truth["truth"]
    pose = truth["H"][np.argmin(np.abs(truth["t_us"] - MIDDLE_US))]
    return pose / pose[2, 2]


def shifted(pose, modules):
    return pose @ np.array([[1.0, 0.0, modules], [0.0, 1.0, modules], [0.0, 0.0, 1.0]])


def problem_of(window, pose, workspace, dtype=np.float64):
    problem = Problem(window, MOTION, pose, VERSION, 0.8, workspace=workspace, dtype=dtype)
    problem.splat(problem.motion)
    return problem


def corner_error(pose, true):
    corners = np.array([[0.0, 0.0], [21.0, 0.0], [21.0, 21.0], [0.0, 21.0]])
    return np.abs(transform(pose, corners) - transform(true, corners)).max()


def test_pose_survives_the_change_of_units(window, pose, workspace):
    problem = problem_of(window, pose, workspace)
    np.testing.assert_allclose(problem.pose_of(problem.affine), pose, atol=1e-6)


def test_known_pixels_are_fewer_than_those_of_the_code_and_hold_the_finders(window, pose, workspace):
    problem = problem_of(window, pose, workspace)
    use = problem.known_pixels(problem.affine)
    modules = use.sum() / 5.0**2
    assert 3 * 5 * 5 < modules < 27 * 27 - 9 * 9


def test_derivative_in_the_code_equals_central_differences(window, pose, workspace):
    problem = problem_of(window, pose, workspace)
    rng = np.random.default_rng(0)
    grid = rng.normal(size=problem.known_grid.shape)
    direction = rng.normal(size=grid.shape)
    _, adj = problem.code_gradient(grid, problem.motion, problem.affine)
    adj = adj.copy()
    cost = [
        problem.code_gradient(grid + s * direction, problem.motion, problem.affine)[0] for s in (1e-4, -1e-4)
    ]
    assert (cost[0] - cost[1]) / 2e-4 == pytest.approx(float((adj * direction).sum()), rel=1e-6)


def test_derivatives_in_motion_and_map_equal_central_differences(window, pose, workspace, monkeypatch):
    problem = problem_of(window, shifted(pose, 0.2), workspace)
    motion, affine = problem.motion, problem.affine
    # what the derivative holds: the gain and the choice of pixels
    gain, use = problem.gain(motion, affine), problem.known_pixels(affine)
    monkeypatch.setattr(problem, "_gain", lambda *_: gain)
    monkeypatch.setattr(problem, "known_pixels", lambda _: use)
    rng = np.random.default_rng(1)
    by_motion, by_affine = rng.normal(size=2), rng.normal(size=(2, 3))
    _, adj_motion, adj_affine = problem.pose_gradient(motion, affine)
    step = 1e-6
    # the cost is divided by |m|^2, which a step holds too
    scale = [
        float((motion + s * by_motion) @ (motion + s * by_motion)) / float(motion @ motion)
        for s in (step, -step)
    ]
    cost = [
        problem.pose_gradient(motion + s * by_motion, affine)[0] * k
        for s, k in zip((step, -step), scale, strict=True)
    ]
    assert (cost[0] - cost[1]) / (2.0 * step) == pytest.approx(float(adj_motion @ by_motion), rel=1e-5)
    cost = [problem.pose_gradient(motion, affine + s * by_affine)[0] for s in (step, -step)]
    assert (cost[0] - cost[1]) / (2.0 * step) == pytest.approx(
        float((adj_affine * by_affine).sum()), rel=1e-3
    )


def test_each_step_in_the_code_goes_down(window, pose, workspace):
    problem = problem_of(window, pose, workspace)
    problem.splat(problem.motion, gain=problem.gain(problem.motion, problem.affine))
    grid, costs = problem.known_grid.copy(), []
    for _ in range(8):
        cost, adj = problem.code_gradient(grid, problem.motion, problem.affine)
        grid -= np.where(problem.free, DescentConfig().code_rate * adj, 0.0)
        costs.append(cost)
    assert (np.diff(costs) < 0.0).all() and costs[-1] < 0.6 * costs[0]


def test_pose_comes_closer(window, pose, workspace):
    start = shifted(pose, 0.5)
    problem = problem_of(window, start, workspace, np.float32)
    _, affine, iterations = descend_pose(problem, DescentConfig())
    assert 1 < iterations < DescentConfig().max_iterations
    assert corner_error(problem.pose_of(affine), pose) < 0.4 * corner_error(start, pose)


def test_reads_a_window(window, pose, workspace):
    reading = read_window(window, MOTION, shifted(pose, 0.3), VERSION, workspace=workspace)
    assert reading.text == "GO DOWN"
    assert reading.q.shape == (21, 21)
    assert set(reading.compute_ms) - {"one_time"} == {"stage_one", "stage_two", "decode", "total"}
    np.testing.assert_allclose(reading.motion.velocity, 1e3 * SPEED, rtol=0.1)
