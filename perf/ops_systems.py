"""Problems for operations on the equations of modules; what they are is said in ``ops.py``."""

from __future__ import annotations

import numpy as np
from problems import Problem, Size, problem

REACH = 4  # of the stencil


def _system(size: Size, rng, dtype) -> tuple[list, np.ndarray]:
    """rhs, stencil, damping and free modules of a positive definite system, and where to start."""
    batch, modules, side = size.batch, size.modules, 2 * REACH + 1
    free = (rng.random((modules, modules)) < 0.7).astype(np.int32)
    taps = rng.normal(size=(batch, REACH + 1, REACH + 1))
    stencil = np.zeros((batch, side, side))
    for j, i in np.ndindex(REACH + 1, REACH + 1):
        part = taps[:, j, i, None, None] * taps[:, ::-1, ::-1]
        stencil[:, j : j + REACH + 1, i : i + REACH + 1] += part
    rhs, start = rng.normal(size=(2, batch, modules, modules)).astype(dtype)
    damping = np.full(batch, 5.0, dtype)
    return [rhs, stencil.astype(dtype), damping, free], start


def code_product(size: Size, rng, dtype) -> Problem:
    (_, *system), q = _system(size, rng, dtype)
    madds = q.size * (2 * REACH + 1) ** 2
    return problem("code_product", [q, *system], q.size, madds, "module")


def sum_equations(size: Size, rng, dtype) -> Problem:
    (rhs, stencil, *_), before = _system(size, rng, dtype)
    gain, score = np.ones((size.batch, 2), dtype), np.ones(size.batch, dtype)
    products, idx = rng.random((3, *stencil.shape[1:])).astype(dtype), np.zeros(size.batch, np.int32)
    inputs = [rhs, gain, score, products, before, stencil, score, 0 * score, idx, before[:1], 1.0, 0.1, 10.0]
    return problem("sum_equations", inputs, rhs.size, rhs.size, "module")


def pull_modules(size: Size, rng, dtype) -> Problem:
    (seen, _, damping, _), q = _system(size, rng, dtype)
    return problem("pull_modules", [seen, q, damping, 4.0], q.size, 2 * q.size, "module")


def solve_code(size: Size, rng, dtype, iterations: int = 20) -> Problem:
    (rhs, stencil, damping, free), start = _system(size, rng, dtype)
    side = size.modules
    about = [np.zeros(size.batch, np.int32), free[None], np.array([[0, side, 0, side]], np.int32)]
    unclear = np.ones((size.batch, side), np.int32)
    system = [rhs, stencil, damping, *about, unclear, np.zeros(1, np.int32)]
    items = start.size * iterations
    madds = items * ((2 * REACH + 1) ** 2 + 5)
    return problem("solve_code", [*system, iterations, 0.0], items, madds, "module", start=start)


def solve_code_banded(size: Size, rng, dtype) -> Problem:
    system, start = _system(size, rng, dtype)
    width = REACH * (size.modules + 1)
    share = float(np.square(system[3].mean()))  # fixed modules leave empty rows and columns
    madds = share * start.size * width**2 / 2
    return problem("solve_code_banded", system, start.size, madds, "module", start=start)
