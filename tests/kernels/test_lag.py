"""Laws of deposits and of the lag operator."""

from itertools import pairwise

import numpy as np
import pytest
from backends import BACKENDS

import evqr_kernels

from . import cases
from .helpers import assert_adjoint, assert_close, filled

BLUR = np.exp(-0.5 * (np.arange(-2, 3) / 0.8) ** 2)
SLOPE = np.arange(-2, 3) * BLUR
TAPS = np.stack([BLUR / BLUR.sum(), SLOPE / (SLOPE @ np.arange(-2, 3))])
"""A blur that sums to 1 and a slope that is exact for a linear image."""

INNER = np.s_[..., 2:-2, 2:-2]
ONE = np.zeros(1, np.int32)


def run(name, deposit, direction, lag):
    direction, lag = np.array([direction], deposit.dtype), np.array([lag], deposit.dtype)
    taps = TAPS.astype(deposit.dtype)
    return evqr_kernels.lag_operator(deposit, ONE, direction, lag, taps, backend=name)


def test_deposits_keep_mass_centre_and_sign(placed, dtype, rng):
    x, y = (rng.uniform(1, size - 2, 40).astype(dtype) for size in (cases.X, cases.Y))
    t, weight = np.zeros(40, dtype), rng.choice([-1.0, 2.0], 40).astype(dtype)
    ptr, motion = np.array([0, 40], np.int32), np.zeros((1, 2), dtype)
    out = filled((1, 2, cases.Y, cases.X), dtype, 0.0)
    frame = np.array([[0, 0, 1]], dtype)
    (deposit,) = placed("deposit_events", [x, y, t, weight, ptr, motion, frame], [out])
    for image, sign in zip(deposit[0], (1, -1), strict=True):
        own = np.where(np.sign(weight) == sign, weight, 0)
        assert_close(image.sum(axis=0) @ np.arange(cases.X, dtype=dtype), own @ x)
        assert_close(image.sum(axis=1) @ np.arange(cases.Y, dtype=dtype), own @ y)
        assert (sign * image >= 0).all()


def test_an_event_between_cells_is_shared():
    half = np.full(1, 2.5, np.float32)
    none, ptr = np.zeros(1, np.float32), np.array([0, 1], np.int32)
    deposit = evqr_kernels.deposit_events(
        half, half + 0.25, none, none - 1, ptr, np.zeros((1, 2), np.float32), shape=(8, 8)
    )
    assert not deposit[0, 0].any()
    np.testing.assert_allclose(deposit[0, 1, 2:4, 2:4], [[-0.125, -0.125], [-0.375, -0.375]])
    assert np.count_nonzero(deposit) == 4


def test_motion_and_frame_say_where():
    x, y, t = (np.array([v], np.float32) for v in (12.0, 7.0, 0.002))
    motion, frame = np.array([[1000.0, -500.0]], np.float32), np.array([[4.5, 2.5, 2.0]], np.float32)
    ptr = np.array([0, 1], np.int32)
    deposit = evqr_kernels.deposit_events(x, y, t, t / t, ptr, motion, frame=frame, shape=(8, 8))
    # transported to (10, 8); the first cell is 2 px wide and ends half a px before its frame's corner
    column, row = (10 - 4.5 + 0.5) / 2 - 0.5, (8 - 2.5 + 0.5) / 2 - 0.5
    assert (column, row) == (2.5, 2.5)
    np.testing.assert_allclose(deposit[0, 0, 2:4, 2:4], 0.25)


@pytest.mark.parametrize("name", BACKENDS)
def test_the_operator_is_exact_for_a_ramp(name):
    column, row = np.meshgrid(np.arange(32.0), np.arange(20.0))
    deposit = np.stack([3 * column, 5 * row])[None]
    image = run(name, deposit, (0.6, 0.8), (1.5, 2.0))
    expected = 3 * (column - 0.6 * 1.5) + 5 * (row - 0.8 * 2.0)
    np.testing.assert_allclose(image[0][INNER], expected[INNER], rtol=1e-12)
    border = image[0].copy()
    border[INNER] = 0
    assert not border.any()


