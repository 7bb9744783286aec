"""Stage one: from a rough pose to the true one, and the gain that goes with it."""

from dataclasses import replace

import numpy as np
import pytest
from rectangles import TALL, WIDE
from scenes import moved, scene

from evqr.config import AlignConfig
from evqr.fit.align import align, coarse_levels, escape_side_minimum, fine_levels, shifted
from evqr.fit.model import profiles
from evqr.geometry import module_px, outline
from evqr.symbol import micro_qr
from evqr.workspace import Images

CONFIG = AlignConfig()

ALL_LEVELS = (*coarse_levels(CONFIG), *fine_levels(CONFIG))

TOLERANCE = 0.2
"""Modules.  From half a module on, a sample shows the neighbour; above a quarter, bits begin to be lost."""


def rough_poses(seen, count, seed=1, amount=1.0):
    """Poses that are wrong by up to 0.6 modules on each axis, 4 degrees and 8 % of scale, all at once."""
    rng = np.random.default_rng(seed)
    return np.stack(
        [
            seen.region.from_px
            @ moved(
                seen.pose,
                seen.size,
                shift=amount * rng.uniform(-0.6, 0.6, 2),
                turn_deg=amount * rng.uniform(-4.0, 4.0),
                scale=1.0 + amount * rng.uniform(-0.08, 0.08),
            )
            for _ in range(count)
        ]
    )


def angle_deg(a, b):
    """Angle from vector a to vector b [deg]."""
    return np.rad2deg(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))


# ---- convergence


@pytest.mark.parametrize(
    ("options", "amount", "share"),
    [
        ({"version": 1}, 1.0, 0.95),
        ({"version": 2}, 1.0, 0.85),
        ({"version": 2, "preset": "slow"}, 1.0, 0.85),
        ({"version": 2, "preset": "fast"}, 1.0, 0.85),
        # turn and scale move the corners of a larger code by more modules: its basin is smaller
        ({"version": 4, "module_px": 4.0}, 0.6, 0.95),
    ],
    ids=["1", "2", "2-slow", "2-fast", "4"],
)
def test_a_rough_pose_is_drawn_to_the_true_one(options, amount, share, workspace, see):
    seen = see(scene(**options))
    poses = rough_poses(seen, 40, amount=amount)
    found = align(seen.image, poses, seen.space, ALL_LEVELS, CONFIG, workspace=workspace)
    off = np.array([seen.modules_off(pose) for pose in found.pose])
    assert np.mean(off < TOLERANCE) >= share
    # what went astray says so
    right = off < TOLERANCE
    assert found.score[right].min() > 0.9
    assert (found.score[~right] < found.score[right].min() - 0.1).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"shift": (0.6, 0.0)},
        {"shift": (-0.4, 0.4)},
        {"turn_deg": 4.0},
        {"turn_deg": -4.0},
        {"scale": 1.08},
        {"scale": 0.92},
    ],
    ids=str,
)
def test_each_error_alone_is_removed(wrong, workspace, see):
    seen = see(scene())
    start = (seen.region.from_px @ moved(seen.pose, seen.size, **wrong))[None]
    found = align(seen.image, start, seen.space, ALL_LEVELS, CONFIG, workspace=workspace)
    assert seen.modules_off(found.pose[0]) < 0.1


def test_a_clean_scene_agrees_almost_perfectly(workspace, see):
    seen = see(scene())
    found = align(
        seen.image, seen.in_cells[None], seen.space, fine_levels(CONFIG), CONFIG, workspace=workspace
    )
    assert 0.95 < found.score[0] <= 1.0
    assert seen.modules_off(found.pose[0]) < 0.1


def test_events_without_a_code_do_not_agree(workspace, see):
    seen = see(scene())
    other = see(scene(seed=5, angle=95.0, text="not the same place", direction=35.0))
    found = align(other.image, rough_poses(seen, 20), seen.space, ALL_LEVELS, CONFIG, workspace=workspace)
    assert found.score.max() < CONFIG.min_score + 0.1


def test_noise_is_the_variance_that_the_model_leaves(workspace, see):
    """White noise on the image adds its own variance, as seen through the bilinear samples."""
    seen = see(scene())
    image = workspace.get(seen.image.device)
    quiet = align(
        seen.image, seen.in_cells[None], seen.space, fine_levels(CONFIG), CONFIG, workspace=workspace
    ).noise[0]
    added = np.random.default_rng(0).normal(0.0, 2.0, image.shape).astype(np.float32)
    noisy = Images(workspace.put(image + added))
    added = (
        align(noisy, seen.in_cells[None], seen.space, fine_levels(CONFIG), CONFIG, workspace=workspace).noise[
            0
        ]
        - quiet
    )
    # bilinear weights of uniform offsets keep (2/3)^2 of the variance
    assert added == pytest.approx(4.0 * 4 / 9, rel=0.25)


