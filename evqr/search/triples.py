"""Symbols with finder patterns at three of their corners: QR codes."""

from __future__ import annotations

import functools
import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from evqr.config import FinderConfig
from evqr.search.hypothesis import Hypothesis
from evqr.symbol.space import Anchor, CodeSpace, Landmark, Symbology, Version
from evqr.symbol.symbols import SYMBOLS, space_of
from evqr.workspace import Mirror, Step, Workspace

_Affine: TypeAlias = list[tuple[float, float, float]]


@dataclass(frozen=True)
class _Size:
    """A symbol with three finder patterns: at its corner, along u and along v.

    ``log_leg``: logarithm of the modules between the centres of two of them.
    """

    log_leg: float
    symbology: Symbology
    version: Version
    anchors: tuple[Anchor, Anchor, Anchor]

    @property
    def space(self) -> CodeSpace:
        return space_of(self.symbology, self.version)


@functools.cache
def _sizes() -> tuple[_Size, ...]:
    """All of them, the smallest first."""
    found = []
    for symbology, symbol in SYMBOLS.items():
        for version in symbol.sizes:
            anchors = [each for each in symbol.anchors(version) if each.kind is Landmark.FINDER_PATTERN]
            if len(anchors) == 3:
                corner, along, down = anchors
                found.append(_Size(math.log(along.u - corner.u), symbology, version, (corner, along, down)))
    return tuple(sorted(found, key=lambda size: size.log_leg))


class Triples(Step):
    """Triples of peaks (1, N, 5) that make three corners of a code.

    Corner i sees its neighbours j (along u) and k (along v) at a right angle, with equal legs.
    """

    def __init__(self, peaks: Mirror, most: int, cfg: FinderConfig, workspace: Workspace) -> None:
        super().__init__(workspace.backend)
        self._most = most
        room = peaks.host.shape[1]
        self._sizes = _sizes()
        self._log_legs = [size.log_leg for size in self._sizes]
        tolerances = cfg.leg_tolerance, cfg.scale_tolerance, cfg.angle_tolerance
        ends = self._log_legs[0], self._log_legs[-1]
        self._peaks, self._cfg = peaks, cfg
        self._tolerances = workspace.put(np.array([*tolerances, *ends], np.float32))
        self._scratch = workspace.scratch("match_corners", B=1, P=room)
        self._triples = workspace.mirror((1, room, cfg.triples_a_corner, 4))

    def launch(self) -> None:
        """Launch the kernels one by one."""
        self._backend.match_corners(
            self._peaks.device, self._tolerances, *self._scratch, self._triples.device
        )

    def read(self) -> list[Hypothesis]:
        """Wait for the device and give ``most`` hypotheses, or a few more, best first."""
        peaks = self._peaks.read()[0]
        triples = self._triples.read().reshape(-1, 4)
        places = peaks[:, 1:3].tolist()
        found: list[tuple[_Size, float, bool, int]] = []
        poses: list[_Affine] = []
        for triple, index in enumerate(np.argsort(-triples[:, 0], kind="stable").tolist()):
            response, j, k, log_leg = triples[index].tolist()
            if not response or len(found) >= self._most:
                break
            i = index // self._cfg.triples_a_corner
            inverted = bool(peaks[i, 0] < 0.0)
            for size in self._fitting(log_leg):
                found.append((size, response, inverted, triple))
                poses.append(_pose(places[i], places[int(j)], places[int(k)], size.anchors))
        return [
            Hypothesis(size.space, pose, response, inverted, triple)
            for pose, (size, response, inverted, triple) in zip(np.array(poses), found, strict=True)
        ]

    def _fitting(self, log_leg: float) -> list[_Size]:
        """Sizes whose finder patterns are so many modules apart, to a tolerance, best first."""
        first = bisect_left(self._log_legs, log_leg - self._cfg.scale_tolerance)
        last = bisect_right(self._log_legs, log_leg + self._cfg.scale_tolerance)
        return sorted(self._sizes[first:last], key=lambda size: abs(size.log_leg - log_leg))


def _pose(
    corner: list[float], along: list[float], down: list[float], anchors: tuple[Anchor, Anchor, Anchor]
) -> _Affine:
    """Affine pose from the centres (x, y) of three finder patterns, and where they are in the code."""
    origin, beside, below = anchors
    rows: _Affine = []
    for at, u, v in zip(corner, along, down, strict=True):
        per_u, per_v = (u - at) / (beside.u - origin.u), (v - at) / (below.v - origin.v)
        rows.append((per_u, per_v, at - origin.u * per_u - origin.v * per_v))
    return [*rows, (0.0, 0.0, 1.0)]
