"""Stage two: the same modules as a dense least-squares solution, and the true ones."""

from dataclasses import replace

import dense
import numpy as np
import pytest
from rectangles import TALL, WIDE
from scenes import scene
from steps import normal_equations, solved

from evqr.config import AlignConfig, ModulesConfig
from evqr.fit.align import align, fine_levels
from evqr.fit.modules import NormalEquations
from evqr.symbol import micro_qr, qr
from evqr.workspace import Images

ONE = AlignConfig()
CONFIG = ModulesConfig()
EXACT = ModulesConfig(passes=1, damping_range=(0.1, 0.1), tolerance=1e-6, max_iterations=500)

TOLERANCE = 0.01
"""Relative to the strongest module.  The stencil ends two modules away; the entries left out are 1e-4."""


def gain_of(seen, workspace):
    """Gain at the true pose."""
    at_truth = align(
        seen.image,
        seen.in_cells[None],
        seen.space,
        fine_levels(ONE),
        ONE,
        workspace=workspace,
        max_iterations=0,
    )
    return at_truth.gain[0]


def equations_of(seen, workspace, *, cfg=CONFIG, image=None, gain=None):
    return normal_equations(
        seen.image if image is None else image,
        seen.in_cells,
        gain_of(seen, workspace) if gain is None else gain,
        seen.space,
        ONE.sigma,
        cfg,
        workspace=workspace,
    )


def random_window(space, seed, workspace):
    """An image without meaning, a pose that turns and tilts, a gain."""
    rng = np.random.default_rng(seed)
    image = rng.normal(0.0, 1.0, (1, 80, 96)).astype(np.float32)
    turn, scale = rng.uniform(0.0, 6.0), 40.0 / space.size
    c, s = scale * np.cos(turn), scale * np.sin(turn)
    u, v = space.columns / 2, space.rows / 2
    pose = np.array([[c, -s, 48 - c * u + s * v], [s, c, 40 - s * u - c * v], [2e-4, -1e-4, 1.0]])
    return Images(workspace.put(image)), image[0], pose, rng.normal(0.0, 1.0, 2)


# ---- against the dense solution


@pytest.mark.parametrize("space", [qr.space(1), qr.space(2), micro_qr.space("M2"), WIDE, TALL], ids=str)
@pytest.mark.parametrize("samples", [2, 3])
def test_equals_the_dense_solution_for_any_image_pose_and_gain(space, samples, workspace):
    cfg = replace(EXACT, samples=samples)
    for seed in range(3):
        on_device, image, pose, gain = random_window(space, seed, workspace)
        equations = normal_equations(on_device, pose, gain, space, ONE.sigma, cfg, workspace=workspace)
        found = solved(equations, cfg, workspace=workspace).q
        matrix, vector = dense.system(image, pose, gain, space, ONE.sigma, samples)
        exact = dense.solve([(matrix, vector, 1.0)], space.known, space.values, cfg.damping_range[0])
        np.testing.assert_allclose(found, exact, atol=TOLERANCE * max(1.0, np.abs(exact).max()))


def test_the_right_hand_side_is_that_of_the_dense_system(workspace):
    on_device, image, pose, gain = random_window(qr.space(1), 7, workspace)
    equations = normal_equations(on_device, pose, gain, qr.space(1), ONE.sigma, CONFIG, workspace=workspace)
    matrix, vector = dense.system(image, pose, gain, qr.space(1), ONE.sigma, CONFIG.samples)
    exact = (matrix.T @ vector).reshape(21, 21)
    inner = slice(3, -3)
    shown = equations.rhs[inner, inner]
    np.testing.assert_allclose(shown, exact, atol=1e-4 * np.abs(exact).max())


def test_the_stencil_is_a_row_of_the_dense_matrix(workspace):
    on_device, image, pose, gain = random_window(qr.space(1), 8, workspace)
    equations = normal_equations(on_device, pose, gain, qr.space(1), ONE.sigma, CONFIG, workspace=workspace)
    matrix, _ = dense.system(image, pose, gain, qr.space(1), ONE.sigma, CONFIG.samples)
    row = (matrix.T @ matrix)[10 * 21 + 10].reshape(21, 21)
    np.testing.assert_allclose(equations.stencil, row[8:13, 8:13], atol=1e-4 * row.max())
    row[8:13, 8:13] = 0.0
    assert np.abs(row).max() < 3e-4 * equations.stencil.max()


