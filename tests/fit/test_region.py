"""The image around a code: its place, its cells, and the events that it is made of."""

import numpy as np
import pytest
from scenes import scene, window_of
from steps import deposit, sharpen

from evqr.config import AlignConfig
from evqr.events.array import EventArray
from evqr.events.window import Window
from evqr.fit.model import quiet_modules
from evqr.fit.region import Region, in_cells, in_px, region_around, regions_around
from evqr.geometry import bounds, module_px, outline
from evqr.motion import Motion
from evqr.symbol import qr, rmqr

CONFIG = AlignConfig()

POSE = np.array([[4.0, -1.5, 80.0], [1.5, 4.0, 40.0], [0.0, 0.0, 1.0]])
TILTED = POSE.copy()
TILTED[2, :2] = (8e-4, -5e-4)

AT_REST = Motion(np.zeros(2))
SPACE = qr.space(2)


def window_with(x, y, t, p, seconds=1e-3):
    half = round(seconds * 5e5)
    columns = zip(
        (1000.0 + 1e6 * np.array(t), x, y, p), (np.int64, np.uint16, np.uint16, np.int8), strict=True
    )
    arrays = (np.round(column).astype(dtype) for column, dtype in columns)
    return Window(EventArray(*arrays, 320, 240), 1000 - half, 1000 + half)


def centre_of(image):
    """Centre of mass (x, y) and mass of an image [cells]."""
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    mass = image.sum(dtype=np.float64)
    return np.array([(columns * image).sum(), (rows * image).sum()]) / mass, mass


@pytest.mark.parametrize("pose", [POSE, TILTED], ids=["affine", "tilted"])
def test_outline_goes_round_from_the_top_left(pose):
    corners = outline(pose, SPACE.shape)
    expected = [pose @ (u, v, 1.0) for u, v in ((0, 0), (25, 0), (SPACE.shape), (0, 25))]
    np.testing.assert_allclose(corners, [(x / z, y / z) for x, y, z in expected])
    wider = outline(pose, SPACE.shape, 2.0)
    np.testing.assert_allclose(wider[0], (pose @ (-2.0, -2.0, 1.0))[:2] / (pose @ (-2.0, -2.0, 1.0))[2])


@pytest.mark.parametrize("pose", [POSE, TILTED, -POSE], ids=["affine", "tilted", "turned"])
def test_bounds_are_those_of_the_outline(pose):
    corners = outline(pose, (9, 27), 1.5)
    np.testing.assert_allclose(bounds(pose, (9, 27), 1.5), [*corners.min(axis=0), *corners.max(axis=0)])


@pytest.mark.parametrize("pose", [POSE, TILTED], ids=["affine", "tilted"])
def test_module_size_is_that_of_the_module_in_the_middle(pose):
    """The root of the area of a small square about the centre."""
    h = 0.05
    u, v, z = pose @ np.stack(
        [12.5 + h * np.array([-1, 1, 1, -1]), 12.5 + h * np.array([-1, -1, 1, 1]), np.ones(4)]
    )
    x, y = u / z, v / z
    area = 0.5 * abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    assert module_px(pose, SPACE.shape) == pytest.approx(np.sqrt(area) / (2 * h), rel=1e-4)


@pytest.mark.parametrize("margin", [0.0, 4.0])
@pytest.mark.parametrize("pose", [POSE, TILTED], ids=["affine", "tilted"])
def test_a_region_holds_the_code_and_its_quiet_zone(pose, margin):
    region = region_around(pose, SPACE, CONFIG, margin_px=margin)
    corners = outline(pose, SPACE.shape, quiet_modules(SPACE))
    far = np.array([region.x + region.width * region.cell, region.y + region.height * region.cell])
    assert (corners >= np.array([region.x, region.y]) + margin).all()
    assert (corners <= far - margin).all()
    assert region.cell == pytest.approx(module_px(pose, SPACE.shape) / CONFIG.cells_a_module)


@pytest.mark.parametrize("margin", [0.0, 4.0])
def test_regions_side_by_side_are_those_alone(margin):
    """To the bit, whatever the codes."""
    rng = np.random.default_rng(5)
    spaces = [SPACE, rmqr.space("R7x139"), qr.space(1)] * 20
    poses = np.array([POSE, TILTED] * 30) * rng.uniform(0.9, 1.1, (60, 3, 3))
    shape, quiet = np.array([s.shape for s in spaces]), np.array([quiet_modules(s) for s in spaces])
    together = regions_around(poses, shape, quiet, CONFIG, margin_px=margin)
    alone = [region_around(*each, CONFIG, margin_px=margin) for each in zip(poses, spaces, strict=True)]
    np.testing.assert_array_equal(together, alone)
    in_them = in_cells(together, poses)
    np.testing.assert_allclose(in_them[7], alone[7].from_px @ poses[7])
    np.testing.assert_allclose(in_px(together, in_them), poses / poses[:, 2:, 2:], rtol=1e-9)


def test_cells_count_from_the_centre_of_the_first():
    region = Region(10.0, 20.0, 2.5, 32, 48)
    np.testing.assert_allclose(region.from_px @ (11.25, 21.25, 1.0), [0.0, 0.0, 1.0])
    np.testing.assert_allclose(region.from_px @ (13.75, 26.25, 1.0), [1.0, 2.0, 1.0])


