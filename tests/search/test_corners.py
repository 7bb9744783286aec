"""Data Matrix symbols are found by their solid sides and read from one window, one leg or both being seen."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import at, find, middle_us, motion_at, scene, window_of

from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.events.window import make_window
from evqr.fit.detection import NotFound
from evqr.motion import Motion
from evqr.search.corners import LEAST_BUSY, _hypotheses
from evqr.search.edges import Edges, straight_edges
from evqr.search.finder import find_patterns
from evqr.search.models import dashes, sizes
from evqr.simulate.geometry import transform
from evqr.solver import Solver
from evqr.symbol import data_matrix
from evqr.symbol.decode import decode_grid
from evqr.symbol.symbols import SYMBOLS
from evqr.symbology import Symbology


@pytest.fixture(scope="module")
def solver():
    return Solver(ReadConfig(symbologies=("qr", "datamatrix")))


def made_of(version, **options):
    given = {"module_px": 5.0, "direction": 0.0, **options}
    return scene("EVQR", symbology="datamatrix", version=version, **given)


def corners_of(rows, columns):
    return np.array([[0.0, 0.0], [columns, 0.0], [columns, rows], [0.0, rows]])


def text_of(solver, found):
    (estimate,) = solver.solve([found])
    return decode_grid(estimate.q, found.space, effort="full").text


@pytest.mark.parametrize(
    ("version", "angle", "options"),
    [
        ("12x12", 20.0, {}),
        ("16x16", 0.0, {}),  # the other leg runs along the motion
        ("22x22", 75.0, {"preset": "fast", "direction": 30.0}),
        ("36x36", 160.0, {"module_px": 4.0}),
        ("8x18", 200.0, {}),
        ("12x36", 90.0, {}),
        ("16x48", 45.0, {"module_px": 4.0, "invert": True}),
        ("8x48", 300.0, {"module_px": 4.0}),
    ],
)
def test_codes_are_found_and_read_from_one_window(version, angle, options, solver):
    made = made_of(version, angle=angle, **options)
    truth, window = made.truth["truth"], window_of(made)
    found = find(solver, window, motion_at(truth, window.middle_us))
    assert not isinstance(found, NotFound), found
    assert (found.space.symbology, found.space.version) == (Symbology.DATA_MATRIX, version)
    true = transform(at(truth, "H", middle_us(made)), corners_of(*truth["modules"].shape))
    off = found.target.outline() - true
    # pixels that lag move all of it
    assert np.abs(off - off.mean(axis=0)).max() < 2.5 and np.abs(off.mean(axis=0)).max() < 5.0
    assert text_of(solver, found) == "EVQR"


@pytest.mark.parametrize("version", ["14x14", "12x26"])
def test_a_mirror_image_is_read(version, solver):
    made = made_of(version, angle=20.0)
    across = made.events.width - 1
    flipped = replace(made.events, x=(across - made.events.x.astype(int)).astype(np.uint16))
    there = window_of(made)
    window = make_window(flipped, there.start_us, there.end_us)
    v_x, v_y = at(made.truth["truth"], "velocity", middle_us(made))
    found = find(solver, window, Motion([-v_x, v_y], window.middle_us))
    assert not isinstance(found, NotFound), found
    assert text_of(solver, found) == "EVQR"


def test_edges_are_the_legs_of_the_l(solver):
    made = made_of("22x22", angle=20.0)
    window, truth = window_of(made), made.truth["truth"]
    motion = motion_at(truth, window.middle_us)
    cfg = solver.config
    _, pyramid = find_patterns(EventBatch.of([window]), [motion], cfg.finder, workspace=solver.workspace)
    directions = motion.direction[None]
    (edges,) = straight_edges(pyramid, [0], directions, cfg.edges, workspace=solver.workspace)
    top, _, right, corner = transform(at(truth, "H", window.middle_us), corners_of(22, 22))
    for leg in ((top, corner), (corner, right)):
        ends = np.stack([edges.start, edges.end], axis=1)
        off = [np.hypot(*(way - leg).reshape(-1, 2, 2).transpose(2, 0, 1)) for way in (ends, ends[:, ::-1])]
        nearest = np.minimum(*(each.max(axis=1) for each in off))
        assert nearest.min() < 4.0
        k = int(nearest.argmin())
        way, into = leg[1] - leg[0], top + right - 2.0 * corner
        normal = np.array([-way[1], way[0]])
        normal *= np.sign(normal @ into)
        # dark comes in along the motion: less light, OFF events, of which the image has the opposite sign
        assert edges.sign[k] == np.sign(normal @ motion.direction)
        along = edges.end[k] - edges.start[k]
        inner, outer = edges.busy[k] if normal @ [-along[1], along[0]] > 0 else edges.busy[k][::-1]
        assert inner > 2.0 * LEAST_BUSY and outer < inner


@pytest.mark.parametrize("busy", [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
def test_symbols_lie_where_something_happens(busy, solver):
    """To the right of an edge that runs up, to the left, on either side, or nowhere."""
    start, end = np.array([[100.0, 200.0]]), np.array([[100.0, 120.0]])
    edges = Edges(start, end, np.ones(1), np.array([busy]))
    made = _hypotheses(edges, np.array([1.0, 0.0]), 0, solver.config)
    middles = [
        transform(pose, np.array([[0.5, 0.5]]) * corners_of(*data_matrix_shape(size))[2])[0]
        for pose, size in zip(made.pose, made.size, strict=True)
    ]
    sides = {bool(x > 100.0) for x, _ in middles}
    assert sides == {side for side, there in zip((True, False), busy, strict=True) if there}


def data_matrix_shape(size):
    return SYMBOLS[Symbology.DATA_MATRIX].sizes[sizes()[size].version]


def test_dashed_sides_are_those_of_the_symbols():
    """What stands for the edges between modules has the signs of the symbol's own."""
    known, names = dashes(), sizes()
    for k, size in enumerate(names):
        if size.symbology is not Symbology.DATA_MATRIX:
            assert known.ptr[2 * k, 0] == known.ptr[2 * k + 1, 2]
            continue
        values = np.pad(data_matrix.space(str(size.version)).values, 1, constant_values=1).astype(int)
        for side in (0, 1):
            first, _, end = known.ptr[2 * k + side]
            u, v, edge, _ = known.points[first:end:2].T
            column, row = np.floor(u).astype(int) + 1, np.floor(v).astype(int) + 1
            before = values[row, column - 1] if side == 0 else values[row - 1, column]
            np.testing.assert_array_equal(np.sign(before - values[row, column]), np.sign(edge))


@pytest.mark.parametrize("symbology", ["qr", "microqr"])
def test_what_has_finder_patterns_is_no_data_matrix(symbology, solver):
    made = scene("EVQR", symbology=symbology, version=2 if symbology == "qr" else "M3", ec="L")
    window = window_of(made)
    found = find(solver, window, motion_at(made.truth["truth"], window.middle_us))
    if symbology == "qr":
        assert not isinstance(found, NotFound) and found.space.symbology is Symbology.QR_CODE
    elif not isinstance(found, NotFound):
        (estimate,) = solver.solve([found])
        assert not hasattr(decode_grid(estimate.q, found.space, effort="full"), "payload")
