"""Hand-written adjoints of deposits and of the lag operator, by dot product, and their edges."""

import numpy as np
import pytest

from . import cases
from .helpers import assert_adjoint, assert_close, assert_differences, filled


def test_deposit_in_the_weights(placed, dtype, rng):
    """Linear in the weights while their signs stay; events off the image and at no place add nothing."""
    call, back = cases.deposit_events(rng, dtype), cases.deposit_events_adjoint(rng, dtype)
    call.inputs[0][7] = np.nan
    call.outputs[0][:] = 0
    back.inputs[:7] = call.inputs
    (deposit,), (adj_weight, _, *adj_positions) = call.run(placed), back.run(placed)
    assert_adjoint(deposit, back.inputs[7], call.inputs[3], adj_weight)
    assert adj_weight[7] == adj_positions[0][7] == adj_positions[1][7] == 0


@pytest.mark.parametrize("axis", [0, 1])
def test_deposit_in_the_positions(axis, placed, rng):
    """By differences; no event within a thousandth of a cell of the next, where the slope jumps."""
    call, back = cases.deposit_events(rng, np.float64), cases.deposit_events_adjoint(rng, np.float64)
    x, y, t, _, ptr, motion, frame = call.inputs
    window = np.repeat(np.arange(cases.B), np.diff(ptr))
    origin, scale = frame[window, axis], frame[window, 2]
    places = (x, y)[axis]
    at = (places - t * motion[window, axis] - origin + 0.5) / scale - 0.5
    places += scale * (np.floor(at) + 0.002 + 0.996 * (at % 1) - at)
    back.inputs[:7] = call.inputs
    gradient = back.run(placed)[2 + axis]

    def loss(places):
        call.inputs[axis] = places
        return np.vdot(call.run(placed)[0], back.inputs[7])

    assert_differences(loss, places.copy(), gradient, rng.normal(size=(3, len(x))))


def test_deposit_in_the_motion(placed, rng):
    """By differences; no event is so near to a cell's line that it crosses it."""
    call, back = cases.deposit_events(rng, np.float64), cases.deposit_events_adjoint(rng, np.float64)
    x, y, t, _, ptr, motion, frame = call.inputs
    t *= 1e3  # that a step is no tiny part of a pixel
    motion *= 1e-3
    window = np.repeat(np.arange(cases.B), np.diff(ptr))
    scale = frame[window, 2]
    for axis, places in enumerate((x, y)):
        at = (places - t * motion[window, axis] - frame[window, axis] + 0.5) / scale - 0.5
        places += scale * (np.floor(at) + 0.002 + 0.996 * (at % 1) - at)
    back.inputs[:7] = call.inputs

    def loss(motion):
        call.inputs[5] = motion
        return np.vdot(call.run(placed)[0], back.inputs[7])

    assert_differences(loss, motion.copy(), back.run(placed)[1], rng.normal(size=(3, cases.B, 2)))


def test_deposit_in_one_weight_reads_its_own_image(placed, dtype):
    """The derivative is the image of the event's sign, read between its cells."""
    place, none = np.full(2, 2.25, dtype), np.zeros(2, dtype)
    adj = np.zeros((1, 2, 6, 6), dtype)
    adj[0, 0] = np.arange(6)
    adj[0, 1] = -10 * np.arange(6)[:, None]
    inputs = [place, place + 1, none, np.array([2, -3], dtype), np.array([0, 2], np.int32)]
    inputs += [np.zeros((1, 2), dtype), np.array([[0, 0, 1]], dtype), adj]
    shapes = [(1, 1, 2), 2, (1, 2), 2, 2]
    outputs = [filled(shape, dtype) for shape in shapes]
    _, adj_weight, adj_motion, adj_x, adj_y = placed("deposit_events_adjoint", inputs, outputs)
    np.testing.assert_array_equal(adj_motion, 0)
    np.testing.assert_allclose(adj_weight, [2.25, -32.5], rtol=1e-6)
    np.testing.assert_allclose([adj_x, adj_y], [[2, 0], [0, 30]], atol=1e-4)