# ---- gain


@pytest.mark.parametrize("direction", [35.0, 160.0, 250.0])
def test_gain_points_along_the_motion_in_code_coordinates(direction, workspace, see):
    seen = see(scene(direction=direction))
    found = align(
        seen.image, seen.in_cells[None], seen.space, fine_levels(CONFIG), CONFIG, workspace=workspace
    )
    motion = np.linalg.solve(seen.pose[:2, :2], seen.motion.velocity)
    assert abs(angle_deg(motion, found.gain[0])) < 3.0


def test_the_gain_of_an_inverted_code_points_backwards(workspace, see):
    seen = see(scene(invert=True))
    found = align(
        seen.image, seen.in_cells[None], seen.space, fine_levels(CONFIG), CONFIG, workspace=workspace
    )
    motion = np.linalg.solve(seen.pose[:2, :2], seen.motion.velocity)
    assert abs(angle_deg(-motion, found.gain[0])) < 3.0
    assert found.score[0] > 0.95


def test_gain_follows_contrast_and_score_does_not(workspace, see):
    seen = see(scene())
    double = Images(workspace.put(2.0 * workspace.get(seen.image.device)))
    one, two = (
        align(image, seen.in_cells[None], seen.space, fine_levels(CONFIG), CONFIG, workspace=workspace)
        for image in (seen.image, double)
    )
    np.testing.assert_allclose(two.gain, 2.0 * one.gain, rtol=1e-4)
    np.testing.assert_allclose(two.score, one.score, rtol=1e-4)
    np.testing.assert_allclose(two.pose, one.pose, atol=1e-3)
    np.testing.assert_allclose(two.noise, 4.0 * one.noise, rtol=1e-3)


# ---- batches


def test_a_batch_is_its_hypotheses_one_by_one(workspace, see):
    seen = see(scene())
    poses = rough_poses(seen, 7)
    batch = align(seen.image, poses, seen.space, ALL_LEVELS, CONFIG, workspace=workspace)
    for k in range(len(poses)):
        alone = align(seen.image, poses[k : k + 1], seen.space, ALL_LEVELS, CONFIG, workspace=workspace)
        np.testing.assert_allclose(batch.pose[k], alone.pose[0], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(batch.gain[k], alone.gain[0], rtol=1e-5, atol=1e-6)
        assert batch.score[k] == pytest.approx(alone.score[0], abs=1e-6)
        assert alone.iterations == batch.iterations[k]


def test_each_hypothesis_looks_at_its_own_image(workspace, see):
    seen = see(scene())
    image = workspace.get(seen.image.device)
    stack = Images(workspace.put(np.concatenate([np.zeros_like(image), image, -3.0 * image])))
    poses = np.stack([seen.in_cells] * 3)
    idx = np.array([1, 2, 0], np.int32)
    found = align(stack, poses, seen.space, fine_levels(CONFIG), CONFIG, workspace=workspace, image_idx=idx)
    np.testing.assert_allclose(found.gain[1], -3.0 * found.gain[0], rtol=1e-3)
    assert found.score[0] == pytest.approx(found.score[1], abs=1e-4)
    assert found.score[2] == pytest.approx(0.0, abs=1e-6)


def test_the_poses_given_are_not_changed(workspace, see):
    seen = see(scene())
    poses = rough_poses(seen, 3)
    before = poses.copy()
    align(seen.image, poses, seen.space, ALL_LEVELS, CONFIG, workspace=workspace)
    np.testing.assert_array_equal(poses, before)


# ---- one module off


def test_the_neighbours_of_a_pose_are_one_module_away(see):
    seen = see(scene())
    (around,) = shifted(seen.in_cells[None])
    np.testing.assert_array_equal(around[4], seen.in_cells)
    steps = np.linalg.inv(seen.in_cells) @ around
    moves = {tuple(np.rint(step[:2, 2]).astype(int)) for step in steps}
    assert moves == {(u, v) for u in (-1, 0, 1) for v in (-1, 0, 1)}
    np.testing.assert_allclose(steps[:, :2, 2], np.rint(steps[:, :2, 2]), atol=1e-9)


@pytest.mark.parametrize("step", [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1)])
@pytest.mark.parametrize("version", [2, 4])
def test_a_pose_one_module_off_is_repaired(step, version, workspace, see):
    seen = see(scene(version=version, module_px=4.0, preset="fast"))
    start = seen.region.from_px @ moved(seen.pose, seen.size, shift=step)
    refined = align(seen.image, start[None], seen.space, fine_levels(CONFIG), CONFIG, workspace=workspace)
    found, escaped = escape_side_minimum(seen.image, refined, [seen.space], CONFIG, workspace=workspace)
    assert escaped.tolist() == [found is not refined]
    assert seen.modules_off(found.pose[0]) < 0.3  # lags are not undone here: 0.06 modules a px/ms
    assert len(found.pose) == len(found.score) == 1


