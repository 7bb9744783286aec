"""Laws of the other operations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import evqr_kernels

from . import cases
from .helpers import assert_close, filled
from .references import code_model


@given(dx=st.integers(-4, 4), dy=st.integers(-4, 4))
def test_correlation_peaks_at_the_displacement(dx, dy):
    rng = np.random.default_rng(11)
    first = np.zeros((1, 24, 31))
    first[0, 6:18, 6:25] = rng.normal(size=(12, 19))
    second = np.roll(first, (dy, dx), axis=(1, 2))
    images = np.stack([first, second], axis=1)
    (surface,), (energy,) = evqr_kernels.motion_correlation(images, radius=4, clip=10.0)
    assert np.unravel_index(surface.argmax(), surface.shape) == (dy + 4, dx + 4)
    np.testing.assert_allclose(energy, np.sum(first * first), rtol=1e-12)
    np.testing.assert_allclose(surface.max(), energy[0], rtol=1e-12)


def test_a_quiet_pair_is_not_correlated():
    images = np.random.default_rng(5).normal(size=(3, 2, 20, 30))
    energies = (images**2).sum(axis=(1, 2, 3))
    quiet = energies[:, None] + np.array([[-1.0, 1.0], [0.5, 1.0], [-1.0, -0.5]])
    surfaces, energy = evqr_kernels.motion_correlation(images, quiet, radius=2, clip=10.0)
    every, _ = evqr_kernels.motion_correlation(images, radius=2, clip=10.0)
    assert (surfaces[0] == 0.0).all()
    np.testing.assert_array_equal(surfaces[1:], every[1:])
    np.testing.assert_allclose(energy.sum(axis=1), energies, rtol=1e-12)


def test_a_hot_pixel_counts_as_much_as_the_clip():
    images = np.zeros((1, 2, 20, 40))
    images[0, :, 10, 20] = 1000.0
    images[0, 0, 4, 7] = images[0, 1, 5, 9] = 1.5
    (surface,), (energy,) = evqr_kernels.motion_correlation(images, radius=3, clip=2.0)
    np.testing.assert_allclose(energy, 4.0 + 2.25)
    assert surface[3, 3] == 4.0
    assert surface[4, 5] == 2.25
    assert images[0, 0, 10, 20] == 1000.0


@given(x=st.floats(-3.4, 3.4), y=st.floats(-3.4, 3.4), near=st.floats(-0.8, 0.0))
def test_a_symmetric_peak_is_found_whatever_lies_on_one_side_of_it(x, y, near):
    """Half a surface is lower, as where an edge of the other sign is near, outside the window."""
    steps = np.arange(-7.0, 8.0)
    distance = np.hypot(steps - x, steps[:, None] - y)
    surface = np.exp(-0.5 * (distance / 1.2) ** 2)
    surface[(distance > 5.0) & (steps < x)] = near
    peak = evqr_kernels.surface_peak(surface[None], half=3.5)[0]
    np.testing.assert_allclose(peak[:2], [x, y], atol=0.015)


def test_a_surface_of_one_height_keeps_it():
    peak = evqr_kernels.surface_peak(np.full((1, 9, 9), 3.0), half=2.5)[0]
    assert peak[2] == pytest.approx(3.0)


def test_a_dip_in_the_middle_of_a_surface_does_not_move_a_peak_beside_it():
    """A pixel that has fired is less ready to fire again, so that its own events do not agree."""
    steps = np.arange(-7.0, 8.0)
    surface = np.exp(-0.5 * ((steps - 1.5) ** 2 + steps[:, None] ** 2) / 1.2**2)
    surface[7, 7] = -1.0
    peak = evqr_kernels.surface_peak(surface[None], half=3.5)[0]
    np.testing.assert_allclose(peak[:2], [1.5, 0.0], atol=0.03)


def test_outliers_are_clipped_at_a_multiple_of_the_mean_magnitude():
    image = np.zeros((1, 4, 6))
    image[0, 0, :4] = 1.0, -1.0, 2.0, -16.0
    clipped, busy = evqr_kernels.clip_outliers(image, factor=2.0)
    assert busy == [4]
    np.testing.assert_allclose(clipped[0, 0], [1.0, -1.0, 2.0, -10.0, 0.0, 0.0])
    np.testing.assert_array_equal(evqr_kernels.clip_outliers(np.zeros((1, 4, 6)), factor=2.0)[0], 0.0)


@pytest.mark.parametrize("ratio", [1.0, 1.25, 2.0, 3.7])
def test_reduction_keeps_the_sum(ratio, dtype, rng):
    image = rng.normal(size=(2, 23, 31)).astype(dtype)
    small = evqr_kernels.reduce_image(image, ratio=ratio)
    np.testing.assert_allclose(small.sum(axis=(1, 2)), image.sum(axis=(1, 2)), rtol=0, atol=1e-4)
    if ratio == 1.0:
        np.testing.assert_array_equal(small, image)


def test_a_template_answers_to_itself_with_its_sign_and_angle(dtype, rng):
    """At its own place the response is 1, less what the floor takes; inverted: minus that."""
    n = 7
    basis, _ = np.linalg.qr(rng.normal(size=(n * n, 5)))
    mix = rng.normal(size=(8, 5))
    mix /= np.linalg.norm(mix, axis=1, keepdims=True)
    bank = (basis @ mix.T).reshape(n, n, 8)
    spans = np.tile(np.array([0, n], np.int32), (n, 1))
    for angle, sign in ((0, 1), (3, -1), (7, 1)):
        image = np.zeros((1, 20 + n - 1, 20 + n - 1))
        image[0, 9 : 9 + n, 5 : 5 + n] = sign * bank[..., angle]
        busy = np.array([n * n])
        inputs = [a.astype(dtype) for a in (image, busy, basis.reshape(1, n, n, 5), mix[None])]
        rows = np.stack([np.zeros(20, np.int32), np.arange(20, dtype=np.int32)], axis=1)
        extent, quiet = np.full((1, 1, 2), 20, np.int32), np.array([0.1], dtype)
        response, best = evqr_kernels.correlate_templates(*inputs, spans, rows, extent, quiet)
        place = np.unravel_index(np.abs(response).argmax(), response.shape)
        assert place == (0, 9, 5)
        assert best[place] == angle
        # the floor: a tenth of n^2 pixels of mean square 1 / n^2
        np.testing.assert_allclose(response[place], sign / np.sqrt(1.1), rtol=1e-5)


def test_quiet_places_do_not_answer(placed, dtype, rng):
    call = cases.correlate_templates(rng, dtype)
    call.inputs[7] = np.full(2, 1e6, dtype)
    response, angle = call.run(placed)
    np.testing.assert_array_equal(np.unique(response), [0.0, 7.0])  # 7 beyond what is a window's own
    np.testing.assert_array_equal(angle[response == 0.0], 0)
    np.testing.assert_array_equal(response[:2, : cases.Y - 9], 0)


def test_a_trough_hides_no_peak_beside_it():
    """A filter that alternates from cell to cell answers with both signs, one beside the other."""
    response = np.zeros((1, 5, 9))
    response[0, 2, 3:6] = -0.6, 0.5, 0.45
    rows = np.stack([np.zeros(5, np.int32), np.arange(5, dtype=np.int32)], axis=1)
    extent, origin = np.array([[[5, 9]]], np.int32), np.full((1, 2), -0.5)
    maxima = evqr_kernels.local_maxima(
        response, np.zeros((1, 5, 9), np.int32), rows, extent, np.ones((1, 2)), origin, least=0.3, turn=0.0
    )
    trough, peak = maxima[0, 2, :2]
    assert trough[0] == -0.6
    assert peak[0] == 0.5
    # between the two cells that nearly agree, not pushed back by the trough's magnitude
    assert 4.3 < peak[1] < 4.5


def test_weak_responses_are_left_out(placed, dtype, rng):
    call = cases.correlate_templates(rng, dtype)
    call.inputs[7:] = [np.full(2, 0.3, dtype), 0.0, 0.0]
    call.outputs[-2][:] = call.outputs[-1][:] = 0
    every, angles = call.run(placed)
    call.inputs[9] = 0.4
    strong, kept = call.run(placed)
    assert 0.05 < np.mean(strong != 0) < 0.8 * np.mean(every != 0)
    np.testing.assert_array_equal(strong, np.where(np.abs(every) >= 0.4, every, 0))
    np.testing.assert_array_equal(kept, np.where(np.abs(every) >= 0.4, angles, 0))


def test_peaks_are_the_strongest_one_a_place_and_size():
    maxima = np.array(
        [
            [0.5, 10, 10, 4, 0.1],
            [-0.9, 10, 11, 4, 0.2],  # the other sign is another peak
            [0.8, 13, 10, 4, 0.3],  # within two sizes of the first: it takes its place
            [0.7, 13, 10, 8, 0.4],  # of another size
            [0.0, 50, 50, 4, 0.5],
            [0.6, 40, 10, 4, 0.6],
        ]
    )
    peaks = evqr_kernels.merge_maxima(maxima[None], apart=2.0, log_ratio=0.3, most=6)[0]
    np.testing.assert_array_equal(peaks[:4], maxima[[1, 2, 3, 5]])
    np.testing.assert_array_equal(peaks[4:], 0)


def test_inactive_poses_are_left_as_they_are(placed, dtype, rng):
    inputs = cases.moment_inputs(rng, dtype)
    _, moments = placed("sample_moments", inputs, [filled((4, 3, 6), dtype), filled((4, 6), dtype, 7.0)])
    np.testing.assert_array_equal(moments[1], 7.0)
    assert (moments[[0, 2, 3]] != 7.0).all()


@pytest.mark.parametrize("chunks", [1, 2, 7, 700, 900])
def test_any_number_of_chunks(chunks, placed, spec, dtype, rng):
    call = cases.sample_moments(rng, dtype)
    expected = call.run(spec)
    call.outputs[0] = filled((4, chunks, 6), dtype)
    assert_close(*call.run(placed), *expected)


def test_moments_of_poses_that_see_nothing(placed, dtype, rng):
    call = cases.sample_moments(rng, dtype)
    call.inputs[2][:] = [[1, 0, 1e4, 0, 1, 0, 0, 0, 1], [0] * 9, [np.nan] * 9, [1, 0, 0, 0, 1, -50, 0, 0, 1]]
    np.testing.assert_array_equal(call.run(placed)[0], 0)


def test_moments_of_no_points(placed, dtype, rng):
    call = cases.sample_moments(rng, dtype)
    call.inputs[4], call.inputs[5] = call.inputs[4][:0], call.inputs[5][:0]
    np.testing.assert_array_equal(call.run(placed)[0], 0)


@pytest.mark.parametrize("shape", [(9, 9), (7, 13), (12, 5)], ids=str)
def test_right_hand_side_is_the_transpose_of_the_model(shape, dtype, rng):
    """<A q, E> == <q, A^T E> with A written out from its definition."""
    samples = 4
    profile, slope = rng.normal(size=(2, 5 * samples))
    down, across = (size * samples for size in shape)
    gain, q, image = rng.normal(size=2), rng.normal(size=shape), rng.normal(size=(1, down, across))
    a_q = (code_model(profile, slope, gain, shape, samples) @ q.ravel()).reshape(down, across)
    # each lattice point looks at one pixel; the last row and column lie on the border, which is outside
    image[:, -1], image[:, :, -1] = 0, 0
    lattices = [(np.arange(count) + 0.5) / samples for count in (across, down)]
    pose = np.array([[samples, 0, -0.5, 0, samples, -0.5, 0, 0, 1.0]])
    arrays = [image, pose, *lattices, profile, slope, gain[None]]
    rhs = evqr_kernels.code_rhs(*(a.astype(dtype) for a in arrays), samples_a_module=samples)
    size = np.linalg.norm(a_q) * np.linalg.norm(image)
    assert abs(np.vdot(a_q, image[0]) - np.vdot(q, rhs[0])) < (1e-5 if dtype == np.float32 else 1e-12) * size


sides = st.integers(1, 11)


@given(rows=sides, columns=sides, seed=st.integers(0, 99))
def test_a_code_on_its_side_has_its_equations_on_their_side(rows, columns, seed):
    """u and v, x and y change places in all that goes in, and so they do in what comes out."""
    inputs = cases.code_rhs(np.random.default_rng(seed), np.float64, (rows, columns)).inputs
    image, pose, _, across, down, _, profile, slope, gain, samples = inputs
    swap = [1, 0, 2]
    turned_pose = pose.reshape(-1, 3, 3)[:, swap][:, :, swap].reshape(-1, 9)
    turned = [np.ascontiguousarray(image.transpose(0, 2, 1)), np.ascontiguousarray(turned_pose), down, across]
    turned += [profile, slope, np.ascontiguousarray(gain[:, ::-1])]
    stencil, rhs = evqr_kernels.code_normal_equations(
        image, pose, across, down, profile, slope, gain, samples_a_module=samples
    )
    other_stencil, other_rhs = evqr_kernels.code_normal_equations(*turned, samples_a_module=samples)
    assert_close(other_stencil, stencil.transpose(0, 2, 1))
    assert_close(other_rhs, rhs.transpose(0, 2, 1), 1e-11)


@given(rows=sides, columns=sides, seed=st.integers(0, 99))
def test_a_code_on_its_side_has_its_modules_on_their_side(rows, columns, seed):
    rhs, stencil, damping, free, start = cases.system(
        np.random.default_rng(seed), np.float64, (rows, columns)
    )

    def turned(array):
        return np.ascontiguousarray(np.swapaxes(array, -1, -2))

    upright = rhs, stencil, damping, free, start
    other = turned(rhs), turned(stencil), damping, turned(free), turned(start)
    banded = evqr_kernels.solve_code_banded(*upright)
    assert_close(evqr_kernels.solve_code_banded(*other), turned(banded), 1e-9)
    options = {"max_iterations": 400, "tolerance": 1e-12}
    for arguments, expected in ((upright, banded), (other, turned(banded))):
        assert_close(evqr_kernels.solve_code(*arguments, **options)[0], expected, 1e-9)
