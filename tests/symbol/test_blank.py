"""What is under a stain is erased, though its modules are as sure as others."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from evqr.simulate import CodePlacement
from evqr.simulate.printed import make_symbol
from evqr.symbol import qr_decode
from evqr.symbol.blank import REACH, printed_share
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded


def texts(share, seeds):
    """What noisy grids of a large symbol say, each with a stain of a share of its area somewhere."""
    symbol = make_symbol(CodePlacement(text="LOT 4711", version=7, ec="H"))
    v, u = np.indices(symbol.modules.shape)
    size, found = len(symbol.modules), []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        at_u, at_v = rng.uniform(0, size, 2)
        away = np.hypot(u - at_u, v - at_v)
        dark = np.where(away <= np.quantile(away, share), seed % 2, symbol.modules) > 0
        q = np.where(dark, -1.0, 1.0) * rng.uniform(0.6, 1.2, dark.shape) + rng.normal(0, 0.35, dark.shape)
        outcome = decode_grid(q, symbol.space, effort="full")
        found.append(outcome.payload.text if isinstance(outcome, Decoded) else None)
    return found


def test_a_fifth_of_a_code_is_under_a_stain(monkeypatch):
    assert texts(0.2, 8) == 8 * ["LOT 4711"]
    monkeypatch.setattr(qr_decode, "printed_share", np.ones_like)
    assert texts(0.2, 8).count(None) > 1


@given(rows=st.integers(8, 60), columns=st.integers(8, 60), seed=st.integers(0, 99))
def test_coins_are_print_and_blanks_are_none(rows, columns, seed):
    q = np.random.default_rng(seed).choice([-1.0, 1.0], (rows, columns))
    blank = q.copy()
    blank[: rows // 2] = 1.0
    share = printed_share(blank)
    assert printed_share(q).mean() > 0.98
    assert (share[: rows // 2 - REACH] == 0.0).all()
    assert (share >= 0.0).all() and (share <= 1.0).all()
    np.testing.assert_array_equal(printed_share(-blank), share)
    np.testing.assert_array_equal(printed_share(blank.T), share.T)
