"""Gauss-Newton on poses: against the specification, and on a scene whose pose is known."""

import numpy as np
import pytest

import evqr_kernels

from .helpers import assert_close

CENTRE = SCALE = 6.0
GAIN = np.array([0.8, -0.5])
TRUE = np.array([[3.0, 0.4, 6.2], [-0.5, 2.8, 9.1], [0.001, -0.0005, 1.0]])
EXACT = {np.dtype(np.float32): 2e-3, np.dtype(np.float64): 1e-9}
"""Steps multiply rounding by the condition of the normal matrix, some hundreds."""


def model(points):
    """First and second derivatives of a few smooth blobs at (S, 2) code coordinates: u, v, uu, uv, vv."""
    rng = np.random.default_rng(4)
    total = np.zeros((5, len(points)))
    for place, height in zip(rng.uniform(1, 11, (12, 2)), rng.normal(size=12), strict=True):
        u, v = (points - place).T
        blob = height * np.exp(-0.5 * (u * u + v * v))
        total += blob * np.stack([-u, -v, u * u - 1, u * v, v * v - 1])
    return total


def scene(dtype, tilt):
    """Image of the model under the true pose, and the table and terms of an affine or a projective pose."""
    y, x = np.mgrid[:48, :52].astype(float)
    back = np.linalg.inv(TRUE) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    seen = model((back[:2] / back[2]).T)
    image = -(GAIN @ seen[:2]).reshape(1, *x.shape)

    axis = np.arange(0.25, 12, 0.5)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    l_u, l_v, *second = model(points)
    u, v = ((points - CENTRE) / SCALE).T
    weights = (np.ones_like(u), u, v, u * u, u * v, v * v)
    table = np.stack([along * weight for along in second for weight in weights] + [l_u, l_v], axis=1)
    rows = [[(w, 1), (6 + w, 2)] for w in range(3)] + [[(6 + w, 1), (12 + w, 2)] for w in range(3)]
    if tilt:
        rows += [[(3 + k, 1), (9 + k, 2), (10 + k, 1), (16 + k, 2)] for k in range(2)]
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


def align(backend, dtype, tilt, device="cpu", poses=None, **options):
    image, points, table, terms, factors = scene(dtype, tilt)
    poses = starts(dtype) if poses is None else poses
    return evqr_kernels.align_poses(
        image, np.zeros(len(poses), np.int32), poses, points, table, terms, factors,
        centre=CENTRE, scale=SCALE, backend=backend, device=device, **options,
    )  # fmt: skip


@pytest.mark.parametrize("tilt", [False, True])
@pytest.mark.parametrize("most", [0, 1, 3])
def test_equals_the_specification(tilt, most, placed, dtype):
    options = {"max_iterations": most, "tolerance": 0.0}
    poses, values = align(placed.backend.name, dtype, tilt, placed.device, **options)
    expected, expected_values = align("numpy", dtype, tilt, **options)
    np.testing.assert_array_equal(values[:, 4], most)
    assert_close(poses, expected, EXACT[np.dtype(dtype)])
    # the noise is a difference of sums that cancel
    assert_close(values[:, :3], expected_values[:, :3], EXACT[np.dtype(dtype)])
    np.testing.assert_allclose(values[:, 3], expected_values[:, 3], rtol=0, atol=EXACT[np.dtype(dtype)])


def test_finds_the_pose_and_the_gain(placed, dtype):
    """Bilinear sampling blurs the image a little: the pose is good to a hundredth of a module."""
    poses, values = align(placed.backend.name, dtype, True, placed.device, max_iterations=20, tolerance=1e-3)
    corners = np.array([[1, 1, 1], [11, 1, 1], [11, 11, 1], [1, 11, 1]]).T
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
