"""Gauss-Newton on poses: against the specification, and on a scene whose pose is known."""

import numpy as np
import pytest

import evqr_kernels

from .helpers import assert_close

SIDES = [(12, 12), (5, 16), (16, 5)]
"""Modules of the codes: rows and columns."""

GAIN = np.array([0.8, -0.5])
TRUE = np.array([[3.0, 0.4, 6.2], [-0.5, 2.8, 9.1], [0.001, -0.0005, 1.0]])
EXACT = {np.dtype(np.float32): 2e-3, np.dtype(np.float64): 1e-9}
"""Steps multiply rounding by the condition of the normal matrix, some hundreds."""


def centre_of(sides):
    """Centre of the code, and as much the scale of its coordinates, along u and v."""
    return sides[1] / 2, sides[0] / 2


def model(points, sides):
    """First and second derivatives of a few smooth blobs at (S, 2) code coordinates: u, v, uu, uv, vv."""
    rng = np.random.default_rng(4)
    total = np.zeros((5, len(points)))
    places = rng.uniform(1, np.subtract(sides[::-1], 1), (12, 2))
    for place, height in zip(places, rng.normal(size=12), strict=True):
        u, v = (points - place).T
        blob = height * np.exp(-0.5 * (u * u + v * v))
        total += blob * np.stack([-u, -v, u * u - 1, u * v, v * v - 1])
    return total


def scene(dtype, tilt, sides=SIDES[0]):
    """Image of the model under the true pose, and the table and terms of an affine or a projective pose."""
    y, x = np.mgrid[:64, :60].astype(float)
    back = np.linalg.inv(TRUE) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    seen = model((back[:2] / back[2]).T, sides)
    image = -(GAIN @ seen[:2]).reshape(1, *x.shape)

    axes = (np.arange(0.25, size, 0.5) for size in sides[::-1])
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    l_u, l_v, *second = model(points, sides)
    u, v = ((points - centre_of(sides)) / centre_of(sides)).T
    x, y = ((points - centre_of(sides)) / max(centre_of(sides))).T
    affine, along, across = [np.ones_like(u), u, v], [x * u, x * v], [y * u, y * v]
    weights = affine + along, affine + along + across, affine + across  # of L_uu, L_uv, L_vv
    columns = [f * weight for f, of_f in zip(second, weights, strict=True) for weight in of_f]
    table = np.stack([*columns, np.ones_like(u), l_u, l_v], axis=1)
    rows = [[(w, 1), (5 + w, 2)] for w in range(3)] + [[(5 + w, 1), (12 + w, 2)] for w in range(3)]
    if tilt:
        rows += [[(3 + k, 1), (8 + k, 2), (10 + k, 1), (15 + k, 2)] for k in range(2)]
    rows += [[(18, 3)], [(19, 3)]]
    padded = np.array([row + [(0, 0)] * (4 - len(row)) for row in rows], np.int32)
    terms, factors = (np.ascontiguousarray(padded[..., k]) for k in range(2))
    return [array.astype(dtype) for array in (image, points, table)] + [terms, factors]


def starts(dtype):
    """Poses a third of a module away, turned and scaled a little; the last is the true one."""
    steps = [
        [[1, 0.01, 0.3], [0, 1, -0.2], [0, 0, 1]],
        [[1.01, 0, -0.2], [-0.01, 1, 0.3], [0, 0, 1]],
        np.eye(3),
    ]
    poses = TRUE @ np.array(steps)
    return (poses / poses[:, 2:, 2:]).reshape(-1, 9).astype(dtype)


def align(backend, dtype, tilt, device="cpu", poses=None, sides=SIDES[0], **options):
    image, points, table, terms, factors = scene(dtype, tilt, sides)
    poses = starts(dtype) if poses is None else poses
    return evqr_kernels.align_poses(
        image, np.zeros(len(poses), np.int32), poses, points, table, terms, factors,
        centre=centre_of(sides), scale=centre_of(sides), backend=backend, device=device, **options,
    )  # fmt: skip