@pytest.mark.parametrize("bad", [-1e9, 1e9, np.nan, np.inf])
def test_weights_of_events_off_the_image(bad, placed, dtype, rng):
    back = cases.deposit_events_adjoint(rng, dtype)
    back.inputs[1][:] = bad
    for adjoint in back.run(placed):
        np.testing.assert_array_equal(adjoint, 0)


def test_weights_of_no_events(placed, dtype, rng):
    back = cases.deposit_events_adjoint(rng, dtype)
    back.inputs[:5] = [*(column[:0] for column in back.inputs[:4]), np.zeros(cases.B + 1, np.int32)]
    shapes = [(cases.B, 1, 2), 0, (cases.B, 2), 0, 0]
    back.outputs = [filled(shape, dtype) for shape in shapes]
    assert back.run(placed)[0].shape == (0,)


@pytest.mark.parametrize("width", [5, 8, 20, 21, 36, 37])
@pytest.mark.parametrize("height", [5, 6, 23])
def test_operator_in_the_deposit(height, width, placed, dtype, rng):
    """Taps without symmetry, two images of one deposit, one deposit of no image; the border counts too."""
    call, back = cases.lag_operator(rng, dtype), cases.lag_operator_adjoint(rng, dtype)
    call.inputs[0] = rng.normal(size=(cases.B, 2, height, width)).astype(dtype)
    call.inputs[-1] = np.array([[height, width], [max(height - 4, 0), 5], [height, width - 1]], np.int32)
    call.outputs = [filled((3, 2, height, width), dtype), filled((3, height, width), dtype)]
    adj_image = rng.normal(size=(3, height, width)).astype(dtype)
    back.inputs = [*call.inputs[1:], adj_image]
    back.outputs = [filled((3, 2, height, width), dtype), filled((cases.B, 2, height, width), dtype)]
    (image,), (adj_deposit,) = call.run(placed), back.run(placed)
    assert_adjoint(image, adj_image, call.inputs[0], adj_deposit)
    np.testing.assert_array_equal(adj_deposit[1], 0)


def test_images_narrower_than_a_block(placed, spec, dtype, rng):
    back = cases.lag_operator_adjoint(rng, dtype)
    back.inputs[-2] = np.array([[cases.Y, 9], [6, 8], [7, 4]], np.int32)
    back.inputs[-1] = back.inputs[-1][:, :, :9].copy()
    back.outputs = [output[..., :9].copy() for output in back.outputs]
    assert_close(back.run(placed)[0], back.run(spec)[0])


@pytest.mark.parametrize("height", [1, 4])
def test_images_that_are_all_border(height, placed, dtype, rng):
    back = cases.lag_operator_adjoint(rng, dtype)
    back.inputs[-2][:, 0] = height
    back.inputs[-1] = back.inputs[-1][:, :height].copy()
    back.outputs = [output[:, :, :height].copy() for output in back.outputs]
    np.testing.assert_array_equal(back.run(placed)[0], 0)
    back = cases.lag_operator_adjoint(rng, dtype)
    back.inputs[-2][:, 1] = height
    back.inputs[-1] = back.inputs[-1][:, :, :height].copy()
    back.outputs = [output[..., :height].copy() for output in back.outputs]
    np.testing.assert_array_equal(back.run(placed)[0], 0)


def test_cells_beyond_the_extent_have_no_gradient(placed, dtype, rng):
    """Whatever the images' adjoints hold there; all others have that of images of that size."""
    back = cases.lag_operator_adjoint(rng, dtype)
    back.inputs[0][:] = [0, 1, 2]
    height, width = 17, 22
    back.inputs[-2][:] = height, width
    back.inputs[-1][:, height:] = back.inputs[-1][..., width:] = np.nan
    (adj_deposit,) = back.run(placed)
    assert not adj_deposit[..., height:, :].any() and not adj_deposit[..., width:].any()
    back.inputs[-1] = back.inputs[-1][:, :height, :width].copy()
    back.outputs = [filled((3, 2, height, width), dtype), filled((cases.B, 2, height, width), dtype)]
    assert_close(back.run(placed)[0], np.ascontiguousarray(adj_deposit[..., :height, :width]))
