"""Votes: what several windows of one code say together."""

import dense
import numpy as np
import pytest
from scenes import middle_us, moved, scene
from steps import normal_equations, solved

from evqr.config import AlignConfig, ModulesConfig, Vote
from evqr.fit.align import align, fine_levels
from evqr.fit.fusion import MOST_GROUPS, Fusion, misfit
from evqr.fit.modules import solve_modules
from evqr.symbol import qr
from evqr.workspace import Images

ONE = AlignConfig()
CONFIG = ModulesConfig()
EXACT = ModulesConfig(passes=1, damping_range=(0.1, 0.1), tolerance=1e-6, max_iterations=500)
UNKNOWN = ~qr.space(2).known


@pytest.fixture(scope="module")
def windows(workspace, see):
    """Three windows one after another of one code: what is seen, and the gain at the true pose."""
    made = scene()
    found = []
    for late in (-500, 0, 500):
        seen = see(made, middle=middle_us(made) + late)
        at_truth = align(
            seen.image,
            seen.in_cells[None],
            seen.space,
            fine_levels(ONE),
            ONE,
            workspace=workspace,
            max_iterations=0,
        )
        found.append((seen, at_truth.gain[0]))
    return found


def equations(seen, gain, workspace, *, noise=0.0, rng=None):
    """Equations of a window with white noise on its image."""
    image = workspace.get(seen.image.device)
    if noise:
        image = image + rng.normal(0.0, noise, image.shape).astype(np.float32)
    return normal_equations(
        Images(workspace.put(image)), seen.in_cells, gain, seen.space, ONE.sigma, CONFIG, workspace=workspace
    )


def wrong(q, seen):
    """Share of the unknown modules with the wrong sign."""
    return float(np.mean((q * seen.modules <= 0.0)[UNKNOWN]))


# ---- information


def test_information_of_two_windows_is_the_dense_solution_of_both(windows, workspace):
    noise = (0.5, 2.0)
    fusion = Fusion(Vote.INFORMATION, EXACT, workspace=workspace)
    systems = []
    for (seen, gain), variance in zip(windows[:2], noise, strict=True):
        estimate = fusion.add(equations(seen, gain, workspace), variance)
        image = workspace.get(seen.image.device)[0]
        systems.append(
            (*dense.system(image, seen.in_cells, gain, seen.space, ONE.sigma, CONFIG.samples), 1.0 / variance)
        )
    space = qr.space(2)
    exact = dense.solve(systems, space.known, space.values, EXACT.damping_range[0])
    np.testing.assert_allclose(estimate.q, exact, atol=0.015)  # the tolerance of test_stage_two.py
    assert fusion.windows == 2


def test_a_window_counts_by_one_over_its_noise(windows, workspace):
    """A worthless window with a huge variance changes nothing; with a small one it spoils all."""
    (seen, gain), (other, other_gain) = windows[0], windows[1]
    good, bad = equations(seen, gain, workspace), equations(other, -other_gain, workspace)
    alone = Fusion(Vote.INFORMATION, CONFIG, workspace=workspace).add(good, 1.0).q
    for variance, spoiled in ((1e9, False), (1e-9, True)):
        fusion = Fusion(Vote.INFORMATION, CONFIG, workspace=workspace)
        fusion.add(good, 1.0)
        q = fusion.add(bad, variance).q
        assert (np.abs(q - alone).max() > 0.5) == spoiled


# ---- mode and soft


def test_mode_is_the_majority_of_signs(windows, workspace):
    seen, gain = windows[0]
    right = equations(seen, gain, workspace)
    wrong_sign = equations(seen, -gain, workspace)
    alone = [np.sign(solved(e, CONFIG, workspace=workspace).q) for e in (right, wrong_sign)]
    fusion = Fusion(Vote.MODE, CONFIG, workspace=workspace)
    for window in (right, wrong_sign, right):
        estimate = fusion.add(window, 1.0)
    np.testing.assert_array_equal(np.sign(estimate.q), alone[0])
    np.testing.assert_allclose(estimate.q[UNKNOWN], ((2 * alone[0] + alone[1]) / 3)[UNKNOWN], atol=1e-6)