def test_poses_are_relative_to_their_part_of_an_image(placed, dtype, rng):
    """To the bit, wherever it lies, and whatever is around it."""
    image, *code = scene(dtype, True, SIDES[0])
    height, width = image.shape[1:]
    around = rng.normal(size=(3, 2 * height, width + 9)).astype(dtype)
    part = np.tile(np.array([[0, height, width]], np.int32), (3, 1))
    for k, top in enumerate((0, height // 2, height)):
        around[k, top : top + height, :width] = image[0]
        part[k, 0] = top
    # half of what they look at lies beside the image
    poses = starts(dtype) + np.array([0, 0, 0.5 * width, 0, 0, 0.5 * height, 0, 0, 0], dtype)
    options = {"centre": centre_of(SIDES[0]), "scale": centre_of(SIDES[0])}
    options |= {"backend": placed.backend.name, "device": placed.device, "max_iterations": 2}
    whose = np.arange(3, dtype=np.int32)
    found = evqr_kernels.align_poses(around, whose, poses, *code, image_part=part, **options)
    alone = evqr_kernels.align_poses(image, 0 * whose, poses, *code, **options)
    for one, other in zip(found, alone, strict=True):
        assert np.isfinite(one).all()
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("sides", SIDES, ids=str)
@pytest.mark.parametrize("tilt", [False, True])
@pytest.mark.parametrize("most", [0, 1, 3])
def test_equals_the_specification(tilt, most, sides, placed, dtype):
    options = {"max_iterations": most, "tolerance": 0.0, "sides": sides}
    poses, values = align(placed.backend.name, dtype, tilt, placed.device, **options)
    expected, expected_values = align("numpy", dtype, tilt, **options)
    np.testing.assert_array_equal(values[:, 4], most)
    assert_close(poses, expected, EXACT[np.dtype(dtype)])
    # the noise is a difference of sums that cancel
    assert_close(values[:, :3], expected_values[:, :3], EXACT[np.dtype(dtype)])
    np.testing.assert_allclose(values[:, 3], expected_values[:, 3], rtol=0, atol=EXACT[np.dtype(dtype)])


def together(backend, dtype, which, device="cpu", spare=3, **options):
    """Poses of two codes, ``which`` says of which each is, in one call; only that of the first may tilt."""
    scenes = [scene(dtype, True, sides) for sides in SIDES[:2]]
    image, points, table = (np.concatenate(arrays) for arrays in list(zip(*scenes, strict=True))[:3])
    first = len(scenes[0][1])
    # points that are nobody's, between the tables and behind them
    points = np.insert(points, [first] * spare + [len(points)] * spare, 1.0, axis=0)
    table = np.insert(table, [first] * spare + [len(table)] * spare, np.nan, axis=0)
    centres = [centre_of(sides) for sides in SIDES[:2]]
    which = np.array(which, np.int32)
    return evqr_kernels.align_poses(
        image, which, starts(dtype)[np.arange(len(which)) % 3], points, table, *scenes[0][3:],
        centre=centres, scale=centres, table_idx=which,
        table_ptr=np.array([[0, first], [first + spare, len(points) - spare]], np.int32),
        parameters=np.array([8, 6], np.int32), backend=backend, device=device, **options,
    )  # fmt: skip


def test_codes_side_by_side_equal_the_specification(placed, dtype):
    options = {"max_iterations": 2, "tolerance": 0.0}
    poses, values = together(placed.backend.name, dtype, [0, 1, 1, 0, 1], placed.device, **options)
    expected, expected_values = together("numpy", dtype, [0, 1, 1, 0, 1], **options)
    assert_close(poses, expected, EXACT[np.dtype(dtype)])
    assert_close(values[:, :3], expected_values[:, :3], EXACT[np.dtype(dtype)])


def test_codes_side_by_side_are_those_alone(placed, dtype):
    """To the bit; a table with six free parameters is as if terms for no more had been given."""
    options = {"max_iterations": 3, "tolerance": 0.0}
    poses, values = together(placed.backend.name, dtype, [0, 1, 1], placed.device, **options)
    for k, sides in enumerate((SIDES[0], SIDES[1], SIDES[1])):
        alone, of_alone = align(
            placed.backend.name, dtype, k == 0, placed.device, starts(dtype)[k : k + 1], sides, **options
        )
        np.testing.assert_array_equal(poses[k], alone[0])
        np.testing.assert_array_equal(values[k], of_alone[0])


@pytest.mark.parametrize("sides", SIDES, ids=str)
def test_finds_the_pose_and_the_gain(sides, placed, dtype):
    """Bilinear sampling blurs the image a little: the pose is good to a hundredth of a module."""
    options = {"max_iterations": 20, "tolerance": 1e-3, "sides": sides}
    poses, values = align(placed.backend.name, dtype, True, placed.device, **options)
    v, u = np.subtract(sides, 1)
    corners = np.array([[1, 1, 1], [u, 1, 1], [u, v, 1], [1, v, 1]]).T
    true = np.linalg.inv(TRUE)
    for pose in poses.reshape(-1, 3, 3).astype(float):
        back = true @ pose @ corners
        np.testing.assert_allclose(back[:2] / back[2], corners[:2], atol=0.03)
    np.testing.assert_allclose(values[:, :2], np.tile(GAIN, (3, 1)), rtol=0.05)
    assert (values[:, 2] > 0.995).all()
    assert (values[:, 4] < 20).all()


def test_no_iterations_scores_the_poses_as_they_are(placed, dtype):
    poses, values = align(placed.backend.name, dtype, False, placed.device, max_iterations=0)
    np.testing.assert_array_equal(poses, starts(dtype))
    assert values[2, 2] == values[:, 2].max() > 0.99


def test_a_pose_that_sees_nothing_stays_finite(placed, dtype):
    away = np.array([[1, 0, 1e4, 0, 1, 1e4, 0, 0, 1]], dtype)
    poses, values = align(placed.backend.name, dtype, True, placed.device, poses=away)
    assert np.isfinite(poses).all() and np.isfinite(values).all()
    assert values[0, 2] == 0