def test_the_usual_accuracy_is_enough(workspace, see):
    """Conjugate gradients stop early; what they leave is small against the modules, and turns none over."""
    equations = equations_of(see(scene()), workspace)
    usual = replace(EXACT, tolerance=CONFIG.tolerance)
    early, exact = (solved(equations, cfg, workspace=workspace) for cfg in (usual, EXACT))
    np.testing.assert_array_equal(np.sign(early.q), np.sign(exact.q))
    assert np.abs(early.q - exact.q).mean() < 0.05
    assert 0 < early.iterations < exact.iterations <= 200


# ---- modules of a real window


@pytest.mark.parametrize(
    ("options", "wrong"),
    [
        ({"angle": 0.0, "direction": 0.0}, 0.0),
        ({"angle": 45.0, "direction": 0.0}, 0.0),
        ({"angle": 45.0, "direction": 45.0}, 0.0),
        ({"angle": 20.0, "direction": 35.0, "invert": True}, 0.0),
        ({"version": 4, "module_px": 4.0}, 0.0),
        # lags are not undone here
        ({"preset": "fast", "angle": 0.0, "direction": 0.0}, 0.05),
    ],
    ids=["0", "45", "45-along", "inverted", "4", "fast"],
)
def test_modules_are_right_at_the_true_pose(options, wrong, workspace, see):
    """At 0 degrees edges along the motion give no event: those modules follow from their neighbours."""
    seen = see(scene(**options))
    q = solved(equations_of(seen, workspace), CONFIG, workspace=workspace).q
    unknown = ~seen.space.known
    assert np.mean((q * seen.modules < 0.0)[unknown]) <= wrong
    assert 0.5 < np.median(np.abs(q[unknown])) < 1.5


def test_known_modules_keep_their_values(workspace, see):
    seen = see(scene())
    estimate = solved(equations_of(seen, workspace), CONFIG, workspace=workspace)
    space = qr.space(2)
    np.testing.assert_allclose(estimate.q[space.known], space.values[space.known], atol=1e-6)
    assert estimate.q.shape == (25, 25)
    assert estimate.q.dtype == np.float32


def test_without_events_the_unknown_modules_are_grey(workspace, see):
    seen = see(scene())
    empty = Images(workspace.put(np.zeros_like(workspace.get(seen.image.device))))
    strong = normal_equations(
        empty, seen.in_cells, np.array([1e-6, 0.0]), seen.space, ONE.sigma, CONFIG, workspace=workspace
    )
    estimate = solved(
        NormalEquations(seen.space, 0 * strong.stencil, 0 * strong.rhs), CONFIG, workspace=workspace
    )
    np.testing.assert_allclose(estimate.q[~qr.space(2).known], 0.0, atol=1e-4)


# ---- invariances


def test_contrast_does_not_matter(workspace, see):
    """Twice the events with twice the gain, and twice the noise, are the same print."""
    seen = see(scene())
    gain = gain_of(seen, workspace)
    plain = solved(equations_of(seen, workspace, gain=gain), CONFIG, workspace=workspace).q
    for factor in (1e-3, 0.3, 40.0):
        image = Images(workspace.put(np.float32(factor) * workspace.get(seen.image.device)))
        other = equations_of(seen, workspace, image=image, gain=factor * gain).weighted(factor**2)
        np.testing.assert_allclose(solved(other, CONFIG, workspace=workspace).q, plain, atol=1e-3)


def test_less_noise_means_less_damping_within_bounds(workspace, see):
    """Weights say how far events are trusted against what is known before; at the ends they do not matter."""
    equations = equations_of(see(scene()), workspace)
    one_pass = replace(CONFIG, passes=1)
    each = [
        solved(equations.weighted(noise), one_pass, workspace=workspace).q
        for noise in (1e-12, 1e-9, 1e9, 1e12)
    ]
    np.testing.assert_allclose(each[1], each[0], atol=1e-3)
    np.testing.assert_allclose(each[3], each[2], atol=1e-3)
    unknown = ~qr.space(2).known
    assert np.abs(each[0][unknown]).mean() > 1.2 * np.abs(each[3][unknown]).mean()