def test_mode_does_not_care_how_sure_a_window_is(windows, workspace):
    seen, gain = windows[0]
    said = []
    for variance in (1.0, 1e-6):
        fusion = Fusion(Vote.MODE, CONFIG, workspace=workspace)
        fusion.add(equations(*windows[1], workspace), 1.0)
        said.append(fusion.add(equations(seen, -gain, workspace), variance).q)
    np.testing.assert_array_equal(*said)


def test_soft_weighs_windows_by_their_information(windows, workspace):
    good = equations(*windows[0], workspace)
    seen, gain = windows[1]
    bad = equations(seen, -gain, workspace)
    alone = solved(good, CONFIG, workspace=workspace).q
    for variance, follows in ((1e6, True), (1e-6, False)):
        fusion = Fusion(Vote.SOFT, CONFIG, workspace=workspace)
        fusion.add(good, 1.0)
        q = fusion.add(bad, variance).q
        agree = np.mean(np.sign(q[UNKNOWN]) == np.sign(alone[UNKNOWN]))
        assert (agree > 0.99) == follows


def test_soft_of_equal_windows_is_each_of_them(windows, workspace):
    one = equations(*windows[0], workspace)
    alone = solved(one.weighted(2.0), CONFIG, workspace=workspace).q
    fusion = Fusion(Vote.SOFT, CONFIG, workspace=workspace)
    for _ in range(3):
        q = fusion.add(one, 2.0).q
    np.testing.assert_allclose(q / np.abs(q).max(), alone / np.abs(alone).max(), atol=1e-5)


# ---- windows that do not agree


def off_by_a_module(seen, gain, workspace):
    """Equations of a window whose pose is wrong."""
    cells = moved(seen.in_cells, 25, shift=(1.0, 0.0))
    return normal_equations(seen.image, cells, gain, seen.space, ONE.sigma, CONFIG, workspace=workspace)


@pytest.mark.parametrize("vote", Vote)
@pytest.mark.parametrize("at", [0, 1, 2])
def test_a_wrong_pose_in_one_window_leaves_those_that_agree(vote, at, windows, workspace):
    fusion, last = Fusion(vote, CONFIG, workspace=workspace), None
    for k, (seen, gain) in enumerate(windows):
        made = off_by_a_module if k == at else equations
        fusion.add(made(seen, gain, workspace), 1.0)
        last = [(wrong(estimate.q, seen), count) for estimate, count in fusion.others()]
    assert fusion.windows == 3
    if at == 2:  # the newest window is the wrong one, and agrees with none
        assert [count for _, count in last] == [1]
        assert last[0][0] > 0.1
    else:
        assert [count for _, count in last] == [2, 1]
        assert [share for share, _ in last] == [0.0, 0.0]


def test_windows_that_agree_leave_nothing_to_try_but_the_newest_alone(windows, workspace):
    fusion = Fusion(Vote.INFORMATION, CONFIG, workspace=workspace)
    counts = []
    for seen, gain in windows:
        fusion.add(equations(seen, gain, workspace), 1.0)
        counts.append([count for _, count in fusion.others()])
    assert counts == [[], [1], [1]]


def test_windows_are_compared_only_when_others_are_asked_for(windows, workspace, monkeypatch):
    calls = []

    def counted(*args, **options):
        calls.append(args)
        return solve_modules(*args, **options)

    monkeypatch.setattr("evqr.fit.fusion.solve_modules", counted)
    fusion = Fusion(Vote.INFORMATION, CONFIG, workspace=workspace)
    for seen, gain in windows:
        fusion.add(equations(seen, gain, workspace), 1.0)
    assert len(calls) == 3


