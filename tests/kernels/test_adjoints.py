"""Hand-written adjoints of rendering, residual, cost, moments: by dot product, by central differences."""

import math

import numpy as np
import pytest

from . import cases
from .helpers import assert_adjoint, assert_close, assert_differences, filled

SMALL_IMAGES = [(1, 1), (1, 2), (2, 1), (2, 2), (1, 7), (3, 3), (2, 17), (3, 18), (3, 40), (2, 75)]

every_render = pytest.mark.parametrize("parameters", [6, 8])
every_profile = pytest.mark.parametrize("sigma", [0.0, 0.05, 0.25, 0.9])


@every_render
@every_profile
def test_render_in_the_grid(parameters, sigma, placed, dtype, rng):
    call = cases.render_code(rng, dtype, parameters, sigma)
    back = cases.render_code_adjoint(rng, dtype, parameters, sigma)
    call.inputs[2][:] = 0
    back.inputs[:3] = call.inputs[:3]
    adj_grid, _ = back.run(placed)
    assert_adjoint(call.run(placed)[0], back.inputs[4], call.inputs[0], adj_grid)


@every_render
@every_profile
def test_render_in_the_map(parameters, sigma, placed, rng):
    call = cases.render_code(rng, np.float64, parameters, sigma)
    back = cases.render_code_adjoint(rng, np.float64, parameters, sigma)
    to_grid = call.inputs[1]
    # far from where the map is behind: there the image is as steep as one likes
    to_grid[0, 6:] *= 0.2
    back.inputs[:3] = call.inputs[:3]
    _, adj_map = back.run(placed)

    def loss(to_grid):
        call.inputs[1] = to_grid
        return np.vdot(call.run(placed)[0], back.inputs[4])

    # a parameter at a time; the offsets in the cases keep samples a thousandth off the lines of the grid
    units = np.array([1 / 30, 1 / 30, 1, 1 / 30, 1 / 30, 1, 1 / 300, 1 / 300])[:parameters]
    directions = np.eye(parameters)[:, None, :] * np.ones((1, cases.B, 1)) * units
    assert_differences(loss, to_grid, adj_map, directions)


@every_profile
def test_render_of_a_singular_map(sigma, placed, spec, dtype, rng):
    """All pixels look at one line, or one place, of the grid: every node visits every pixel."""
    call, back = cases.render_code(rng, dtype, 6, sigma), cases.render_code_adjoint(rng, dtype, 6, sigma)
    call.inputs[1][:] = [[0.1, 0.2, 0.5, 0.1, 0.2, 0.5], [0, 0, 2.25, 0, 0, 3.5], [0, 0, 2, 0, 0, 3]]
    call.inputs[2][:] = 0
    back.inputs[:3] = call.inputs[:3]
    adj_grid, _ = back.run(placed)
    np.testing.assert_allclose(adj_grid, back.run(spec)[0], rtol=0, atol=2e-4)
    assert_adjoint(call.run(placed)[0], back.inputs[4], call.inputs[0], adj_grid)


def test_render_shows_the_nodes_and_what_is_outside(placed, dtype):
    grid = np.arange(6, dtype=dtype).reshape(1, 2, 3)
    to_grid = np.array([[1, 0, -1, 0, 1, -1]], dtype)
    for sigma in (0.0, 0.05):
        (image,) = placed(
            "render_code", [grid, to_grid, np.array([9], dtype), sigma], [filled((1, 4, 5), dtype)]
        )
        np.testing.assert_array_equal(image[0], np.pad(grid[0], 1, constant_values=9))


def test_render_blurs_boxes(placed, dtype):
    """A module of side 8 px: the normal distribution at its edges, half at the edge itself."""
    sigma = 0.25
    to_grid = np.array([[0.125, 0, -2, 0, 0.125, -2]], dtype)
    inputs = [np.ones((1, 1, 1), dtype), to_grid, np.zeros(1, dtype), sigma]
    (image,) = placed("render_code", inputs, [filled((1, 33, 33), dtype)])
    s = np.arange(33) / 8 - 2

    def edge(s):
        return np.array([0.5 + 0.5 * math.erf(value / sigma / math.sqrt(2)) for value in s])

    profile = edge(s + 0.5) - edge(s - 0.5)
    np.testing.assert_allclose(image[0], np.outer(profile, profile), rtol=0, atol=3e-7)
    assert abs(image[0, 16, 20] / image[0, 16, 16] - 0.5 / (2 * edge([0.5])[0] - 1)) < 1e-4


