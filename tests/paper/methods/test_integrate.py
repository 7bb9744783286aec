"""The integrating rival: its parts against what can be said by hand, and one reading."""

import numpy as np
import pytest

from evqr import simulate
from evqr.events.window import make_window
from evqr.launched import LAUNCHED
from evqr.motion import Motion
from evqr.paper.methods.integrate import IntegrateConfig, accumulate, integrate, read_window, stretch
from evqr.workspace import Workspace
from evqr_kernels.registry import get_backend


@pytest.fixture(scope="module")
def workspace():
    backend = get_backend("auto")
    backend.load("cpu", LAUNCHED)
    return Workspace(backend, "cpu")


@pytest.fixture(scope="module")
def recording():
    return simulate.simulate("INTEGRATE", version=2, angle=20.0, direction=140.0, speed_px_ms=4.0, seed=1)


def motion_of(recording):
    return Motion(recording.truth["truth"]["velocity"][0])


def window_of(recording, travel_px=4.0):
    start = int(recording.events.t[0])
    return make_window(recording.events, start, start + round(travel_px / 4.0 * 1000.0))


def test_integrating_undoes_differentiating():
    rows = np.arange(200)[:, None]
    luminance = np.exp(-0.5 * ((rows - np.array([[70.5, 110.0]])) / 6.0) ** 2).astype(np.float32)
    slope = np.diff(luminance, axis=0, prepend=np.float32(0.0))
    restored = integrate(-slope, memory=1e4)
    np.testing.assert_allclose(restored, luminance, atol=0.01)


def test_integrating_forgets():
    slope = np.zeros((101, 1), np.float32)
    slope[50] = 1.0
    step = integrate(slope, memory=10.0)[:, 0]
    after, before = step[50:], step[:50][::-1]
    np.testing.assert_allclose(after, -0.5 * np.exp(-np.arange(51) / 10.0), atol=1e-6)
    np.testing.assert_allclose(before, 0.5 * np.exp(-np.arange(1, 51) / 10.0), atol=1e-6)


def test_accumulating_keeps_every_event_inside_the_view(recording, workspace):
    window = window_of(recording)
    cells = accumulate(window, motion_of(recording), IntegrateConfig(), workspace=workspace)
    # weights are polarities less their mean, and the blur adds up to 4 x 16
    assert abs(cells.sum()) < 1e-3 * np.abs(cells).sum()
    assert np.abs(cells).sum() <= 64.0 * 2.0 * len(window)


def test_edges_add_up_only_at_the_true_motion(recording, workspace):
    window, motion = window_of(recording), motion_of(recording)
    right = accumulate(window, motion, IntegrateConfig(), workspace=workspace).std()
    wrong = accumulate(window, Motion(-motion.velocity), IntegrateConfig(), workspace=workspace).std()
    assert right > 1.5 * wrong


def test_stretching_uses_the_whole_range_and_ignores_the_empty_part():
    luminance = np.zeros((90, 90), np.float32)
    luminance[30:60, 30:60] = np.where(np.arange(30) % 2, 3.0, 1.0)
    image = stretch(luminance, contrast=1.0)
    assert image.dtype == np.uint8
    assert image[30:60, 31:60:2].min() > 250 and image[30:60, 30:60:2].max() < 5
    assert (stretch(np.zeros((9, 9), np.float32), contrast=1.0) == 128).all()


@pytest.mark.parametrize("known", [True, False], ids=["motion known", "motion estimated"])
def test_reads_a_window(recording, workspace, known):
    motion = motion_of(recording) if known else None
    reading = read_window(window_of(recording), workspace=workspace, motion=motion)
    assert reading.text == "INTEGRATE"
    stages = {"accumulate", "integrate", "stretch", "decode", "total"} | (set() if known else {"motion"})
    assert set(reading.compute_ms) - {"one_time"} == stages


def test_reads_nothing_without_motion_or_code(recording, workspace):
    events = recording.events
    empty = read_window(make_window(events, -10, -5), workspace=workspace)
    assert empty.text is None and empty.image is None
    lost = simulate.shuffled(events)
    window = make_window(lost, 0, 1000)
    motion = motion_of(recording)
    assert read_window(window, workspace=workspace, motion=motion).text is None
