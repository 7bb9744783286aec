"""Aztec codes are found by their bull's eyes, read as large and turned as their mode messages say."""

from dataclasses import replace

import numpy as np
import pytest
import zxingcpp
from scenes import at, find, middle_us, motion_at, scene, window_of

from evqr.config import ReadConfig
from evqr.events.window import make_window
from evqr.fit.detection import NotFound
from evqr.motion import Motion
from evqr.simulate.geometry import transform
from evqr.solver import Solver
from evqr.symbol import aztec
from evqr.symbol.decode import decode_grid
from evqr.symbology import Symbology


@pytest.fixture(scope="module")
def solver():
    return Solver(ReadConfig(symbologies=("qr", "microqr", "aztec")))


def made_of(version, **options):
    return scene("EVQR", symbology="aztec", version=version, module_px=5.0, **options)


def corners_of(space):
    return np.array([[0.0, 0.0], [space.columns, 0.0], [space.columns, space.rows], [0.0, space.rows]])


def text_of(solver, found):
    (estimate,) = solver.solve([found])
    return decode_grid(estimate.q, found.space).text


@pytest.mark.parametrize("version", ["C1", "C2", "C3", "C4", "F1", "F2", "F4", "F5", "F12"])
def test_the_mode_message_tells_size_and_direction(version):
    number = 1 + list(aztec.SIZES).index(version)
    barcode = zxingcpp.create_barcode("EVQR", zxingcpp.BarcodeFormat.Aztec, version=number)
    grid = np.where(np.array(barcode.to_image(scale=1, add_quiet_zones=False)) < 128, -1.0, 1.0)
    core = aztec.space(version[0])
    first = (len(grid) - core.rows) // 2
    for turned in (grid, np.rot90(grid), np.rot90(grid, 3).T, grid.T):
        part = turned[first : first + core.rows, first : first + core.rows]
        np.testing.assert_array_equal(part[core.known], core.values[core.known])
        space, to_part = aztec.shown(part, core)
        assert (space.symbology, space.version) == (Symbology.AZTEC, version)
        centres = np.indices(grid.shape)[::-1].reshape(2, -1).T + 0.5
        u, v = np.round(transform(to_part, centres) + first - 0.5).astype(int).T
        np.testing.assert_array_equal(turned[v, u], grid.ravel())
    assert aztec.shown(np.zeros(core.shape), core) is None


@pytest.mark.parametrize(
    ("version", "angle", "options"),
    [
        ("C3", 20.0, {}),
        ("C2", 140.0, {"invert": True}),
        ("C4", 250.0, {"preset": "fast"}),
        ("F1", 335.0, {}),
        ("F4", 65.0, {}),
    ],
)
def test_codes_are_found_and_read_from_one_window(version, angle, options, solver):
    made = made_of(version, angle=angle, **options)
    truth, window = made.truth["truth"], window_of(made)
    found = find(solver, window, motion_at(truth, window.middle_us))
    assert not isinstance(found, NotFound), found
    assert (found.space.symbology, found.space.version) == (Symbology.AZTEC, version)
    true = transform(at(truth, "H", middle_us(made)), corners_of(found.space))
    # what is known lies in the middle
    assert np.abs(found.target.outline() - true).max() < 5.0
    assert text_of(solver, found) == "EVQR"


def test_a_mirror_image_is_found_as_one(solver):
    made = made_of("C3", angle=20.0)
    across = made.events.width - 1
    flipped = replace(made.events, x=(across - made.events.x.astype(int)).astype(np.uint16))
    there = window_of(made)
    window = make_window(flipped, there.start_us, there.end_us)
    v_x, v_y = at(made.truth["truth"], "velocity", middle_us(made))
    found = find(solver, window, Motion([-v_x, v_y], window.middle_us))
    assert not isinstance(found, NotFound), found
    assert np.linalg.det(found.target.pose) < 0.0
    assert text_of(solver, found) == "EVQR"


@pytest.mark.parametrize("symbology", ["qr", "microqr"])
def test_finder_patterns_are_no_bulls_eyes(symbology, solver):
    made = scene("EVQR", symbology=symbology, version=2 if symbology == "qr" else "M3", ec="L")
    window = window_of(made)
    found = find(solver, window, motion_at(made.truth["truth"], window.middle_us))
    assert not isinstance(found, NotFound) and found.space.symbology is Symbology(symbology)
    assert text_of(solver, found) == "EVQR"