@pytest.mark.parametrize("name", BACKENDS)
def test_the_adjoint_is_the_operator_with_the_direction_turned(name, rng):
    deposit = rng.normal(size=(1, 2, 20, 30))
    direction, lag = np.array([0.6, -0.8]), (1.5, 2.5)
    y = np.zeros((1, 20, 30))
    y[..., 4:-4, 4:-4] = rng.normal(size=(12, 22))
    back = [run(name, np.stack([y, 0 * y], axis=1), -direction, (own, 0.0)) for own in lag]
    assert_adjoint(run(name, deposit, direction, lag), y, deposit, np.stack(back, axis=1))


def test_a_lag_is_undone():
    """Of an edge that a first-order pixel smears along the motion, the blurred edge is left."""
    x, lag = np.arange(64.0), 2.0
    edge = np.exp(-0.5 * ((x - 20) / 2.0) ** 2)
    smeared = np.zeros(64)
    for late in np.arange(0, 40, 0.05):  # behind the edge: -x for a motion along +x
        smeared += np.interp(x + late, x, edge) * np.exp(-late / lag) * 0.05 / lag
    rows = np.tile(smeared, (9, 1))
    deposit = np.stack([rows, np.zeros_like(rows)])[None]
    undone = run("numpy", deposit, (1.0, 0.0), (lag, 0.0))[0, 4]
    wanted = np.convolve(edge, TAPS[0], mode="same")
    assert np.abs(undone - wanted)[4:-4].max() < 0.03 < 0.2 < np.abs(smeared - wanted)[4:-4].max()


@pytest.mark.parametrize("width", [1, 2, 4, 5, 8, 9, 19, 20, 21, 22, 36, 37, 53])
@pytest.mark.parametrize("height", [1, 4, 5, 9])
def test_any_size(width, height, placed, spec, dtype, rng):
    call = cases.lag_operator(rng, dtype)
    call.inputs[0] = rng.normal(size=(cases.B, 2, height, width)).astype(dtype)
    call.inputs[5][:] = [(height, width), (height - 1, width // 2), (height, max(width - 17, 0))]
    call.outputs = [filled((3, 2, height, width), dtype), filled((3, height, width), dtype)]
    assert_close(*call.run(placed), *call.run(spec))


@pytest.mark.parametrize("width", [20, 21, 30, 37, 53, 54])
def test_an_extent_is_as_an_image_of_that_size(width, placed, dtype, rng):
    """To the bit, whatever the deposit holds beyond; the rest of the image is 0."""
    call, height = cases.lag_operator(rng, dtype), 17
    deposit = rng.normal(size=(cases.B, 2, height + 6, 54)).astype(dtype)
    own = np.s_[..., :height, :width]
    call.inputs[0], call.inputs[5] = deposit[own].copy(), np.full((3, 2), (height, width), np.int32)
    call.outputs = [filled((3, 2, height, width), dtype), filled((3, height, width), dtype)]
    (alone,) = call.run(placed)
    call.inputs[0] = filled(deposit.shape, dtype)
    call.inputs[0][own] = deposit[own]
    call.outputs = [filled((3, *deposit.shape[1:]), dtype), filled((3, *deposit.shape[2:]), dtype)]
    (image,) = call.run(placed)
    np.testing.assert_array_equal(image[own], alone)
    image[own] = 0
    assert not image.any()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 2)])
def test_deposits_on_small_images(shape, placed, spec, dtype, rng):
    call = cases.deposit_events(rng, dtype)
    call.inputs[:2] = [(column / 6).astype(dtype) for column in call.inputs[:2]]
    call.outputs = [filled((cases.B, 2, *shape), dtype, 0.5)]
    assert_close(*call.run(placed), *call.run(spec))


