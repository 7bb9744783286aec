"""The image around a code: its place, its cells, and the events that it is made of."""

import numpy as np
import pytest
from scenes import scene, window_of

from evqr.config import StageOneConfig
from evqr.model import QUIET_MODULES
from evqr.region import Region, events_near, module_px, outline, region_around, splat_region
from evqr.windows import Window

CONFIG = StageOneConfig()

POSE = np.array([[4.0, -1.5, 80.0], [1.5, 4.0, 40.0], [0.0, 0.0, 1.0]])
TILTED = POSE.copy()
TILTED[2, :2] = (8e-4, -5e-4)

AT_REST = np.zeros(2)


def window_with(x, y, t, p, seconds=1e-3):
    columns = (np.array(c, np.float32) for c in (x, y, t, p))
    half = round(seconds * 5e5)
    return Window(*columns, 1000 - half, 1000 + half, 320, 240)


def centre_of(image):
    """Centre of mass (x, y) and mass of an image [cells]."""
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    mass = image.sum(dtype=np.float64)
    return np.array([(columns * image).sum(), (rows * image).sum()]) / mass, mass


@pytest.mark.parametrize("pose", [POSE, TILTED], ids=["affine", "tilted"])
def test_outline_goes_round_from_the_top_left(pose):
    corners = outline(pose, 25)
    expected = [pose @ (u, v, 1.0) for u, v in ((0, 0), (25, 0), (25, 25), (0, 25))]
    np.testing.assert_allclose(corners, [(x / z, y / z) for x, y, z in expected])
    wider = outline(pose, 25, 2.0)
    np.testing.assert_allclose(wider[0], (pose @ (-2.0, -2.0, 1.0))[:2] / (pose @ (-2.0, -2.0, 1.0))[2])


@pytest.mark.parametrize("pose", [POSE, TILTED], ids=["affine", "tilted"])
def test_module_size_is_that_of_the_module_in_the_middle(pose):
    """The root of the area of a small square about the centre."""
    h = 0.05
    u, v, z = pose @ np.stack(
        [12.5 + h * np.array([-1, 1, 1, -1]), 12.5 + h * np.array([-1, -1, 1, 1]), np.ones(4)]
    )
    x, y = u / z, v / z
    area = 0.5 * abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    assert module_px(pose, 25) == pytest.approx(np.sqrt(area) / (2 * h), rel=1e-4)


@pytest.mark.parametrize("margin", [0.0, 4.0])
@pytest.mark.parametrize("pose", [POSE, TILTED], ids=["affine", "tilted"])
def test_a_region_holds_the_code_and_its_quiet_zone(pose, margin):
    region = region_around(pose, 25, CONFIG, margin_px=margin)
    corners = outline(pose, 25, QUIET_MODULES)
    far = np.array([region.x + region.width * region.cell, region.y + region.height * region.cell])
    assert (corners >= np.array([region.x, region.y]) + margin).all()
    assert (corners <= far - margin).all()
    assert region.cell == pytest.approx(module_px(pose, 25) / CONFIG.cells_a_module)


def test_cells_count_from_the_centre_of_the_first():
    region = Region(10.0, 20.0, 2.5, 32, 48)
    np.testing.assert_allclose(region.from_px @ (11.25, 21.25, 1.0), [0.0, 0.0, 1.0])
    np.testing.assert_allclose(region.from_px @ (13.75, 26.25, 1.0), [1.0, 2.0, 1.0])


def test_events_land_where_the_map_says(workspace):
    region = Region(10.0, 20.0, 2.0, 32, 48)
    window = window_with([40.0], [50.0], [0.0], [1.0])
    image = workspace.get(splat_region(window, AT_REST, region, CONFIG, workspace=workspace))[0]
    where, _ = centre_of(image)
    np.testing.assert_allclose(where, (region.from_px @ (40.0, 50.0, 1.0))[:2], atol=0.02)


def test_moving_events_meet_at_the_middle_of_the_window(workspace):
    """An edge that passes (60, 50) at the middle, seen at five times: one place, five times the mass."""
    region, velocity = Region(10.0, 20.0, 2.0, 48, 64), np.array([3000.0, -1000.0])
    t = np.array([-4e-4, -2e-4, 0.0, 2e-4, 4e-4])
    moving = window_with(60.0 + velocity[0] * t, 50.0 + velocity[1] * t, t, np.ones(5))
    together = workspace.get(splat_region(moving, velocity, region, CONFIG, workspace=workspace))[0].copy()
    one = window_with([60.0], [50.0], [0.0], [1.0])
    alone = workspace.get(splat_region(one, AT_REST, region, CONFIG, workspace=workspace))[0]
    np.testing.assert_allclose(together, 5.0 * alone, atol=1e-3)


def test_an_image_starts_from_nothing_each_time(workspace):
    region, window = Region(10.0, 20.0, 2.0, 32, 48), window_with([40.0], [50.0], [0.0], [-1.0])
    first = workspace.get(splat_region(window, AT_REST, region, CONFIG, workspace=workspace)).copy()
    second = workspace.get(splat_region(window, AT_REST, region, CONFIG, workspace=workspace))
    np.testing.assert_array_equal(first, second)
    assert first.min() < -0.05


def test_the_image_is_linear_in_both_lags(workspace):
    """What the estimate of the lags stands on."""
    made = scene()
    velocity = made.truth["truth"]["velocity"][0]
    window, region = window_of(made), Region(90.0, 60.0, 2.3, 48, 64)

    def image(on, off):
        shown = splat_region(window, velocity, region, CONFIG, workspace=workspace, lag_px=(on, off))
        return workspace.get(shown)[0].astype(np.float64)

    plain, on, off, both = image(0, 0), image(1, 0), image(0, 2), image(0.5, 3)
    assert np.abs(on - plain).max() > 0.1 * np.abs(plain).max()
    np.testing.assert_allclose(
        both, plain + 0.5 * (on - plain) + 1.5 * (off - plain), atol=1e-3 * np.abs(plain).max()
    )


def test_dropping_far_events_changes_nothing_inside(workspace):
    made = scene()
    velocity = made.truth["truth"]["velocity"][0]
    window, region = window_of(made), Region(120.0, 90.0, 2.0, 32, 32)
    near = events_near(window, velocity, region)
    assert len(near) < 0.5 * len(window)
    every, some = (
        workspace.get(splat_region(w, velocity, region, CONFIG, workspace=workspace))[0].copy()
        for w in (window, near)
    )
    np.testing.assert_allclose(some, every, atol=1e-3)
