"""Single finder patterns and the codes that they could belong to, without an image."""

import numpy as np
import pytest

from evqr.search.singles import Singles
from evqr.symbol import micro_qr
from evqr.symbol.symbols import SYMBOLS

PEAK = (0.8, 100.0, 80.0, 4.0, np.deg2rad(20.0))


def hypotheses_of(workspace, *peaks, most=4):
    table = workspace.mirror((1, len(peaks) + 2, 5))  # with room left
    for k, peak in enumerate(peaks):
        table.host[0, k] = peak
    table.push()
    return Singles(table, most).read()


@pytest.mark.parametrize("version", micro_qr.SIZES)
@pytest.mark.parametrize("turn_deg", [20.0, 110.0, 200.0, 290.0])
def test_a_peak_makes_every_size_in_four_directions(version, turn_deg, workspace):
    turn = np.deg2rad(turn_deg)
    axes = 4.0 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    found = [h for h in hypotheses_of(workspace, PEAK) if h.space == micro_qr.space(version)]
    assert len(found) == 4
    (right,) = [h for h in found if np.allclose(h.pose[:2, :2], axes, atol=1e-5)]
    np.testing.assert_allclose(right.pose @ (3.5, 3.5, 1.0), (100.0, 80.0, 1.0), atol=1e-5)
    assert (right.response, right.inverted) == (pytest.approx(0.8), False)


def test_only_sizes_with_a_single_finder_pattern_are_made(workspace):
    spaces = {hypothesis.space for hypothesis in hypotheses_of(workspace, PEAK)}
    single = [
        (symbology, version)
        for symbology, symbol in SYMBOLS.items()
        for version in symbol.sizes
        if len(symbol.anchors(version)) == 1
    ]
    assert sorted((space.symbology, space.version) for space in spaces) == sorted(single)


def test_no_more_peaks_than_asked_for_and_the_best_first(workspace):
    second, third = (-0.7, 50.0, 40.0, 5.0, 0.1), (0.6, 10.0, 10.0, 6.0, 0.2)
    found = hypotheses_of(workspace, PEAK, second, third, most=2)
    assert [h.response for h in found] == pytest.approx([0.8] * 16 + [0.7] * 16)
    assert [h.inverted for h in found] == [False] * 16 + [True] * 16
    assert hypotheses_of(workspace, PEAK, most=0) == []


def test_without_peaks_there_are_none(workspace):
    assert hypotheses_of(workspace) == []
