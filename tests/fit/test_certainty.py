"""The probability of each module: what it must be whatever the figures, and a simulated pass."""

import numpy as np
import pytest
from scenes import find, middle_us, motion_at, scene, window_of

from evqr.fit.certainty import LEVEL, dark, log_odds, unclear
from evqr.fit.detection import Detection
from evqr.simulate import PRESETS
from evqr.solver import Solver
from evqr.symbol.symbols import SYMBOLS, space_of
from evqr.symbology import Symbology


def test_every_symbology_has_a_level():
    assert LEVEL.keys() == SYMBOLS.keys()


@pytest.mark.parametrize("symbology", SYMBOLS)
def test_stronger_modules_and_better_windows_are_surer(symbology):
    space = space_of(symbology, list(SYMBOLS[symbology].sizes)[-1])
    q = np.random.default_rng(0).normal(0.0, 0.7, space.shape).astype(np.float32)
    q[space.known] = space.values[space.known]
    odds = log_odds(q, space, 20.0)
    free = ~space.known
    assert (odds[space.known] == np.inf * space.values[space.known]).all()
    np.testing.assert_allclose(log_odds(-q, space, 20.0)[free], -odds[free])
    order = np.argsort(q[free])
    assert (np.diff(odds[free][order]) >= 0.0).all()
    assert (np.abs(log_odds(q, space, 40.0)[free]) > np.abs(odds[free]))[q[free] != 0.0].all()
    p = dark(q, space, 20.0)
    assert p.dtype == np.float32 and (p[q < 0.0] > 0.5).all() and (p[q > 0.0] < 0.5).all()
    assert unclear(q, space) == pytest.approx((np.abs(q[free]) < 0.5).mean())


def test_as_many_modules_are_wrong_as_are_expected_to_be():
    """Of windows of a noisy sensor, each too short to be sure of all modules."""
    solver, expected, wrong, count = Solver(), 0.0, 0, 0
    for seed in range(3):
        passing = scene(preset=PRESETS["hard"], version=5, module_px=4.5, angle=20.0 + 50.0 * seed, seed=seed)
        truth, middle = passing.truth["truth"], middle_us(passing)
        window = window_of(passing, 1.0)
        found = find(solver, window, motion_at(truth, middle))
        assert isinstance(found, Detection)
        (estimate,) = solver.solve([found])
        free = ~found.space.known
        assert found.space.symbology is Symbology.QR_CODE
        p = dark(estimate.q, found.space, estimate.information)[free]
        expected += float(np.minimum(p, 1.0 - p).sum())
        wrong += int(((p > 0.5) != (truth["modules"][free] > 0)).sum())
        count += int(free.sum())
    assert wrong > 10 and abs(expected - wrong) < 0.02 * count