def shown(window, motion, region, workspace, *lags_px):
    """Images (N, height, width) of a window, one a pair of lags."""
    cells = deposit(window, motion, region, workspace=workspace)
    images = sharpen(cells, motion, region, list(lags_px or [(0.0, 0.0)]), workspace=workspace)
    return workspace.get(images.device).copy()


def test_events_land_where_the_map_says(workspace):
    region = Region(10.0, 20.0, 2.0, 32, 48)
    image = shown(window_with([40.0], [50.0], [0.0], [1.0]), AT_REST, region, workspace)[0]
    where, mass = centre_of(image)
    np.testing.assert_allclose(where, (region.from_px @ (40.0, 50.0, 1.0))[:2], atol=0.02)
    assert mass == pytest.approx(1.0, rel=1e-3)


def test_polarity_is_the_sign_of_an_event(workspace):
    region = Region(10.0, 20.0, 2.0, 32, 48)
    on, off, both = (
        shown(window_with([40.0] * len(p), [50.0] * len(p), [0.0] * len(p), p), AT_REST, region, workspace)
        for p in ([1.0], [-1.0], [1.0, -1.0])
    )
    np.testing.assert_allclose(off, -on, atol=1e-6)
    np.testing.assert_allclose(both, 0.0, atol=1e-6)


def test_moving_events_meet_at_the_middle_of_the_window(workspace):
    """An edge that passes (60, 50) at the middle, seen at five times: one place, five times the mass."""
    region, velocity = Region(10.0, 20.0, 2.0, 48, 64), np.array([10000.0, -5000.0])
    t = np.array([-4e-4, -2e-4, 0.0, 2e-4, 4e-4])
    moving = window_with(60.0 + velocity[0] * t, 50.0 + velocity[1] * t, t, np.ones(5))
    together = shown(moving, Motion(velocity), region, workspace)
    alone = shown(window_with([60.0], [50.0], [0.0], [1.0]), AT_REST, region, workspace)
    np.testing.assert_allclose(together, 5.0 * alone, atol=1e-3)


def test_an_image_starts_from_nothing_each_time(workspace):
    region, window = Region(10.0, 20.0, 2.0, 32, 48), window_with([40.0], [50.0], [0.0], [-1.0])
    first = shown(window, AT_REST, region, workspace)
    second = shown(window, AT_REST, region, workspace)
    np.testing.assert_array_equal(first, second)
    assert first.min() < -0.05


def test_an_image_for_each_pair_of_lags_and_linear_in_both(workspace):
    made = scene()
    motion = Motion(made.truth["truth"]["velocity"][0])
    pairs = ((0.0, 0.0), (1.0, 0.0), (0.0, 2.0), (0.5, 3.0))
    window, region = window_of(made), Region(90.0, 60.0, 2.3, 48, 64)
    plain, on, off, both = shown(window, motion, region, workspace, *pairs).astype(np.float64)
    most = np.abs(plain).max()
    assert np.abs(on - plain).max() > 0.1 * most
    assert np.abs(off - plain).max() > 0.1 * most
    np.testing.assert_allclose(both, plain + 0.5 * (on - plain) + 1.5 * (off - plain), atol=1e-4 * most)


@pytest.mark.parametrize("direction", [0.0, 70.0, 200.0])
def test_undoing_the_lag_moves_late_events_forward(direction, workspace):
    """Events a lag behind along the motion, 1 - exp(-s / lag) of them by s: their centre is put right."""
    heading = np.array([np.cos(np.deg2rad(direction)), np.sin(np.deg2rad(direction))])
    region, lag_px = Region(10.0, 20.0, 2.0, 64, 64), 1.5
    behind = -lag_px * np.log1p(-(np.arange(400) + 0.5) / 400)  # quantiles of the exponential
    x, y = np.array([70.0, 80.0])[:, None] - heading[:, None] * behind
    late = window_with(x, y, np.zeros(400), np.ones(400))
    plain, sharp = shown(late, Motion(1000.0 * heading), region, workspace, (0.0, 0.0), (lag_px, 0.0))
    true = (region.from_px @ (70.0, 80.0, 1.0))[:2]
    assert (true - centre_of(plain)[0]) @ heading == pytest.approx(lag_px / 2.0, abs=0.05)
    np.testing.assert_allclose(centre_of(sharp)[0], true, atol=0.05)
    # another polarity's lag does nothing to them
    other = shown(late, Motion(1000.0 * heading), region, workspace, (0.0, lag_px))[0]
    np.testing.assert_allclose(other, plain, atol=1e-5)


def test_far_events_change_nothing_inside(workspace):
    made = scene()
    motion = Motion(made.truth["truth"]["velocity"][0])
    window, region = window_of(made), Region(120.0, 90.0, 2.0, 32, 32)
    near = window.keep((np.abs(window.x - 152.0) < 40.0) & (np.abs(window.y - 122.0) < 40.0))
    assert len(near) < 0.5 * len(window)
    every, some = (shown(w, motion, region, workspace)[0] for w in (window, near))
    np.testing.assert_allclose(some, every, atol=1e-3)
    assert np.abs(every).max() > 1.0
