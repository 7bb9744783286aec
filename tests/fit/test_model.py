"""The printed code as a smooth function: its profiles, and the tables of its derivatives."""

import math

import numpy as np
import pytest
from rectangles import TALL, WIDE

from evqr.fit.model import lattice, lattices, pose_table, profiles, quiet_modules
from evqr.fit.tables import terms_of
from evqr.symbol import micro_qr, qr

SIGMAS = [0.25, 0.36, 0.5, 0.9]

STEP = 1e-4
"""Central differences of a function whose third derivative is below 1/sigma^3 = 64 are right to 1e-7."""


def rendered(grid, points, sigma):
    """Luminance at code coordinates (N, 2), straight from the definition: light outside, boxes blurred."""

    def box(offset):
        z = np.stack([offset, offset - 1.0]) / (sigma * math.sqrt(2.0))
        near, far = np.vectorize(math.erf)(z)
        return 0.5 * (near - far)

    columns = box(points[:, :1] - np.arange(grid.shape[1]))
    rows = box(points[:, 1:] - np.arange(grid.shape[0]))
    return 1.0 + np.einsum("ni,ij,nj->n", rows, grid - 1.0, columns)


def known_only(space):
    """The function patterns, with light in place of everything else."""
    return np.where(space.known, space.values, 1).astype(np.float64)


def some(table, count, seed=0):
    """Indices of a few of a table's points."""
    return np.random.default_rng(seed).choice(len(table.points), count, replace=False)


# ---- profiles


@pytest.mark.parametrize("sigma", SIGMAS)
def test_profiles_sum_to_one_everywhere(sigma):
    at = np.linspace(-1.0, 1.0, 41)
    modules = np.arange(-12, 13)
    b, b1, b2 = (p.sum(axis=1) for p in profiles(at[:, None] - modules, sigma))
    np.testing.assert_allclose(b, 1.0, atol=1e-12)
    np.testing.assert_allclose(b1, 0.0, atol=1e-12)
    np.testing.assert_allclose(b2, 0.0, atol=1e-11)


@pytest.mark.parametrize("sigma", SIGMAS)
def test_slope_and_bend_match_central_differences(sigma):
    at = np.linspace(-2.5, 3.5, 61)
    _, b1, b2 = profiles(at, sigma)
    after, before = profiles(at + STEP, sigma), profiles(at - STEP, sigma)
    np.testing.assert_allclose(b1, (after[0] - before[0]) / (2 * STEP), atol=1e-6)
    np.testing.assert_allclose(b2, (after[1] - before[1]) / (2 * STEP), atol=1e-5)


def test_a_profile_is_even_about_its_middle_and_half_at_a_sharp_edge():
    at = np.linspace(0.0, 3.0, 31)
    b, b1, b2 = profiles(0.5 + at, 0.36)
    left, left1, left2 = profiles(0.5 - at, 0.36)
    np.testing.assert_allclose(b, left, atol=1e-14)
    np.testing.assert_allclose(b1, -left1, atol=1e-13)
    np.testing.assert_allclose(b2, left2, atol=1e-13)
    sharp = profiles(np.array([-0.5, 0.0, 0.5, 1.0, 1.5]), 0.02)[0]
    np.testing.assert_allclose(sharp, [0.0, 0.5, 1.0, 0.5, 0.0], atol=1e-12)


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_lattice_covers_symbol_and_quiet_zone_evenly(samples):
    axis = lattice(21, 3, samples)
    assert len(axis) == (21 + 2 * 3) * samples
    np.testing.assert_allclose(np.diff(axis), 1 / samples)
    assert axis[0] + 3 == pytest.approx(0.5 / samples)
    assert axis[0] + axis[-1] == pytest.approx(21.0)


# ---- pose tables