def test_a_deposit_keeps_the_mass_of_its_window(placed, dtype, rng):
    """ON on the first image, OFF on the second; the window without events stays as it was."""
    call = cases.deposit_events(rng, dtype)
    x, y, _, weight, ptr, motion, frame = call.inputs
    x[:], y[:] = rng.uniform(4, 20, (2, len(x)))
    motion[:] = 0
    frame[:] = [0, 0, 1]
    call.outputs[0][:] = 0
    (deposit,) = call.run(placed)
    window = np.repeat(np.arange(cases.B), np.diff(ptr))
    for image, own in ((0, weight > 0), (1, weight < 0)):
        mass = np.bincount(window, np.where(own, weight, 0), minlength=cases.B)
        np.testing.assert_allclose(deposit[:, image].sum(axis=(1, 2), dtype=float), mass, atol=1e-4)
    assert not deposit[1].any()


def test_operator_on_one_deposit_after_another(placed, dtype, rng):
    """Images do not see each other."""
    call = cases.lag_operator(rng, dtype)
    (together,) = call.run(placed)
    for n in range(3):
        alone = cases.lag_operator(rng, dtype)
        alone.inputs = [call.inputs[0], *(array[n : n + 1] for array in call.inputs[1:4]), call.inputs[4]]
        alone.inputs.append(call.inputs[5][n : n + 1])
        alone.outputs = [output[n : n + 1] for output in call.outputs]
        assert_close(
            alone.run(placed)[0], together[n : n + 1], tolerance=1e-15 if placed.device == "cpu" else None
        )


def test_operator_is_linear_in_the_deposit(placed, dtype, rng):
    call = cases.lag_operator(rng, dtype)
    first = call.inputs[0]
    second = rng.normal(size=first.shape).astype(dtype)
    images = []
    for deposit in (first, second, first - 3 * second):
        call.inputs[0] = deposit
        images += call.run(placed)
    assert_close(images[0] - 3 * images[1], images[2])


def test_without_lag_the_operator_is_the_blur(placed, dtype, rng):
    call = cases.lag_operator(rng, dtype)
    call.inputs[3][:] = 0
    call.inputs[5][:] = cases.Y, cases.X
    (image,) = call.run(placed)
    deposit, deposit_idx, _, _, taps, _ = call.inputs
    windows = np.lib.stride_tricks.sliding_window_view(deposit.sum(axis=1)[deposit_idx], (5, 5), axis=(1, 2))
    blurred = np.einsum("nyxji,j,i->nyx", windows, taps[0], taps[0])
    assert_close(image[:, 2:-2, 2:-2], blurred)


def test_order_of_events_does_not_matter_to_the_deposit(placed, dtype, rng):
    call = cases.deposit_events(rng, dtype)
    first = call.run(placed)
    x, y, t, weight, ptr, *others = call.inputs
    order = np.concatenate([rng.permutation(np.arange(a, b)) for a, b in pairwise(ptr)])
    call.inputs = [x[order], y[order], t[order], weight[order], ptr, *others]
    assert_close(*call.run(placed), *first)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_lagged_line_becomes_symmetric(backend, sign):
    """Events of a line on pixels whose delays are exponential: the operator, given their mean, centres it.

    A pixel that lags by ``lag`` cells is late by -lag ln u; the events of a line at column 30 that moves
    along +x trail it by so much.
    """
    lag, line, count = 3.0, 30.0, 4000
    quantiles = (np.arange(count) + 0.5) / count
    x = line + lag * np.log(quantiles)
    y, t = np.full(count, 6.0), np.zeros(count)
    ptr, motion = np.array([0, count], np.int32), np.array([[1.0, 0.0]])
    deposit = evqr_kernels.deposit_events(
        x, y, t, np.full(count, sign), ptr, motion, shape=(13, 48), backend=backend
    )
    steps = np.arange(-6, 7)
    blur = np.exp(-0.5 * (steps / 1.5) ** 2)
    taps = np.stack([blur / blur.sum(), steps * blur / (steps * steps * blur).sum()])

    def asymmetry(lags):
        lags, direction = np.array([lags]), np.array([[1.0, 0.0]])
        image = evqr_kernels.lag_operator(
            deposit, np.zeros(1, np.int32), direction, lags, taps, backend=backend
        )
        around = sign * image[0, 6, 20:41]
        return np.abs(around - around[::-1]).max() / around.max()

    own = (lag, 0.0) if sign > 0 else (0.0, lag)
    assert asymmetry(own) < 0.05 < 0.3 < asymmetry(own[::-1])
