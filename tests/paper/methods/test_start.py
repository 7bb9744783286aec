"""The paper's start: motion by local PCA, finder patterns of events along the motion."""

import numpy as np
import pytest

from evqr.events.array import EventArray
from evqr.events.window import Window, make_window
from evqr.geometry import outline
from evqr.launched import LAUNCHED
from evqr.paper.methods.descent import Descent, DescentConfig
from evqr.paper.methods.event_image import event_image
from evqr.paper.methods.method import unwatched
from evqr.paper.methods.start import agreement_of, find_pose, principal_motion
from evqr.simulate import simulate
from evqr.workspace import Workspace
from evqr_kernels.registry import get_backend

VERSION, MODULE_PX, WINDOW_US = 2, 5.0, 400


@pytest.fixture(scope="module")
def workspace():
    backend = get_backend("auto")
    backend.load("cpu", LAUNCHED)
    return Workspace(backend, "cpu")


def passing(angle, direction=0.0):
    """The middle window of a code that passes at 5 px/ms, its true pose and its motion [px per window]."""
    made = simulate(
        "START", version=VERSION, ec="H", angle=angle, direction=direction, module_px=MODULE_PX,
        speed_px_ms=5.0, width=320, height=280, duration_us=8 * WINDOW_US, seed=4, threads=1,
    )  # fmt: skip
    window = make_window(made.events, 4 * WINDOW_US, 5 * WINDOW_US)
    truth = made.truth["truth"]
    pose = truth["H"][np.argmin(np.abs(truth["t_us"] - window.middle_us))]
    turn = np.deg2rad(direction)
    return window, pose / pose[2, 2], 2.0 * np.array([np.cos(turn), np.sin(turn)])


def plane(normal_px, velocity_px, sign, rng):
    """Events of an edge at right angles to ``normal_px`` that moves by ``velocity_px`` a window."""
    normal = np.array(normal_px) / np.hypot(*normal_px)
    along = np.array([-normal[1], normal[0]])
    t = rng.uniform(-0.5, 0.5, 4000)
    place = (
        np.array([100.0, 100.0])
        + t[:, None] * np.array(velocity_px)
        + rng.uniform(-60, 60, (4000, 1)) * along
    )
    return np.rint(1000 + 1000 * t), np.rint(place), np.full(4000, sign, np.int8)


def test_edges_of_two_directions_tell_the_motion():
    rng = np.random.default_rng(0)
    parts = [plane((1, 0.2), (3.0, -2.0), 1, rng), plane((-0.3, 1), (3.0, -2.0), -1, rng)]
    t, place, p = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(t, kind="stable")
    x, y = place[order].astype(np.uint16).T
    events = EventArray(t[order].astype(np.int64), x, y, p[order], 200, 200)
    motion = principal_motion(Window(events, 500, 1500))
    np.testing.assert_allclose(motion, [3.0, -2.0], atol=0.4)


def test_parallel_edges_tell_what_they_can_and_no_more():
    t, place, p = plane((1, 0), (3.0, 0.0), 1, np.random.default_rng(0))
    order = np.argsort(t, kind="stable")
    x, y = place[order].astype(np.uint16).T
    motion = principal_motion(
        Window(EventArray(t[order].astype(np.int64), x, y, p[order], 200, 200), 500, 1500)
    )
    np.testing.assert_allclose(motion, [3.0, 0.0], atol=0.4)


def test_light_that_is_switched_tells_no_motion():
    x, y = np.meshgrid(np.arange(40), np.arange(40))
    t = np.full(1600, 700)
    events = EventArray(
        t, x.ravel().astype(np.uint16), y.ravel().astype(np.uint16), np.ones(1600, np.int8), 40, 40
    )
    np.testing.assert_array_equal(principal_motion(Window(events, 500, 1500)), 0.0)


def test_few_events_tell_no_motion():
    window, _, _ = passing(30.0)
    assert principal_motion(window.keep(np.arange(len(window)) < 10)) is None
    assert principal_motion(window.keep(np.zeros(len(window), bool))) is None


@pytest.mark.parametrize(
    ("angle", "direction"), [(0.0, 0.0), (30.0, 0.0), (45.0, 0.0), (10.0, 90.0), (45.0, 180.0)]
)
def test_the_code_is_found_at_any_angle_and_direction(angle, direction, workspace):
    window, pose, true_motion = passing(angle, direction)
    motion = principal_motion(window)
    assert np.hypot(*(motion - true_motion)) < 0.25 * np.hypot(*true_motion)
    found = find_pose(window, motion, VERSION, epsilon_px=0.8, workspace=workspace)
    assert found is not None
    assert np.abs(outline(found, (25, 25)) - outline(pose, (25, 25))).max() < 1.5 * MODULE_PX


def test_agreement_is_high_at_the_code_only(workspace):
    window, pose, motion = passing(30.0)
    image = event_image(window, motion, epsilon_px=0.8, workspace=workspace)
    there = agreement_of(image, pose[:2], motion, VERSION)
    beside = pose @ np.array([[1.0, 0.0, 3.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert there > 0.8 > 0.3 > abs(agreement_of(image, beside[:2], motion, VERSION))
    assert agreement_of(image, pose[:2], -motion, VERSION) == pytest.approx(-there)
    outside = pose + np.array([[0.0, 0.0, 500.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert agreement_of(image, outside[:2], motion, VERSION) == 0.0


def test_no_code_no_pose(workspace):
    window, _, motion = passing(30.0)
    rng = np.random.default_rng(0)
    e = window.events
    shuffled = EventArray(e.t, rng.permutation(e.x), rng.permutation(e.y), e.p, e.width, e.height)
    noise = Window(shuffled, window.start_us, window.end_us)
    assert find_pose(noise, motion, VERSION, epsilon_px=0.8, workspace=workspace) is None
    silent = window.keep(np.zeros(len(window), bool))
    assert find_pose(silent, motion, VERSION, epsilon_px=0.8, workspace=workspace) is None


def test_the_solver_s_start_stands_in_where_the_paper_s_finds_nothing(monkeypatch):
    window, _, _ = passing(30.0)
    outcome = Descent(VERSION).read(window, unwatched)
    assert (outcome.text, outcome.start) == ("START", "paper") and outcome.pose_iterations > 1
    monkeypatch.setattr(Descent, "from_paper", lambda *_: None)
    outcome = Descent(VERSION).read(window, unwatched)
    assert (outcome.text, outcome.start) == ("START", "solver")
    outcome = Descent(VERSION, DescentConfig(starts=("paper",))).read(window, unwatched)
    assert outcome.modules is None and outcome.start is None and not outcome.converged
