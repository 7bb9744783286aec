"""What all symbols of a size show, in a few hundred points: finder patterns and timing.

A hypothesis can be scored by it before anything is made for its kind and size (`evqr.search.score`): there
are points for every size of every symbology, made once, by formulas.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from evqr.fit.model import profiles
from evqr.symbol import aztec
from evqr.symbol.space import Anchor, Landmark, Timing, Version, closed
from evqr.symbol.symbols import SYMBOLS
from evqr.symbology import Symbology

SIGMA = 0.5
"""Blur of the model [modules]: a timing pattern would vanish with more."""

REACH = 4
"""Points of a finder pattern lie up to so many modules from its centre: its separator is the last that is
known on all sides."""


@dataclass(frozen=True)
class Size:
    """A kind of symbol in one size.

    Attributes
    ----------
    symbology : Symbology
        What it is.
    version : Version
        Which size of it.
    anchors : tuple of Anchor
        Its finder patterns: at its corner, and where it has three, along u and along v.
    hidden : int, optional
        Which finder pattern of the symbol is not seen, and none of these.  Default: none.
    """

    symbology: Symbology
    version: Version
    anchors: tuple[Anchor, ...]
    hidden: int | None = None


@functools.cache
def sizes() -> tuple[Size, ...]:
    """All sizes that are found: `Models` are in this order.

    Cores of symbols about a bull's eye, those with one or three finder patterns, and heads; then those with
    three of which one is hidden.
    """
    found = []
    names = [(symbology, version) for symbology, symbol in SYMBOLS.items() for version in symbol.sizes]
    names += [(symbology, head) for symbology, symbol in SYMBOLS.items() for head in symbol.heads]
    found += [Size(Symbology.AZTEC, version, aztec.anchors(version)) for version in aztec.CORES]
    solid = Landmark.SOLID_CORNER
    for symbology, version in names:
        every = SYMBOLS[symbology].anchors(version)
        if [anchor.kind for anchor in every] == [solid]:
            found.append(Size(symbology, version, every))
            continue
        anchors = tuple(anchor for anchor in every if anchor.kind is Landmark.FINDER_PATTERN)
        if len(anchors) in (1, 3):
            found.append(Size(symbology, version, anchors))
    for size in [size for size in found if len(size.anchors) == 3]:
        for hidden in range(3):
            seen = size.anchors[:hidden] + size.anchors[hidden + 1 :]
            found.append(Size(size.symbology, size.version, seen, hidden))
    return tuple(found)


@functools.cache
def hidden_sizes() -> NDArray[np.intp]:
    """Give for each of `sizes` with three finder patterns those with one of them hidden, (S, 3)."""
    numbers = {(size.symbology, size.version, size.hidden): k for k, size in enumerate(sizes())}
    of_each = [
        [numbers.get((size.symbology, size.version, hidden), k) for hidden in range(3)]
        for k, size in enumerate(sizes())
    ]
    return closed(np.array(of_each, np.intp))


@functools.cache
def heads() -> Mapping[int, NDArray[np.intp]]:
    """Sizes that begin with a head, by the head: all by their numbers in `sizes`."""
    numbers = {(size.symbology, size.version): k for k, size in enumerate(sizes()) if size.hidden is None}
    return MappingProxyType(
        {
            numbers[symbology, head]: np.array([numbers[symbology, version] for version in versions], np.intp)
            for symbology, symbol in SYMBOLS.items()
            for head, versions in symbol.heads.items()
        }
    )


@functools.cache
def cores() -> NDArray[np.bool_]:
    """Return which of `sizes` are cores of symbols about a bull's eye."""
    return closed(np.array([size.version in SYMBOLS[size.symbology].cores for size in sizes()]))


@functools.cache
def kinds_of(symbologies: tuple[Symbology, ...]) -> NDArray[np.bool_]:
    """Return which of `sizes` are of some symbologies."""
    return closed(np.array([size.symbology in symbologies for size in sizes()]))


@dataclass(frozen=True, eq=False)
class Models:
    """Points of all sizes, one behind the other.

    Attributes
    ----------
    name : str
        What they are called.
    points : (S, 4) float32 [modules, modules, 1/module, 1/module]
        Code coordinates (u, v), and the slope of the printed luminance there.
    ptr : (K + 1, 3) int32
        Of each size its first point, the first of its timing, and the one behind its last; the last row is of
        nothing.
    """

    name: str
    points: NDArray[np.float32]
    ptr: NDArray[np.int32]


@functools.cache
def models() -> Models:
    """Make the points of all sizes."""
    parts: list[NDArray[np.float64]] = []
    ptr = np.zeros((len(sizes()) + 1, 3), np.int32)
    end = 0
    for k, size in enumerate(sizes()):
        finders = [anchor for anchor in size.anchors if anchor.kind is Landmark.FINDER_PATTERN]
        patterns = [_pattern() + np.array((anchor.u, anchor.v, 0.0, 0.0)) for anchor in finders]
        lines = [_line(timing) for timing in SYMBOLS[size.symbology].timing(size.version)]
        if size.anchors[0].kind is Landmark.SOLID_CORNER:
            shape = SYMBOLS[size.symbology].sizes[size.version]
            patterns = [_solid_sides(*shape)]
        middle = end + sum(map(len, patterns))
        ptr[k] = end, middle, middle + sum(map(len, lines))
        parts += [*patterns, *lines]
        end = ptr[k, 2]
    ptr[-1] = end
    return Models("sizes", closed(np.concatenate(parts).astype(np.float32)), closed(ptr))