@every_profile
def test_a_homography_is_the_affine_map_it_extends(sigma, placed, dtype, rng):
    call = cases.render_code(rng, dtype, 6, sigma)
    expected = call.run(placed)
    call.inputs[1] = np.hstack([call.inputs[1], np.zeros((cases.B, 2), dtype)])
    assert_close(*call.run(placed), *expected)


@every_profile
def test_render_behind_the_map_is_outside(sigma, placed, dtype, rng):
    call = cases.render_code(rng, dtype, 8, sigma)
    call.inputs[1][:, 6:] = [-1, 0]
    (image,) = call.run(placed)
    np.testing.assert_array_equal(
        image[:, :, 1:], np.broadcast_to(call.inputs[2][:, None, None], (3, 23, 30))
    )


@every_render
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_render_of_no_map(bad, parameters, placed, dtype, rng):
    for sigma in (0.0, 0.25):
        call = cases.render_code(rng, dtype, parameters, sigma)
        call.inputs[1][:] = bad
        (image,) = call.run(placed)
        np.testing.assert_array_equal(image, np.broadcast_to(call.inputs[2][:, None, None], image.shape))


def test_residual_in_the_luminance(placed, dtype, rng):
    call, back = cases.brightness_residual(rng, dtype), cases.brightness_residual_adjoint(rng, dtype)
    call.inputs[1][:] = 0
    back.inputs[:2] = [call.inputs[0], call.inputs[2]]
    adj_luminance, _ = back.run(placed)
    assert_adjoint(call.run(placed)[0], back.inputs[2], call.inputs[0], adj_luminance)


@pytest.mark.parametrize("shape", SMALL_IMAGES)
def test_residual_of_small_images(shape, placed, dtype, rng):
    luminance, adj = rng.normal(size=(2, 1, *shape)).astype(dtype)
    motion = np.array([[0.7, -1.3]], dtype)
    (residual,) = placed(
        "brightness_residual", [luminance, np.zeros_like(luminance), motion], [filled(adj.shape, dtype)]
    )
    outputs = [filled((1, shape[0], 2), dtype), filled(adj.shape, dtype), filled((1, 2), dtype)]
    _, adj_luminance, _ = placed("brightness_residual_adjoint", [luminance, motion, adj], outputs)
    if shape == (1, 1):
        assert residual == 0
        assert adj_luminance == 0
    else:
        assert_adjoint(residual, adj, luminance, adj_luminance)


def test_residual_in_the_motion(placed, rng):
    call, back = (
        cases.brightness_residual(rng, np.float64),
        cases.brightness_residual_adjoint(rng, np.float64),
    )
    luminance, events_image, motion = call.inputs
    back.inputs[:2] = [luminance, motion]
    _, adj_motion = back.run(placed)

    def loss(motion):
        call.inputs = [luminance, events_image, motion]
        return np.vdot(call.run(placed)[0], back.inputs[2])

    assert_differences(loss, motion, adj_motion, rng.normal(size=(3, cases.B, 2)))


@pytest.mark.parametrize("shape", SMALL_IMAGES)
def test_cost_is_that_of_the_residual(shape, placed, dtype, rng):
    """And its adjoint that of the residual, for the residual times its weight."""
    luminance, events_image = rng.normal(size=(2, 2, *shape)).astype(dtype)
    mask = rng.uniform(0, 2, (2, *shape)).astype(dtype)
    motion, adj_cost = rng.normal(size=(2, 2)).astype(dtype), np.array([1.5, -0.5], dtype)
    given = [luminance, events_image, motion]
    image, rows = filled((2, *shape), dtype), filled((2, shape[0], 2), dtype)
    (residual,) = placed("brightness_residual", given, [image])
    _, cost = placed("brightness_cost", [*given, mask], [filled((2, shape[0]), dtype), filled(2, dtype)])
    assert_close(cost, 0.5 * (mask * residual * residual).sum(axis=(1, 2)))

    adj = adj_cost[:, None, None] * mask * residual
    _, *expected = placed("brightness_residual_adjoint", [luminance, motion, adj], [rows, image, motion])
    _, adj_luminance, adj_events, adj_motion = placed(
        "brightness_cost_adjoint", [*given, mask, adj_cost], [rows, image, image, filled((2, 2), dtype)]
    )
    assert_close(adj_events, adj)
    if shape != (1, 1):
        assert_close(adj_luminance, expected[0])
        assert_close(adj_motion, expected[1])


