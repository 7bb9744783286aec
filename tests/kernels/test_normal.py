"""Normal equations of both stages against matrices written out, and the direct solution."""

import numpy as np
import pytest

import evqr_kernels

from . import cases
from .helpers import TOLERANCE, assert_adjoint, assert_close, filled
from .references import code_matrix, code_model, code_solution
from .test_align import SIDES, centre_of, scene, starts
from .test_solve import EXACT, of_window


@pytest.mark.parametrize("parameters", [6, 8])
def test_pose_matrix_is_that_of_the_jacobian(parameters, placed, dtype, rng):
    """J and the residual point by point, from a table and samples of an image."""
    table, e = rng.normal(size=(60, 20)), rng.normal(size=(4, 60))
    call = cases.pose_normal_equations(rng, dtype, parameters)
    terms, factors = call.inputs[2:4]
    moments = np.concatenate([e @ table, (e * e).sum(axis=1, keepdims=True)], axis=1)
    call.inputs[:2] = [moments.astype(dtype), (table.T @ table).astype(dtype)]
    gain, matrix, rhs = call.run(placed)
    for h in range(len(e)):
        slopes = table[:, -2:]
        ridge = 1e-3 * np.trace(slopes.T @ slopes) * np.eye(2)
        expected_gain = -np.linalg.solve(slopes.T @ slopes + ridge, slopes.T @ e[h])
        np.testing.assert_allclose(gain[h], expected_gain, rtol=0, atol=100 * TOLERANCE[gain.dtype])
        value = np.array([0, *expected_gain, 1])
        jacobian = np.einsum("spk,pk->sp", table[:, terms], value[factors])
        residual = e[h] + slopes @ expected_gain
        for got, want in ((matrix[h], jacobian.T @ jacobian), (rhs[h], jacobian.T @ residual)):
            error = 100 * TOLERANCE[got.dtype] * np.abs(want).max()
            np.testing.assert_allclose(got, want, rtol=0, atol=error)


@pytest.mark.parametrize("sides", SIDES, ids=str)
@pytest.mark.parametrize("tilt", [False, True])
def test_pose_step_is_the_one_that_alignment_takes(tilt, sides, placed):
    """From moments to the step, against one iteration of `align_poses` without damping."""
    backend = {"backend": placed.backend.name, "device": placed.device}
    image, points, table, terms, factors = scene(np.float64, tilt, sides)
    poses, idx = starts(np.float64)[:1], np.zeros(1, np.int32)
    moments = evqr_kernels.sample_moments(image, idx, poses, points, table, **backend)
    normal = evqr_kernels.pose_normal_equations(moments, table.T @ table, terms, factors, **backend)
    gain, matrix, rhs = normal
    matrix[0] += 1e-7 * np.trace(matrix[0]) * np.eye(len(terms))  # as alignment does
    step = np.zeros(8)
    step[: len(terms) - 2] = -np.linalg.solve(matrix[0], rhs[0])[:-2]
    step /= max(1, np.abs(step).sum())
    warp = np.eye(3)
    centre = scale = np.array(centre_of(sides))
    warp[:2] += step[:6].reshape(2, 3)[:, [1, 2, 0]] / [*scale, 1]
    warp[2, :2] = -step[6:] / (scale * scale.max())
    to_centre = np.eye(3)
    to_centre[:2, 2] = -centre
    moved = poses.reshape(3, 3) @ np.linalg.inv(to_centre) @ np.linalg.inv(warp) @ to_centre

    options = {
        "centre": centre_of(sides),
        "scale": centre_of(sides),
        "damping": 0.0,
        "max_iterations": 1,
        **backend,
    }
    aligned, _ = evqr_kernels.align_poses(image, idx, poses, points, table, terms, factors, **options)
    np.testing.assert_allclose(aligned.reshape(3, 3), moved / moved[2, 2], rtol=0, atol=1e-9)
    _, values = evqr_kernels.align_poses(
        image, idx, poses, points, table, terms, factors, **{**options, "max_iterations": 0}
    )
    np.testing.assert_allclose(gain, values[:, :2], rtol=1e-12)


