"""Conjugate gradients: against a dense solution, and against the specification."""

import numpy as np
import pytest

from . import cases
from .helpers import TOLERANCE, assert_close, filled
from .references import code_solution

EXACT = {np.dtype(np.float32): 2e-4, np.dtype(np.float64): 1e-9}
"""A solution is its condition, some tens here, worse than the rounding of its steps."""


def solve(runner, system, *, max_iterations=200, tolerance=0.0):
    """Copy, solve, and give q and the number of iterations."""
    *inputs, start = system if len(system) == 9 else of_one_code(system)
    rhs = inputs[0]
    backend, device, dtype = runner.backend, runner.device, rhs.dtype
    q = backend.from_host(start.copy(), device)
    iterations = backend.from_host(np.full(len(rhs), -1, np.int32), device)
    around = [size + inputs[1].shape[1] - 1 for size in rhs.shape[1:]]
    scratch = [filled((len(rhs), 5, *rhs.shape[1:]), dtype), filled((len(rhs), *around), dtype)]
    backend.solve_code(
        *(backend.from_host(array.copy(), device) for array in inputs),
        max_iterations,
        tolerance,
        *(backend.from_host(array, device) for array in scratch),
        q,
        iterations,
    )
    backend.synchronize(device)
    return np.array(backend.to_host(q)), np.array(backend.to_host(iterations))


def of_one_code(system):
    """Arguments as the launchers take them: all modules are looked at, and all of them are unclear."""
    rhs, stencil, damping, free, start = system
    batch, rows, columns = rhs.shape
    bounds = np.array([[0, rows, 0, columns]], np.int32)
    about = [np.zeros(batch, np.int32), free[None], bounds, np.ones((batch, rows), np.int32)]
    return [rhs, stencil, damping, *about, np.zeros(1, np.int32), start]


def of_window(system, b):
    rhs, stencil, damping, free, start = system
    return rhs[b].astype(float), stencil[b].astype(float), float(damping[b]), free, start[b].astype(float)


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (5, 5), (12, 12), (19, 19), (5, 19), (17, 4)], ids=str)
def test_specification_solves_the_system(shape, spec, dtype, rng):
    system = cases.system(rng, dtype, shape)
    q, _ = solve(spec, system, tolerance=float(TOLERANCE[np.dtype(dtype)]) / 10)
    for b in range(cases.B):
        expected = code_solution(*of_window(system, b))
        np.testing.assert_allclose(
            q[b], expected, rtol=0, atol=EXACT[np.dtype(dtype)] * np.abs(expected).max()
        )


@pytest.mark.parametrize(
    "shape", [(1, 1), (5, 5), (12, 12), (19, 19), (5, 19), (19, 5), (1, 15), (16, 11)], ids=str
)
def test_equals_the_specification(shape, placed, spec, dtype, rng):
    system = cases.system(rng, dtype, shape)
    # a single module is solved by one step, to rounding
    q, iterations = solve(placed, system, max_iterations=5, tolerance=1e-6)
    expected, expected_iterations = solve(spec, system, max_iterations=5, tolerance=1e-6)
    assert_close(q, expected, EXACT[np.dtype(dtype)])
    np.testing.assert_array_equal(iterations, expected_iterations)


@pytest.mark.parametrize("shape", [(5, 5), (19, 19), (9, 27), (27, 9), (31, 40)], ids=str)
def test_codes_side_by_side_equal_the_specification(shape, placed, spec, dtype, rng):
    system = cases.systems(rng, dtype, shape)
    q, iterations = solve(placed, system, max_iterations=5, tolerance=1e-6)
    expected, expected_iterations = solve(spec, system, max_iterations=5, tolerance=1e-6)
    assert_close(q, expected, EXACT[np.dtype(dtype)])
    np.testing.assert_array_equal(iterations, expected_iterations)


@pytest.mark.parametrize("shape", [(19, 19), (31, 40)], ids=str)
def test_a_smaller_code_is_that_of_its_free_modules(shape, placed, dtype, rng):
    """Solved between its bounds, with what lies around it as it was; a window that is clear is left alone."""
    system = cases.systems(rng, dtype, shape)
    rhs, stencil, damping, _, free, bounds, unclear, _, start = system
    unclear[1, :2] = 4
    unclear[2] = 0
    q, iterations = solve(placed, system)
    top, bottom, left, right = bounds[1]
    inside = np.zeros(shape, np.int32)
    inside[top:bottom, left:right] = free[1, top:bottom, left:right]
    expected = code_solution(*of_window((rhs, stencil, damping, inside, start), 1))
    np.testing.assert_allclose(q[1], expected, rtol=0, atol=EXACT[np.dtype(dtype)] * np.abs(expected).max())
    np.testing.assert_array_equal(q[2], start[2])
    assert iterations[2] == 0 < iterations[1]


@pytest.mark.parametrize("name", ["warp", "numpy"])
def test_room_around_a_code_does_not_change_a_bit(name, rng):
    """Windows of small codes share arrays with those of large ones: room to the right of them and below."""
    backend = pytest.importorskip(f"evqr_kernels.{name}_backend").load()
    runner = type("Runner", (), {"backend": backend, "device": "cpu"})
    system = of_one_code(cases.system(rng, np.float32, (25, 40)))
    system[5][:] = 3, 22, 4, 29
    found = solve(runner, system, max_iterations=9, tolerance=1e-3)

    def wider(array):
        room = [(0, 0), (0, 9), (0, 24)] if array.ndim == 3 and array.shape[-1] == 40 else []
        return np.pad(array, room) if room else array

    system = [wider(array) for array in system]
    system[6] = np.pad(system[6], [(0, 0), (0, 9)])
    for one, other in zip(found, solve(runner, system, max_iterations=9, tolerance=1e-3), strict=True):
        np.testing.assert_array_equal(one, other[:, :25, :40] if one.ndim == 3 else other)


def test_stops_at_the_tolerance(placed, spec, dtype, rng):
    system = cases.system(rng, dtype, (19, 19))
    q, iterations = solve(placed, system, tolerance=1e-2)
    expected, expected_iterations = solve(spec, system, tolerance=1e-2)
    np.testing.assert_array_equal(iterations, expected_iterations)
    assert (0 < iterations).all() and (iterations < 100).all()
    assert_close(q, expected, EXACT[np.dtype(dtype)])


def test_fixed_modules_stay(placed, dtype, rng):
    system = cases.system(rng, dtype, (19, 19))
    q, _ = solve(placed, system, max_iterations=9)
    fixed = system[3] == 0
    np.testing.assert_array_equal(q[:, fixed], system[4][:, fixed])


@pytest.mark.parametrize("what", ["nothing free", "already solved", "no iterations"])
def test_nothing_to_do(what, placed, dtype, rng):
    system = cases.system(rng, dtype, (9, 9))
    if what == "nothing free":
        system[3][:] = 0
    elif what == "already solved":
        system[0][:] = 0
        system[4][:] = 0
    q, iterations = solve(placed, system, max_iterations=0 if what == "no iterations" else 9, tolerance=1e-3)
    np.testing.assert_array_equal(q, system[4])
    np.testing.assert_array_equal(iterations, 0)
