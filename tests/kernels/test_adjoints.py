"""Hand-written adjoints of rendering, residual and moments: by dot product and by central differences."""

import numpy as np
import pytest

from . import cases
from .helpers import assert_adjoint, assert_differences, filled


def test_render_in_the_grid(placed, dtype, rng):
    call, back = cases.render_affine(rng, dtype), cases.render_affine_adjoint(rng, dtype)
    call.inputs[2][:] = 0
    back.inputs[:3] = call.inputs
    adj_grid, _ = back.run(placed)
    assert_adjoint(call.run(placed)[0], back.inputs[3], call.inputs[0], adj_grid)


def test_render_in_the_affine_map(placed, rng):
    call, back = cases.render_affine(rng, np.float64), cases.render_affine_adjoint(rng, np.float64)
    back.inputs[:3] = call.inputs
    _, adj_affine = back.run(placed)
    grid, affine, outside = call.inputs

    def loss(affine):
        call.inputs = [grid, affine, outside]
        return np.vdot(call.run(placed)[0], back.inputs[3])

    # a parameter at a time; the offsets in the cases keep samples a thousandth off the lines of the grid
    directions = np.eye(6)[:, None, :] * np.ones((1, cases.B, 1)) * [1 / 30, 1 / 30, 1, 1 / 30, 1 / 30, 1]
    assert_differences(loss, affine, adj_affine, directions)


def test_render_of_a_singular_map(placed, spec, dtype, rng):
    """All pixels look at one line, or one place, of the grid: every node visits every pixel."""
    call, back = cases.render_affine(rng, dtype), cases.render_affine_adjoint(rng, dtype)
    call.inputs[1][:] = [[0.1, 0.2, 0.5, 0.1, 0.2, 0.5], [0, 0, 2.25, 0, 0, 3.5], [0, 0, 2, 0, 0, 3]]
    call.inputs[2][:] = 0
    back.inputs[:3] = call.inputs
    adj_grid, _ = back.run(placed)
    np.testing.assert_allclose(adj_grid, back.run(spec)[0], rtol=0, atol=1e-4)
    assert_adjoint(call.run(placed)[0], back.inputs[3], call.inputs[0], adj_grid)


def test_render_shows_the_nodes_and_what_is_outside(placed, dtype):
    grid = np.arange(6, dtype=dtype).reshape(1, 2, 3)
    affine = np.array([[1, 0, -1, 0, 1, -1]], dtype)
    (image,) = placed("render_affine", [grid, affine, np.array([9], dtype)], [filled((1, 4, 5), dtype)])
    np.testing.assert_array_equal(image[0], np.pad(grid[0], 1, constant_values=9))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_render_of_no_map(bad, placed, dtype, rng):
    call = cases.render_affine(rng, dtype)
    call.inputs[1][:] = bad
    (image,) = call.run(placed)
    np.testing.assert_array_equal(image, np.broadcast_to(call.inputs[2][:, None, None], image.shape))


def test_residual_in_the_luminance(placed, dtype, rng):
    call, back = cases.brightness_residual(rng, dtype), cases.brightness_residual_adjoint(rng, dtype)
    call.inputs[1][:] = 0
    back.inputs[:2] = [call.inputs[0], call.inputs[2]]
    adj_luminance, _ = back.run(placed)
    assert_adjoint(call.run(placed)[0], back.inputs[2], call.inputs[0], adj_luminance)


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (2, 1), (2, 2), (1, 7), (3, 3)])
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