def test_cost_ignores_what_the_mask_leaves_out(placed, dtype, rng):
    call, back = cases.brightness_cost(rng, dtype), cases.brightness_cost_adjoint(rng, dtype)
    call.inputs[3][:, :, 9:] = 0
    back.inputs[:4] = call.inputs
    before, (_, adj_events, _) = call.run(placed), back.run(placed)
    np.testing.assert_array_equal(adj_events[:, :, 9:], 0)
    for image in call.inputs[:2]:
        image[:, :, 10:] = 1e3  # column 9 is in the slopes of column 8
    np.testing.assert_array_equal(call.run(placed), before)


def test_cost_by_dot_product(placed, dtype, rng):
    call, back = cases.brightness_cost(rng, dtype), cases.brightness_cost_adjoint(rng, dtype)
    back.inputs[:4] = call.inputs
    (cost,) = call.run(placed)
    adj_luminance, adj_events, _ = back.run(placed)
    # in luminance and events together the cost is a square: its derivative along them is twice itself
    luminance, events_image = (array.astype(float) for array in call.inputs[:2])
    along = np.vdot(luminance, adj_luminance) + np.vdot(events_image, adj_events)
    size = np.abs(back.inputs[4] * cost).sum()
    assert (
        abs(along - 2 * np.vdot(back.inputs[4], cost.astype(float)))
        <= {4: 1e-5, 8: 1e-12}[cost.itemsize] * size
    )


@pytest.mark.parametrize("name", ["luminance", "events_image", "motion"])
def test_cost_by_differences(name, placed, rng):
    call, back = cases.brightness_cost(rng, np.float64), cases.brightness_cost_adjoint(rng, np.float64)
    back.inputs[:4] = call.inputs
    place = ["luminance", "events_image", "motion"].index(name)
    before = call.inputs[place]
    gradient = back.run(placed)[place]

    def loss(value):
        call.inputs[place] = value
        return np.vdot(call.run(placed)[0], back.inputs[4])

    assert_differences(loss, before, gradient, rng.normal(size=(3, *before.shape)))


def test_residual_of_a_ramp_is_its_slope(placed, dtype):
    y, x = np.meshgrid(np.arange(6.0), np.arange(9.0), indexing="ij")
    luminance = (2 * x - 3 * y)[None].astype(dtype)
    motion = np.array([[5, 7]], dtype)
    (residual,) = placed(
        "brightness_residual", [luminance, np.ones_like(luminance), motion], [filled((1, 6, 9), dtype)]
    )
    np.testing.assert_array_equal(residual[:, 1:-1, 1:-1], 2 * 5 - 3 * 7 + 1)
    # half the slope along an axis at its border, where the border's own pixel stands in
    np.testing.assert_array_equal(residual[0, 2, 0], 5 - 3 * 7 + 1)


def test_moments_in_the_image(placed, dtype, rng):
    """Linear but for the last moment, the energy."""
    call, back = cases.sample_moments(rng, dtype), cases.sample_moments_adjoint(rng, dtype)
    back.inputs[:6] = call.inputs
    back.inputs[6][:, -1] = 0
    back.outputs[0][:] = 0
    (moments,), (adj_image,) = call.run(placed), back.run(placed)
    moments[:, -1] = 0
    assert_adjoint(moments, back.inputs[6], call.inputs[0], adj_image)


def test_energy_in_the_image(placed, rng):
    call, back = cases.sample_moments(rng, np.float64), cases.sample_moments_adjoint(rng, np.float64)
    image, *others = call.inputs
    back.inputs[:6] = call.inputs
    back.outputs[0][:] = 0
    (adj_image,) = back.run(placed)

    def loss(image):
        call.inputs = [image, *others]
        return np.vdot(call.run(placed)[0], back.inputs[6])

    assert_differences(loss, image, adj_image, rng.normal(size=(3, *image.shape)))
