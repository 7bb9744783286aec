"""Labels with many codes: all of them from one search in one window."""

import math

import numpy as np
import pytest
from scenes import find_all, window_of

from evqr.fit.detection import NotFound
from evqr.motion import Motion
from evqr.simulate import PRESETS, CodePlacement, simulate
from evqr.solver import Solver
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded

MODULE_PX, SPEED_PX_MS, DIRECTION = 3.6, 4.0, 30.0


def label(across, down):
    """Codes in rows and columns, each with a text of its own."""
    step = MODULE_PX * 29 + 8
    return tuple(
        CodePlacement(
            text=f"P{down * k + n:03d}", version=1, ec="M", module_px=MODULE_PX, angle=20.0,
            offset_px=((k - (across - 1) / 2) * step, (n - (down - 1) / 2) * step),
        )
        for k in range(across)
        for n in range(down)
    )  # fmt: skip


@pytest.mark.parametrize(("across", "down"), [(1, 1), (2, 2), (4, 4)])
def test_all_codes_of_a_label_are_found_in_one_search(across, down):
    codes = label(across, down)
    made = simulate(
        codes=codes, preset=PRESETS["clean"], speed_px_ms=SPEED_PX_MS, direction=DIRECTION, width=600,
        height=600, duration_us=1200, seed=3,
    )  # fmt: skip
    window, angle = window_of(made), math.radians(DIRECTION)
    velocity = 1e3 * SPEED_PX_MS * np.array([math.cos(angle), math.sin(angle)])
    solver = Solver()
    found = find_all(solver, window, Motion(velocity, window.middle_us))
    assert not isinstance(found, NotFound)
    outcomes = [
        decode_grid(each.q, code.space) for each, code in zip(solver.solve(found), found, strict=True)
    ]
    assert all(isinstance(outcome, Decoded) for outcome in outcomes)
    assert sorted(outcome.text for outcome in outcomes) == sorted(code.text for code in codes)