@pytest.mark.parametrize("space", [qr.space(1), qr.space(7), micro_qr.space("M3"), WIDE, TALL], ids=str)
@pytest.mark.parametrize("sigma", [0.36, 0.9])
def test_last_columns_are_the_slopes_of_the_rendered_model(space, sigma):
    table = pose_table(space, sigma, 2)
    few = some(table, 150)
    points, grid = table.points[few].astype(np.float64), known_only(space)
    for column, along in ((18, np.array([STEP, 0.0])), (19, np.array([0.0, STEP]))):
        slope = (rendered(grid, points + along, sigma) - rendered(grid, points - along, sigma)) / (2 * STEP)
        np.testing.assert_allclose(table.table[few, column], slope, atol=1e-5)


@pytest.mark.parametrize(
    ("space", "sigma"),
    [(qr.space(1), 0.36), (qr.space(2), 0.36), (qr.space(2), 0.9), (WIDE, 0.36), (TALL, 0.5)],
    ids=str,
)
@pytest.mark.parametrize("tilt", [False, True])
def test_the_other_columns_say_how_the_slopes_change_when_the_code_moves(space, sigma, tilt):
    """For a gain a, the change of a . grad L at points that move as each parameter of the pose says."""
    table = pose_table(space, sigma, 2)
    few = some(table, 120)
    points, grid = table.points[few].astype(np.float64), known_only(space)
    rows = table.table[few].astype(np.float64)
    off = points - table.centre
    u, v = (off / table.scale).T
    gain = np.array([0.7, -1.3])
    by_factor = np.stack([np.zeros(4), [gain[0]] * 4, [gain[1]] * 4, np.ones(4)])
    still, one = np.zeros_like(u), np.ones_like(u)
    moves = [(weight, still) for weight in (one, u, v)] + [(still, weight) for weight in (one, u, v)]
    if tilt:
        moves += [tuple((off / max(table.scale) * each[:, None]).T) for each in (u, v)]
    terms, factors = terms_of(tilt)
    assert len(terms) == len(moves) + 2

    def along_gain(at):
        h = 1e-3 * gain
        return (rendered(grid, at + h, sigma) - rendered(grid, at - h, sigma)) / 2e-3

    for move, columns, kinds in zip(moves, terms, factors, strict=False):
        column = (rows[:, columns] * by_factor[kinds, np.arange(4)]).sum(axis=1)
        step = 1e-3 * np.stack(move, axis=1)
        change = (along_gain(points + step) - along_gain(points - step)) / 2e-3
        # third derivatives are below 1.5 / sigma^3, and the steps 1e-3
        np.testing.assert_allclose(column, change, atol=2e-3)


@pytest.mark.parametrize("space", [*map(qr.space, (1, 2, 7, 14)), micro_qr.space("M4"), WIDE, TALL], ids=str)
def test_points_are_those_whose_footprint_is_known(space):
    """All lattice points more than half a module from any unknown module, and no others."""
    table = pose_table(space, 0.36, 2)
    across, down = lattices(space, 2)
    ring = quiet_modules(space) + 1
    known = np.pad(space.known, ring, constant_values=True)
    near_u, near_v = (
        [np.floor(axis + d).astype(int) + ring for d in (-0.49, 0.49)] for axis in (across, down)
    )
    all_known = np.logical_and.reduce([known[np.ix_(rows, columns)] for rows in near_v for columns in near_u])
    v, u = np.meshgrid(down, across, indexing="ij")
    expected = np.stack([u[all_known], v[all_known]], axis=1)
    np.testing.assert_allclose(table.points, expected, atol=1e-5)
    assert 0 < len(table.points) < u.size


def test_gram_is_the_product_of_the_table_with_itself():
    table = pose_table(qr.space(3), 0.36, 2)
    exact = table.table.astype(np.float64).T @ table.table.astype(np.float64)
    np.testing.assert_allclose(table.gram, exact, rtol=1e-4, atol=1e-4 * np.abs(exact).max())


def test_tables_are_shared_and_closed_for_writing():
    table = pose_table(qr.space(2), 0.36, 2)
    assert pose_table(qr.space(2), 0.36, 2) is table
    for array in (table.points, table.table, table.gram):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