def test_groups_are_no_more_than_a_few(windows, workspace):
    seen, gain = windows[0]
    rng = np.random.default_rng(0)
    fusion = Fusion(Vote.INFORMATION, CONFIG, workspace=workspace)
    for _ in range(MOST_GROUPS + 3):
        values = rng.normal(0.0, 30.0, workspace.get(seen.image.device).shape)
        image = Images(workspace.put(values.astype(np.float32)))
        noise = normal_equations(
            image, seen.in_cells, gain, seen.space, ONE.sigma, CONFIG, workspace=workspace
        )
        fusion.add(noise, 1e-3)
        assert [count for _, count in fusion.others()] in ([], [1])
    assert len(fusion._groups) == MOST_GROUPS


def test_misfit_is_one_where_noise_alone_is_left(windows, workspace):
    seen, gain = windows[0]
    rng = np.random.default_rng(0)
    shape = workspace.get(seen.image.device).shape
    white = Images(workspace.put(rng.normal(0.0, 3.0, shape).astype(np.float32)))
    noise = normal_equations(white, seen.in_cells, gain, seen.space, ONE.sigma, CONFIG, workspace=workspace)
    light = np.ones((25, 25), np.float32)
    base = misfit(noise.weighted(9.0), light)
    assert misfit(noise.weighted(9.0 * base), light) == pytest.approx(1.0)
    right = equations(seen, gain, workspace)
    modules = seen.modules.astype(np.float32)
    assert misfit(right, modules) < 0.1 * misfit(right, -modules)


# ---- all of them


@pytest.mark.parametrize("vote", Vote)
def test_one_clean_window_is_enough(vote, windows, workspace):
    seen, gain = windows[0]
    fusion = Fusion(vote, CONFIG, workspace=workspace)
    estimate = fusion.add(equations(seen, gain, workspace), 1.0)
    assert wrong(estimate.q, seen) == 0.0
    assert estimate.q.shape == (25, 25)
    assert estimate.q.dtype == np.float32
    assert fusion.windows == 1


@pytest.mark.parametrize("vote", Vote)
def test_many_noisy_windows_beat_one(vote, windows, workspace):
    """Noise is set such that one window has about a tenth of its modules wrong."""
    rng = np.random.default_rng(4)
    fusion = Fusion(vote, CONFIG, workspace=workspace)
    share = []
    for k in range(15):
        seen, gain = windows[k % 3]
        share.append(wrong(fusion.add(equations(seen, gain, workspace, noise=14.0, rng=rng), 1.0).q, seen))
    assert 0.03 < share[0] < 0.3
    assert share[-1] < 0.4 * share[0]


def test_information_is_at_least_as_good_as_the_other_votes(windows, workspace):
    share = dict.fromkeys(Vote, 0.0)
    for vote in Vote:
        rng = np.random.default_rng(9)
        for _ in range(4):
            fusion = Fusion(vote, CONFIG, workspace=workspace)
            for seen, gain in windows:
                estimate = fusion.add(equations(seen, gain, workspace, noise=14.0, rng=rng), 1.0)
            share[vote] += wrong(estimate.q, seen)
    assert share[Vote.INFORMATION] <= min(share.values()) + 0.01


@pytest.mark.parametrize("vote", Vote)
def test_the_strength_of_an_estimate_says_where_it_is_right(vote, windows, workspace):
    """What the decoder erases by: wrong modules are weaker than right ones."""
    rng = np.random.default_rng(2)
    fusion = Fusion(vote, CONFIG, workspace=workspace)
    for seen, gain in windows:
        q = fusion.add(equations(seen, gain, workspace, noise=14.0, rng=rng), 1.0).q
    off = (q * seen.modules <= 0.0) & UNKNOWN
    assert off.any()
    assert np.abs(q[off]).mean() < 0.8 * np.abs(q[UNKNOWN & ~off]).mean()
