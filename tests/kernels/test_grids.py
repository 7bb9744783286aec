"""Grids of time, last times and counts: what they are of, and the adjoint by dot product and differences."""

import numpy as np
import pytest

import evqr_kernels

from . import cases
from .helpers import assert_adjoint, assert_differences, filled


def test_a_plane_gets_its_own_events_and_half_of_those_between(placed, dtype):
    t = np.array([-1, -0.5, -0.25, 0, 1, 1.001, np.nan], dtype)
    x, y, weight = np.full(7, 2, dtype), np.full(7, 1, dtype), np.array([1, 2, 4, 8, 16, 32, 64], dtype)
    inputs = [x, y, t, weight, np.array([0, 7], np.int32), np.array([[-1, 1]], dtype)]
    (grid,) = placed("voxel_grid", inputs, [filled((1, 5, 3, 4), dtype, 0)])
    np.testing.assert_array_equal(grid[0, :, 1, 2], [1, 2 + 2, 2 + 8, 0, 16])
    assert grid.sum() == 31


@pytest.mark.parametrize("planes", [1, 2, 5])
def test_voxel_grid_in_the_weight(planes, placed, dtype, rng):
    call, back = cases.voxel_grid(rng, dtype, planes), cases.voxel_grid_adjoint(rng, dtype, planes)
    call.outputs[0][:] = 0
    back.inputs[:6] = call.inputs
    adj_weight, _ = back.run(placed)
    assert_adjoint(call.run(placed)[0], back.inputs[6], call.inputs[3], adj_weight)


def test_voxel_grid_in_time(placed, rng):
    """Events are a hundredth of a plane off the next, so that none passes one."""
    call, back = cases.voxel_grid(rng, np.float64), cases.voxel_grid_adjoint(rng, np.float64)
    span = call.inputs[5] = np.array([[-1.0, 1.0], [0.0, 1.0], [-0.5, 1.5]])
    first, last = np.repeat(span, np.diff(call.inputs[4]), axis=0).T
    place = rng.integers(0, 4, len(first)) + rng.uniform(0.01, 0.99, len(first))
    t = call.inputs[2] = first + place / 4 * (last - first)
    back.inputs[:6] = call.inputs
    _, adj_t = back.run(placed)

    def loss(t):
        call.inputs[2] = t
        return np.vdot(call.run(placed)[0], back.inputs[6])

    assert_differences(loss, t, adj_t, rng.normal(size=(3, len(t))))


def test_the_last_time_counts_whatever_the_order(placed, dtype):
    t = np.array([3, 5, 4, -2, np.nan, 9], dtype)
    x, y = np.array([1, 1, 1, 1, 1, 7], dtype), np.zeros(6, dtype)
    weight = np.array([1, 1, 1, -1, 1, 1], dtype)
    inputs = [x, y, t, weight, np.array([0, 6], np.int32)]
    (surface,) = placed("time_surface", [*inputs, 0.0], [filled((1, 2, 2, 3), dtype)])
    expected = np.full((1, 2, 2, 3), -np.inf)
    expected[0, :, 0, 1] = 5, -2
    np.testing.assert_array_equal(surface, expected)
    (decayed,) = placed("time_surface", [*inputs, 2.0], [filled((1, 2, 2, 3), dtype)])
    np.testing.assert_allclose(decayed, np.exp(expected / 2), rtol=1e-6)


def test_counts_are_exact_beyond_float32(placed, dtype):
    inputs = [np.zeros(3, dtype), np.zeros(3, dtype), np.array([1, -1, 1], dtype), np.array([0, 3], np.int32)]
    (counts,) = placed("event_histogram", inputs, [np.full((1, 2, 1, 1), 2**24, np.int32)])
    np.testing.assert_array_equal(counts[0, :, 0, 0], [2**24 + 2, 2**24 + 1])


def test_counts_are_those_of_bins(rng):
    call = cases.event_histogram(rng, np.float32)
    x, y, weight, window_ptr = call.inputs
    counts = evqr_kernels.event_histogram(x, y, weight, window_ptr, shape=(23, 31))
    for image, sign in ((0, weight > 0), (1, weight < 0)):
        binned = evqr_kernels.bin_events(x, y, sign.astype(np.float32), window_ptr, shape=(23, 31))
        np.testing.assert_array_equal(counts[:, image], binned)
