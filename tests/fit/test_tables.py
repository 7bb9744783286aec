"""Tables of codes: what there is room for."""

import numpy as np
import pytest

from evqr.config import ModulesConfig
from evqr.fit.modules import NormalEquations, solve_modules
from evqr.symbol.symbols import SYMBOLS
from evqr.symbology import Symbology
from evqr.workspace import Workspace
from evqr_kernels import get_backend


@pytest.mark.parametrize("version", ["R7x43", "R11x27", "R17x139"])
def test_codes_lie_in_tables_with_all_that_is_solved_beside_them(version):
    """On NumPy, which refuses to read beyond the end of a row."""
    space = SYMBOLS[Symbology.RMQR_CODE].space(version)
    workspace = Workspace(get_backend("numpy"), "cpu")
    (estimate,) = solve_modules([NormalEquations.nothing(space)], ModulesConfig(), workspace=workspace)
    assert estimate.q.shape == space.known.shape
    np.testing.assert_allclose(estimate.q[space.known], space.values[space.known], atol=1e-6)
