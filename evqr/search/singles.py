"""Symbols with a single finder pattern: Micro QR codes."""

from __future__ import annotations

import functools
import math

import numpy as np

from evqr.search.hypothesis import Hypothesis
from evqr.symbol.space import Anchor, Landmark, Symbology, Version
from evqr.symbol.symbols import SYMBOLS, space_of
from evqr.workspace import Mirror

QUARTERS = 4
"""Ways to turn a symbol about its finder pattern, which looks alike turned by a right angle."""


@functools.cache
def _sizes() -> tuple[tuple[Symbology, Version, Anchor], ...]:
    """All of them, with where they have their finder pattern."""
    found = []
    for symbology, symbol in SYMBOLS.items():
        for version in symbol.sizes:
            anchors = symbol.anchors(version)
            if [anchor.kind for anchor in anchors] == [Landmark.FINDER_PATTERN]:
                found.append((symbology, version, anchors[0]))
    return tuple(found)


class Singles:
    """Peaks (1, N, 5) that are the one finder pattern of a code.

    A peak tells place, size of a module and angle but for right angles; every symbol is tried in each of
    the four directions that are left.  All of them compete, those of all peaks: one finder pattern is like
    another, and what tells is around it.
    """

    def __init__(self, peaks: Mirror, most: int) -> None:
        self._peaks, self._most = peaks, most

    def launch(self) -> None:
        """Launch nothing: it is all arithmetic of a few numbers."""

    def read(self) -> list[Hypothesis]:
        """Wait for the device and give hypotheses, those of the best peaks first."""
        peaks = self._peaks.read()[0, : self._most]
        found = []
        for response, x, y, module_px, angle in peaks.tolist():
            if not response:
                break
            for symbology, version, anchor in _sizes():
                for quarter in range(QUARTERS):
                    turn = angle + quarter * math.pi / 2
                    cos, sin = module_px * math.cos(turn), module_px * math.sin(turn)
                    left = x - cos * anchor.u + sin * anchor.v
                    top = y - sin * anchor.u - cos * anchor.v
                    pose = np.array([[cos, -sin, left], [sin, cos, top], [0.0, 0.0, 1.0]])
                    space = space_of(symbology, version)
                    found.append(Hypothesis(space, pose, abs(response), response < 0.0))
        return found
