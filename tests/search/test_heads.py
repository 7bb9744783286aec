"""rMQR codes are found by their heads: every height, at any angle, mirrored, inverted; and only if asked."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import at, find, middle_us, motion_at, scene, window_of

from evqr.config import ReadConfig
from evqr.events.window import make_window
from evqr.fit.detection import NotFound
from evqr.geometry import compose
from evqr.motion import Motion
from evqr.search.models import heads, sizes
from evqr.simulate.geometry import transform
from evqr.solver import Solver
from evqr.symbol import rmqr
from evqr.symbol.decode import decode_grid
from evqr.symbology import Symbology

RMQR = ReadConfig(symbologies=("qr", "microqr", "rmqr"))


def test_a_head_is_what_sizes_of_a_height_have_in_common():
    assert len(heads()) == 6 and sum(map(len, heads().values())) == 32
    for head, which in heads().items():
        begun = rmqr.space(sizes()[head].version)
        for k in which:
            whole = rmqr.space(sizes()[k].version)
            assert whole.rows == begun.rows and whole.columns > begun.columns
            np.testing.assert_array_equal(whole.values[:, : begun.columns], begun.values)


def test_what_is_searched_has_sizes():
    assert {size.symbology for size in sizes()} == set(Symbology)


@pytest.fixture(scope="module")
def solver():
    return Solver(RMQR)


def text_of(solver, found):
    """What one window says."""
    (estimate,) = solver.solve([found])
    return decode_grid(estimate.q, found.space).text


def made_of(version, **options):
    return scene("DEV 8", symbology="rmqr", version=version, module_px=4.0, width=384, height=288, **options)


@pytest.mark.parametrize(
    ("version", "angle"),
    [
        ("R7x43", 20.0),
        ("R9x59", 160.0),
        ("R11x27", 250.0),
        ("R13x43", 335.0),
        ("R15x43", 0.0),
        ("R17x59", 95.0),
    ],
)
def test_every_height_is_found_and_read_from_one_window(version, angle, solver):
    made = made_of(version, angle=angle, invert=angle == 95.0)
    truth, window = made.truth["truth"], window_of(made)
    found = find(solver, window, motion_at(truth, window.middle_us))
    assert not isinstance(found, NotFound), found
    assert (found.space.symbology, found.space.version) == (Symbology.RMQR_CODE, version)
    rows, columns = found.space.shape
    outline = np.array([[0.0, 0.0], [columns, 0.0], [columns, rows], [0.0, rows]])
    true = transform(at(truth, "H", middle_us(made)), outline)
    assert np.abs(found.target.outline() - true).max() < 2.0
    assert text_of(solver, found) == "DEV 8"


def test_a_mirror_image_is_found_as_one(solver):
    """A rectangle's pose says that it is mirrored."""
    made = made_of("R11x43")
    events = made.events
    across = events.width - 1
    flipped = replace(events, x=(across - events.x.astype(int)).astype(np.uint16))
    truth, middle = made.truth["truth"], middle_us(made)
    there = window_of(made)
    window = make_window(flipped, there.start_us, there.end_us)
    v_x, v_y = at(truth, "velocity", middle)
    found = find(solver, window, Motion([-v_x, v_y], window.middle_us))
    assert not isinstance(found, NotFound), found
    mirror = np.array([[-1.0, 0.0, across], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    true = transform(compose(mirror, at(truth, "H", middle)), np.array([[0.0, 0.0], [43.0, 11.0]]))
    assert np.abs(found.target.outline()[[0, 2]] - true).max() < 2.0
    assert np.linalg.det(found.target.pose) < 0.0
    assert text_of(solver, found) == "DEV 8"


def test_only_what_is_asked_for_is_found(solver):
    """What is not may look like something else, but is never found as what it is."""
    for made, kind in ((made_of("R13x43", angle=335.0), "rmqr"), (scene(), "qr")):
        window = window_of(made)
        motion = motion_at(made.truth["truth"], window.middle_us)
        for asked in (("qr",), ("rmqr",), ("microqr",), ("qr", "microqr")):
            found = find(Solver(ReadConfig(symbologies=asked)), window, motion)
            assert isinstance(found, NotFound) or found.space.symbology in map(Symbology, asked)
            if kind in asked:
                assert not isinstance(found, NotFound) and found.space.symbology is Symbology(kind)
