"""Codes that turn: equations whose gain varies, and turntables at the speed that is promised."""

import numpy as np
import pytest
from scenes import middle_us, scene, true_corners, window_of

from evqr import ReadConfig, ReadStatus, read_codes, read_windows
from evqr.config import AlignConfig, ModulesConfig
from evqr.fit.affine_gain import samples_of, seen_through
from evqr.fit.align import fine_levels
from evqr.fit.detection import Target
from evqr.fit.model import lattices, profiles, quiet_modules
from evqr.fit.modules import NormalEquations, profile_products, solve_modules
from evqr.fit.turning import fit_turning
from evqr.fit.varying import apply_stencils, gain_at, right_hand_side, stencils
from evqr.motion import Motion
from evqr.search.quarters import turns
from evqr.symbol import qr

MODULES, ALIGN = ModulesConfig(), AlignConfig()
SPACE = qr.space(1)
RATE, RADIUS = 6.0, 60.0
"""Of the turntable [degrees/ms], [px]."""


def equations_of(gain, space, e):
    each = MODULES.samples
    products = profile_products(ALIGN.sigma, each)
    return NormalEquations(
        space, stencils(gain, products, space), right_hand_side(e, gain, space, ALIGN.sigma, each)
    )


def image_of(space, seed):
    across, down = lattices(space, MODULES.samples)
    return np.random.default_rng(seed).normal(0.0, 1.0, (len(down), len(across)))


def test_a_gain_that_is_the_same_everywhere_gives_the_usual_equations(workspace):
    gain = np.array([[1.3, 0.0, 0.0], [-0.7, 0.0, 0.0]])
    varying = equations_of(gain, SPACE, image_of(SPACE, 1)).scaled(20.0)
    alike = NormalEquations(SPACE, varying.stencil[:, :, 3, 4].astype(np.float32), varying.rhs.astype("f"))
    np.testing.assert_allclose(varying.stencil - alike.stencil[..., None, None], 0.0, atol=1e-5)
    ours, usual = solve_modules([varying, alike], MODULES, workspace=workspace)
    np.testing.assert_allclose(ours.q, usual.q, atol=0.02)
    both = alike + varying
    assert both.varies
    np.testing.assert_allclose(both.stencil, 2.0 * varying.stencil, rtol=1e-5, atol=1e-5)


def test_the_normal_matrix_is_symmetric_and_that_of_the_right_hand_side():
    """<x, N y> = <N x, y>, <x, N x> >= 0, and N x is A^T (A x) but for what the gain changes on a module."""
    gain = np.array([[0.6, 0.5, -0.3], [0.2, -0.4, 0.8]])
    rng = np.random.default_rng(0)
    stencil = stencils(gain, profile_products(ALIGN.sigma, MODULES.samples), SPACE)
    x, y = rng.normal(0.0, 1.0, (2, *stencil.shape[2:]))
    assert (x * apply_stencils(stencil, y)).sum() == pytest.approx((apply_stencils(stencil, x) * y).sum())
    assert (x * apply_stencils(stencil, x)).sum() > 0.0
    across, down = lattices(SPACE, MODULES.samples)
    quiet = quiet_modules(SPACE)
    (b_u, s_u), (b_v, s_v) = (
        [f(axis[:, None] - (np.arange(n + 2 * quiet) - quiet)) for f in (_profile, _slope)]
        for axis, n in ((across, SPACE.columns), (down, SPACE.rows))
    )
    a_u, a_v = gain_at(gain, SPACE, *np.meshgrid(across, down))
    seen = a_u * (b_v @ x @ s_u.T) + a_v * (s_v @ x @ b_u.T)
    back = right_hand_side(seen, gain, SPACE, ALIGN.sigma, MODULES.samples)
    inside = np.s_[3:-3, 3:-3]
    off = (apply_stencils(stencil, x) - back)[inside]
    assert np.sqrt(np.square(off).mean()) < 0.05 * np.sqrt(np.square(back[inside]).mean())


def test_the_step_of_gauss_newton_is_how_what_is_seen_changes_with_the_place():
    """Central differences: an image of the model itself, sampled a little aside, changes by -G."""
    (level,) = fine_levels(ALIGN)
    samples, gain = samples_of(SPACE, level), np.array([[0.6, 0.0, 0.0], [0.2, 0.0, 0.0]])
    cells = 16  # a module
    sides = [(n + 6) * cells for n in SPACE.shape]
    at = (np.arange(sides[0]) + 0.5) / cells - 3.0
    b, slope = (f(at[:, None] - np.arange(SPACE.rows)) for f in (_profile, _slope))
    q = np.where(SPACE.known, SPACE.values - 1.0, 0.0)
    image = -(gain[0, 0] * (b @ q @ slope.T) + gain[1, 0] * (slope @ q @ b.T))
    pose = np.array([[cells, 0.0, 3 * cells - 0.5], [0.0, cells, 3 * cells - 0.5], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(seen_through(pose, image, samples.points), samples.model(gain), atol=0.03)
    for way, bent in zip(np.eye(2), samples.bent(gain), strict=True):
        ahead, behind = (seen_through(pose, image, samples.points + s * 0.1 * way) for s in (1.0, -1.0))
        change = (ahead - behind) / 0.2
        assert np.corrcoef(change, -bent)[0, 1] > 0.99


def _profile(offset):
    return profiles(offset, ALIGN.sigma)[0]


def _slope(offset):
    return profiles(offset, ALIGN.sigma)[1]


@pytest.fixture(scope="module")
def turntable():
    return scene(
        turn_radius_px=RADIUS, speed_px_ms=RADIUS * np.deg2rad(RATE), travel_px=12.0, module_px=4.4,
        width=280, height=240, ec="H", preset="fast",
    )  # fmt: skip


def test_what_a_turntable_carries_is_read_in_windows_alone_and_whole(turntable):
    windows = list(read_windows(turntable.events, config=ReadConfig(max_windows=3)))
    assert sum(window.status is ReadStatus.READ for window in windows) >= 2
    assert {window.text for window in windows} <= {"EVQR-07", None}
    assert [reading.text for reading in read_codes(turntable.events).readings] == ["EVQR-07"]


def test_the_motion_of_a_turntable_and_where_its_code_is(turntable, workspace):
    truth, window = turntable.truth["truth"], window_of(turntable)
    assert turns(window, ReadConfig().motion, workspace=workspace)
    k = int(np.argmin(abs(truth["t_us"] - middle_us(turntable))))
    target = Target(qr.space(2), truth["H"][k], Motion(truth["velocity"][k], float(truth["t_us"][k])))
    found = fit_turning(window, target, ReadConfig())
    assert found is not None
    assert found.score > 0.9
    curl = np.rad2deg(found.motion.slope[1, 0] - found.motion.slope[0, 1]) / 2e3
    assert curl == pytest.approx(RATE, rel=0.25)
    off = found.target.outline() - true_corners(truth, window.middle_us)
    assert np.abs(off).max() < 3.0  # the pixels lag


def test_what_moves_straight_does_not_turn(workspace):
    straight = scene(ec="H", preset="fast")
    assert not turns(window_of(straight), ReadConfig().motion, workspace=workspace)