# ---- passes


def _row_of_runs():
    """Equations of a code that moves along its rows, without noise: long dark runs between light modules."""
    space = qr.space(2)
    rng = np.random.default_rng(5)
    modules = np.where(rng.random((25, 25)) < 0.5, -1, 1)
    modules[10] = [-1 if c == "#" else 1 for c in "#.#.#######.#######.####."]
    modules = np.where(space.known, space.values, modules)
    stencil = np.zeros((5, 5))
    stencil[1:4, 1:4] = np.outer((0.25, 1.0, 0.25), (-0.5, 1.0, -0.5))
    field = np.zeros((31, 31))
    field[3:28, 3:28] = modules - 1.0
    padded = np.pad(field, 2)
    product = np.sum(
        [stencil[k, m] * padded[k : k + 31, m : m + 31] for k in range(5) for m in range(5)], axis=0
    )
    return NormalEquations(space, stencil, -product), modules


def test_a_later_pass_finds_the_inside_of_a_long_dark_run(workspace):
    """Only the ends of a run cause events where a code moves along its rows: the pull to grey wins inside."""
    equations, modules = _row_of_runs()
    strong = replace(CONFIG, damping_range=(0.1, 0.1))
    one, all_passes = (
        solved(equations, cfg, workspace=workspace)
        for cfg in (replace(strong, passes=1), replace(strong, passes=6, unclear=0.0))
    )
    assert (one.q[10] * modules[10] < 0.3).any()
    assert (all_passes.q * modules > 0.3).all()
    assert all_passes.iterations > one.iterations


def test_one_pass_is_enough_where_all_modules_are_clear(workspace, see):
    seen = see(scene(angle=45.0, direction=0.0))
    equations = equations_of(seen, workspace).weighted(1e-9)
    several, one = (
        solved(equations, cfg, workspace=workspace) for cfg in (CONFIG, replace(CONFIG, passes=1))
    )
    assert several.iterations == one.iterations
    np.testing.assert_array_equal(several.q, one.q)


def test_polarity_and_gain_of_the_other_sign_are_the_same_print(workspace, see):
    seen = see(scene())
    gain = gain_of(seen, workspace)
    negative = Images(workspace.put(-workspace.get(seen.image.device)))
    one, two = (
        solved(equations, CONFIG, workspace=workspace).q
        for equations in (
            equations_of(seen, workspace, gain=gain),
            equations_of(seen, workspace, image=negative, gain=-gain),
        )
    )
    np.testing.assert_allclose(one, two, atol=1e-5)


# ---- sums


def test_equations_add(workspace):
    parts = []
    for seed in (1, 2):
        on_device, _, pose, gain = random_window(qr.space(1), seed, workspace)
        parts.append(
            normal_equations(on_device, pose, gain, qr.space(1), ONE.sigma, CONFIG, workspace=workspace)
        )
    total = parts[0] + parts[1]
    np.testing.assert_array_equal(total.rhs, parts[0].rhs + parts[1].rhs)
    np.testing.assert_array_equal(total.stencil, parts[0].stencil + parts[1].stencil)
    assert total.space is qr.space(1)


def test_a_later_window_leaves_earlier_equations_alone(workspace, see):
    """Equations own their numbers: buffers are used again."""
    seen, other = see(scene()), see(scene(preset="fast"))
    first = equations_of(seen, workspace)
    rhs, stencil = first.rhs.copy(), first.stencil.copy()
    estimate = solved(first, CONFIG, workspace=workspace).q
    kept = estimate.copy()
    solved(equations_of(other, workspace), CONFIG, workspace=workspace)
    np.testing.assert_array_equal(first.rhs, rhs)
    np.testing.assert_array_equal(first.stencil, stencil)
    np.testing.assert_array_equal(estimate, kept)


@pytest.mark.parametrize(
    "wrong",
    [{"passes": 0}, {"damping_range": (0.5, 0.04)}, {"certainty": 0.9}, {"certainty": np.inf}],
    ids=str,
)
def test_settings_that_mean_nothing_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ModulesConfig(**wrong)