@functools.cache
def dashes() -> Models:
    """Make points of the dashed sides of all sizes, of which number 2 k and 2 k + 1 are of size k.

    A side is a wave whose phase is not known before the pose is: two slopes stand for what the edges between
    its modules say, and for what the middles of its modules say.
    """
    parts: list[NDArray[np.float64]] = []
    ptr = np.zeros((2 * len(sizes()) + 1, 3), np.int32)
    end = 0
    for k, size in enumerate(sizes()):
        sides = []
        if size.anchors[0].kind is Landmark.SOLID_CORNER:
            sides = [_wave(timing) for timing in SYMBOLS[size.symbology].timing(size.version)]
        for side in range(2):
            count = len(sides[side]) if sides else 0
            ptr[2 * k + side] = end, end + count, end + count
            end += count
        parts += sides
    ptr[-1] = end
    return Models("dashes", closed(np.concatenate(parts).astype(np.float32)), closed(ptr))


def _wave(timing: Timing) -> NDArray[np.float64]:
    """Points of a timing pattern, half a module apart."""
    half = np.arange(2 * timing.count)
    points = np.zeros((len(half), 4))
    points[:, 0], points[:, 1] = timing.u, timing.v
    points[:, 0 if timing.along_u else 1] += 0.5 * half - 0.5
    points[half, 2 + half % 2] = 1.0 - 2.0 * (half // 2 % 2)
    return points


@functools.cache
def _pattern() -> NDArray[np.float64]:
    """Points of a finder pattern from its centre, one a module along each axis."""
    steps = np.arange(-REACH, REACH + 1.0)
    u, v = (grid.ravel() for grid in np.meshgrid(steps, steps))
    along_u, along_v = np.zeros_like(u), np.zeros_like(u)
    for size, change in ((7, -2.0), (5, 2.0), (3, -2.0)):
        # a square of `size` modules is a module's profile, stretched
        fu, du, _ = profiles((u + size / 2) / size, SIGMA / size)
        fv, dv, _ = profiles((v + size / 2) / size, SIGMA / size)
        along_u += change * du / size * fv
        along_v += change * fu * dv / size
    return np.stack([u, v, along_u, along_v], axis=1)


@functools.cache
def pattern() -> Models:
    """Make the points of a finder pattern alone, with its centre at 0: number 0 of a table of one."""
    points = _pattern()
    ptr = np.array([[0, len(points), len(points)], [len(points)] * 3], np.int32)
    return Models("pattern", closed(points.astype(np.float32)), closed(ptr))


def _solid_sides(rows: int, columns: int) -> NDArray[np.float64]:
    """Points of the outer edges of the left column and of the bottom row, one a module, which are dark."""
    points = np.zeros((rows + columns, 4))
    points[:rows, 1], points[rows:, 0] = np.arange(rows) + 0.5, np.arange(columns) + 0.5
    points[rows:, 1] = rows
    slope = 2.0 / (math.sqrt(2.0 * math.pi) * SIGMA)
    points[:rows, 2], points[rows:, 3] = -slope, slope
    return points


@functools.cache
def _across() -> float:
    """Share of a line's modules in the luminance along its middle; what is beside them is not known."""
    return float(profiles(np.array([0.5]), SIGMA)[0][0])


def _line(timing: Timing) -> NDArray[np.float64]:
    """Points of a timing pattern, at its ends, at the edges between its modules, and in the quiet zone."""
    slopes = _slopes(timing.count, timing.quiet, timing.dark)
    points = np.zeros((len(slopes), 4))
    points[:, 0], points[:, 1] = timing.u, timing.v
    along = 0 if timing.along_u else 1
    points[:, along] += np.arange(-0.5, len(slopes) - 1.0)
    points[:, 2 + along] = slopes
    return points


@functools.cache
def _slopes(count: int, quiet: int, dark: tuple[int, ...]) -> NDArray[np.float64]:
    """Slope of the luminance along a line at each of its edges, and behind the last in its quiet zone."""
    # from light to dark at the first, and in turn up to the last
    edge = np.arange(count + 1 + quiet)
    beside = np.arange(-3, 4)
    light = np.ones(count + 2 * (1 + len(beside)) + quiet)
    line = light[1 + len(beside) :]
    line[:count:2] = -1.0
    line[list(dark)] = -1.0
    change = np.diff(light)[len(beside) + edge[:, None] + beside]
    density = np.exp(-0.5 * (beside / SIGMA) ** 2) / (math.sqrt(2.0 * math.pi) * SIGMA)
    return closed(_across() * (density * change).sum(axis=1))