@pytest.mark.parametrize("shape", [(9, 9), (12, 12), (9, 14), (13, 10)], ids=str)
def test_code_stencil_is_the_matrix_far_from_the_border(shape, placed, rng):
    samples, reach = 3, 4
    call = cases.code_normal_equations(rng, np.float64, shape, reach)
    stencil, rhs = call.run(placed)
    expected_rhs = cases.code_rhs(rng, np.float64, shape)
    expected_rhs.inputs = call.inputs
    np.testing.assert_array_equal(rhs, expected_rhs.run(placed)[0])
    profile, slope, gain = call.inputs[6:9]
    row, column = shape[0] // 2, shape[1] // 2
    for b in range(cases.B):
        a = code_model(profile, slope, gain[b], shape, samples)
        matrix = (a.T @ a).reshape(*shape, *shape)[row, column]
        for k in range(-2, 3):
            for m in range(-2, 3):
                got = stencil[b, k + reach, m + reach]
                assert abs(got - matrix[row + k, column + m]) < 1e-10 * np.abs(matrix).max()


@pytest.mark.parametrize("shape", [(9, 9), cases.WIDE, cases.TALL], ids=str)
def test_code_product_is_that_of_the_matrix(shape, placed, dtype, rng):
    call = cases.code_product(rng, dtype, shape)
    q, stencil, damping, free = call.inputs
    (product,) = call.run(placed)
    for b in range(cases.B):
        expected = (code_matrix(stencil[b], damping[b], shape) @ q[b].ravel()).reshape(shape)
        assert_close(product[b], np.where(free, expected, 0).astype(dtype))


@pytest.mark.parametrize("shape", [(9, 9), cases.WIDE, cases.TALL], ids=str)
def test_code_product_is_symmetric(shape, placed, dtype, rng):
    call = cases.code_product(rng, dtype, shape)
    q, _, _, free = call.inputs
    other = np.where(free, rng.normal(size=q.shape), 0).astype(dtype)
    call.inputs[0] = q = np.where(free, q, 0).astype(dtype)
    (product,) = call.run(placed)
    call.inputs[0] = other
    assert_adjoint(product, other, q, call.run(placed)[0])


SQUARE = [(n, n) for n in (1, 2, 5, 9, 12, 19)]


@pytest.mark.parametrize("shape", [*SQUARE, (1, 9), (9, 1), (2, 7), (5, 19), (19, 5), (13, 12)], ids=str)
def test_banded_solution_is_the_dense_one(shape, placed, dtype, rng):
    call = cases.solve_code_banded(rng, dtype, shape)
    (q,) = call.run(placed)
    system = (*call.inputs, call.outputs[1])
    for b in range(cases.B):
        expected = code_solution(*of_window(system, b))
        np.testing.assert_allclose(q[b], expected, rtol=0, atol=EXACT[q.dtype] * np.abs(expected).max())
    fixed = call.inputs[3] == 0
    np.testing.assert_array_equal(q[:, fixed], call.outputs[1][:, fixed])


@pytest.mark.parametrize("shape", [(9, 9), cases.WIDE, cases.TALL], ids=str)
def test_banded_equals_the_specification(shape, placed, spec, dtype, rng):
    call = cases.solve_code_banded(rng, dtype, shape)
    assert_close(*call.run(placed), *call.run(spec), EXACT[np.dtype(dtype)])


@pytest.mark.parametrize("shape", [(14, 14), (6, 17), (17, 6)], ids=str)
def test_banded_and_iterative_solutions_agree(shape, placed, rng):
    rhs, stencil, damping, free, start = cases.system(rng, np.float64, shape)
    backend = {"backend": placed.backend.name, "device": placed.device}
    direct = evqr_kernels.solve_code_banded(rhs, stencil, damping, free, start, **backend)
    iterative, _ = evqr_kernels.solve_code(
        rhs, stencil, damping, free, start, max_iterations=400, tolerance=1e-12, **backend
    )
    assert_close(direct, iterative, 1e-9)
    product = evqr_kernels.code_product(direct, stencil, damping, free, **backend)
    np.testing.assert_allclose(product[:, free != 0], -rhs[:, free != 0], rtol=0, atol=1e-10)


def test_nothing_free_leaves_everything(placed, dtype, rng):
    call = cases.solve_code_banded(rng, dtype)
    call.inputs[3][:] = 0
    np.testing.assert_array_equal(call.run(placed)[0], call.outputs[1])


def test_stencils_of_one_module(placed, dtype, rng):
    rhs, _, damping, free, start = cases.system(rng, dtype, (4, 5))
    stencil = np.full((cases.B, 1, 1), 2, dtype)
    outputs = [filled((cases.B, 20, 1), dtype), start]
    _, q = placed("solve_code_banded", [rhs, stencil, damping, free], outputs)
    expected = np.where(free, -rhs / (2 + damping[:, None, None]), start)
    assert_close(q, expected.astype(dtype))