def test_scores_of_poses_as_they_are(workspace, see):
    seen = see(scene())
    poses = np.stack([seen.in_cells, seen.region.from_px @ moved(seen.pose, seen.size, shift=(1.0, 0.0))])
    found = align(
        seen.image, poses, seen.space, fine_levels(CONFIG), CONFIG, workspace=workspace, max_iterations=0
    )
    np.testing.assert_allclose(found.pose, poses, rtol=1e-6)
    assert (found.iterations == 0).all()
    assert found.score[0] > 0.95
    assert found.score[1] < 0.7


# ---- tilt


@pytest.mark.parametrize("tilt", [10.0, 25.0])
def test_perspective_is_found_from_an_affine_start(tilt, workspace, see):
    seen = see(scene(tilt=tilt, module_px=6.0))
    pose, half = seen.pose, seen.size / 2.0
    x, y, z = pose @ (half, half, 1.0)
    linear = (pose[:2, :2] - np.outer((x / z, y / z), pose[2, :2])) / z
    flat = np.eye(3)
    flat[:2, :2] = linear
    flat[:2, 2] = (x / z, y / z) - linear @ (half, half)
    start = (seen.region.from_px @ flat)[None]
    found = align(seen.image, start, seen.space, ALL_LEVELS, CONFIG, workspace=workspace)
    assert seen.modules_off(found.pose[0]) < 0.1
    affine = (*coarse_levels(CONFIG), replace(fine_levels(CONFIG)[0], tilt=False))
    without = align(seen.image, start, seen.space, affine, CONFIG, workspace=workspace)
    np.testing.assert_allclose(without.pose[0, 2], [0.0, 0.0, 1.0])
    assert seen.modules_off(without.pose[0]) > seen.modules_off(found.pose[0])
    assert found.score[0] >= without.score[0]


# ---- codes that are no square


@pytest.mark.parametrize("space", [micro_qr.space("M3"), WIDE, TALL], ids=str)
def test_poses_of_any_shape_are_found(space, workspace):
    """From an image that is the model itself, seen through a pose that turns and tilts."""
    sigma, gain = CONFIG.sigma, np.array([0.8, -0.5])
    pose = np.array([[2.6, -0.9, 40.0], [1.1, 2.3, 20.0], [1.5e-3, -1e-3, 1.0]])
    y, x = np.mgrid[:100, :120]
    u, v, z = np.linalg.inv(pose) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    b_u, slope_u, _ = profiles((u / z)[:, None] - np.arange(space.columns), sigma)
    b_v, slope_v, _ = profiles((v / z)[:, None] - np.arange(space.rows), sigma)
    above_light = np.where(space.known, space.values - 1.0, 0.0)
    along_u = np.einsum("ni,ij,nj->n", b_v, above_light, slope_u)
    along_v = np.einsum("ni,ij,nj->n", slope_v, above_light, b_u)
    seen = -(gain[0] * along_u + gain[1] * along_v).reshape(1, *x.shape)
    image = Images(workspace.put(seen.astype(np.float32)))
    rough = pose @ np.array([[1.02, -0.02, 0.3], [0.02, 0.98, -0.25], [0.0, 0.0, 1.0]])
    found = align(image, rough[None], space, ALL_LEVELS, CONFIG, workspace=workspace)
    off = np.abs(outline(found.pose[0], space.shape) - outline(pose, space.shape)).max()
    assert off < 0.1 * module_px(pose, space.shape)
    assert found.score[0] > 0.97
    np.testing.assert_allclose(found.gain[0], gain, rtol=0.15)  # looking between cells blurs
