"""Poses: maps one after the other, the way back, and the outline."""

import numpy as np
import pytest

from evqr.geometry import bounds, compose, inverse, outline

RNG = np.random.default_rng(0)
MAPS = np.eye(3) + RNG.uniform(-0.4, 0.4, (6, 3, 3))


def test_compose_is_the_product_of_two_maps_or_of_stacks_of_them():
    np.testing.assert_allclose(compose(MAPS[0], MAPS[1]), MAPS[0] @ MAPS[1], rtol=1e-14)
    np.testing.assert_allclose(compose(MAPS[0], MAPS), MAPS[0] @ MAPS, rtol=1e-13)
    np.testing.assert_allclose(compose(MAPS, MAPS[0]), MAPS @ MAPS[0], rtol=1e-13)
    np.testing.assert_allclose(compose(MAPS, MAPS[::-1]), MAPS @ MAPS[::-1], rtol=1e-13)


@pytest.mark.parametrize("k", range(len(MAPS)))
def test_inverse_leads_back(k):
    np.testing.assert_allclose(compose(inverse(MAPS[k]), MAPS[k]), np.eye(3), atol=1e-13)
    np.testing.assert_allclose(inverse(MAPS[k]), np.linalg.inv(MAPS[k]), rtol=1e-10)


def test_what_has_no_inverse_says_so():
    with pytest.raises(ZeroDivisionError):
        inverse(np.zeros((3, 3)))


def test_outline_goes_around_the_code_and_its_margin_and_bounds_hold_it():
    pose = MAPS[2] * [4.0, 4.0, 1.0] + [[0.0, 0.0, 30.0], [0.0, 0.0, 20.0], [0.0, 0.0, 9.0]]
    corners = outline(pose, (3, 7), margin=2.0)
    for corner, (u, v) in zip(corners, ((-2, -2), (9, -2), (9, 5), (-2, 5)), strict=True):
        x, y, z = pose @ (u, v, 1.0)
        np.testing.assert_allclose(corner, (x / z, y / z), rtol=1e-12)
    left, top, right, bottom = bounds(pose, (3, 7), margin=2.0)
    assert (left, top) == tuple(corners.min(axis=0)) and (right, bottom) == tuple(corners.max(axis=0))
