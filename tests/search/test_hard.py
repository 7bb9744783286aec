"""Codes that are searched for where nothing else is found: tilted ones, and those of small modules."""

from dataclasses import replace

import pytest

from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.search.smaller import smaller
from evqr.solver import Solver
from evqr.stream.scheduler import StreamScheduler
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded
from evqr.symbology import Symbology
from tests.scenes import middle_us, motion_at, scene, window_of

CONFIG = ReadConfig(symbologies=(Symbology.QR_CODE,))


def text_of(solver, made, *, thorough=True):
    """What one window says."""
    motion = motion_at(made.truth["truth"], middle_us(made))
    (found,) = solver.find(EventBatch.of([window_of(made)]), [motion], thorough=thorough)
    if not isinstance(found, tuple):
        return None
    (estimate,) = solver.solve(found[:1])
    read = decode_grid(estimate.q, found[0].space)
    return read.payload.text if isinstance(read, Decoded) else None


@pytest.fixture(scope="module")
def solver():
    return Solver(CONFIG)


@pytest.fixture(scope="module")
def without_hard():
    passes = tuple(one for one in CONFIG.finder.passes if one.slack <= 1.0)
    return Solver(replace(CONFIG, finder=replace(CONFIG.finder, passes=passes, smaller_sizes=0)))


@pytest.mark.parametrize("angle", [20.0, 80.0])
def test_a_code_tilted_by_45_degrees_is_read_in_one_window(solver, without_hard, angle):
    made = scene("TILT", tilt=45.0, ec="H", angle=angle, module_px=5.5, travel_px=4.0)
    assert text_of(without_hard, made) is None
    assert text_of(solver, made) == "TILT"


@pytest.mark.parametrize("module_px", [2.5, 2.1])
def test_small_modules_are_read_in_one_window(solver, without_hard, module_px):
    made = scene("SMALL", module_px=module_px, ec="H", travel_px=4.0)
    assert text_of(without_hard, made) is None
    assert text_of(solver, made, thorough=False) is None
    assert text_of(solver, made) == "SMALL"


def test_what_is_searched_below_the_usual_sizes_goes_on_from_them():
    below, usual = smaller(ReadConfig()), ReadConfig().finder
    assert below is not None
    assert below.finder.largest_module_px * usual.scale_ratio == pytest.approx(usual.smallest_module_px)
    assert below.symbologies == (Symbology.QR_CODE,)
    assert smaller(below) is None
    assert smaller(ReadConfig(symbologies=(Symbology.AZTEC,))) is None
    assert smaller(ReadConfig(finder=replace(usual, smaller_sizes=0))) is None


def test_a_stream_is_searched_thoroughly_now_and_then():
    scheduler = StreamScheduler([Solver(ReadConfig())], 64, 48)
    assert [scheduler._kinds(vain)[1] for vain in range(6)] == [False, True, False, False, False, True]
