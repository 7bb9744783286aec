"""Matched filters for finder patterns: what they are mixed from."""

import numpy as np
import pytest

from evqr.config import FinderConfig
from evqr.search.templates import ANGLES, TERMS, _template_gradients, bank_along

CFG = FinderConfig()


@pytest.mark.parametrize("degrees", [0, 17, 45, 90, 133, -70])
def test_few_terms_make_all_templates(degrees):
    basis, mix = bank_along(degrees, CFG)
    gradients, _ = _template_gradients(CFG.cells_a_module, CFG.half)
    along = np.deg2rad(degrees)
    bank = -(np.cos(along) * gradients[0] + np.sin(along) * gradients[1])
    bank /= np.sqrt(np.square(bank).sum(axis=(0, 1)))
    left = np.square(bank - np.einsum("yxt,at->yxa", basis, mix)).sum(axis=(0, 1))
    assert left.mean() < 0.007 and left.max() < 0.009
    # no five others would do better
    flat = bank.reshape(-1, ANGLES)
    rest = np.linalg.svd(flat, compute_uv=False)[TERMS:]
    assert left.mean() < 1.01 * np.square(rest).mean() * len(rest) / ANGLES


def test_the_terms_are_orthonormal_so_that_no_template_answers_more_than_they_do():
    basis, mix = bank_along(33, CFG)
    flat = basis.reshape(-1, TERMS)
    np.testing.assert_allclose(flat.T @ flat, np.eye(TERMS), atol=1e-12)
    assert (np.square(mix).sum(axis=1) <= 1.0).all()
