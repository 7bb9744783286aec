"""A grade of the print, A to F, after ISO/IEC 15415:2011, as far as events allow.

The standard grades pictures: parts of what is measured get 4 (A) to 0 (F) by thresholds, and the symbol gets
the lowest of them.  Events show changes of the logarithm of light, so each part has something in its place:

decode                  4: what does not decode is no reading
unused correction       as in the standard, but that no codewords are set apart for detection
fixed pattern damage    share of modules of the wrong sign among those known before, of the worst quarter of
                        the symbol, by the thresholds that the standard has for shares
modulation              2 |R - GT| / SC of each module, none where the sign is wrong; modules that are below a
                        level are taken for wrong codewords, one each, and the level counts as far as error
                        correction would be left
contrast                1 - Rmin / Rmax, from events an edge, for a sensor of `THRESHOLD`: light of a true
                        white is taken for granted
axial non-uniformity    |X - Y| over their mean, of the mean module; a tilt of the print counts, too
grid non-uniformity     the largest distance of a corner of a module from an even grid, in modules, which is
                        perspective: the pose that is fitted has no other deviation

For damage and modulation all modules are solved for once more, those known before as well, each as a
deviation from what was decoded.  Not graded: reflectance as such, print growth, which the standard does not
grade either, and the quiet zone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.fit.detection import Detection
from evqr.fit.model import quiet_modules
from evqr.fit.modules import CodeEstimate, NormalEquations
from evqr.fit.varying import apply_stencils
from evqr.geometry import module_px
from evqr.symbol.decoded import Decoded
from evqr.symbol.space import CodeSpace
from evqr.values import Value, plain

LETTERS = "FDCBA"

# Lowest value of D, C, B and A, or highest: ISO/IEC 15415:2011, 7.8, as verifiers' manuals give them.
CONTRAST = (0.20, 0.40, 0.55, 0.70)
MODULATION = (0.20, 0.30, 0.40, 0.50)
UNUSED = (0.25, 0.37, 0.50, 0.62)
AXIAL = (0.12, 0.10, 0.08, 0.06)
GRID = (0.75, 0.63, 0.50, 0.38)
DAMAGE = (0.17, 0.13, 0.09, 0.0)

THRESHOLD = 0.2
"""Change of the logarithm of light that an event tells of: what cameras are set to as they come, about."""

DEVIATES = 6.0
"""One over the variance of the deviations of modules, taken for granted where events say less."""

STEPS = 12
"""Of conjugate gradients: deviations then change by a hundredth of the contrast and less."""


@dataclass(frozen=True, eq=False)
class GradedPart(Value):
    """One of the things that are graded.

    Attributes
    ----------
    name : str
        What, as in `evqr.grade`.
    value : float
        As measured.
    number : int
        Its grade, 4 to 0.
    """

    name: str
    value: float
    number: int

    @property
    def letter(self) -> str:
        """Its grade, "A" to "D" or "F"."""
        return LETTERS[self.number]


@dataclass(frozen=True, eq=False)
class Grade(Value):
    """How good a print was, as far as the events of a reading show.

    Attributes
    ----------
    parts : tuple of GradedPart
        What is graded; the symbol's grade is the lowest of theirs.
    """

    parts: tuple[GradedPart, ...]

    @property
    def number(self) -> int:
        """The lowest of its parts, 4 to 0."""
        return min(part.number for part in self.parts)

    @property
    def letter(self) -> str:
        """The lowest of its parts, "A" to "D" or "F"."""
        return LETTERS[self.number]

    def __str__(self) -> str:
        worst = [f"{part.name} {part.value:.2f}" for part in self.parts if part.number == self.number]
        return self.letter if self.number == 4 else f"{self.letter} ({', '.join(worst)})"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values.

        Returns
        -------
        record : dict
            ``grade`` and ``letter``, and ``parts`` by name, each with ``value``, ``grade`` and ``letter``.
        """
        parts = {
            part.name: {"value": plain(part.value, 3), "grade": part.number, "letter": part.letter}
            for part in self.parts
        }
        return {"grade": self.number, "letter": self.letter, "parts": parts}


def grade_of(
    q: NDArray[np.floating],
    modules: NDArray[np.int8],
    space: CodeSpace,
    pose: NDArray[np.float64],
    *,
    contrast: float,
    unused: float,
    check: int,
) -> Grade:
    """Grade a print.

    Parameters
    ----------
    q : (V, U) float
        Light of its modules, 2 (R - GT) / SC: -1 for the darkest, +1 for the lightest.
    modules : (V, U) int8
        The exact symbol, -1 dark, +1 light.
    space : CodeSpace
        Its kind and size.
    pose : (3, 3) float64
        Code coordinates to px.
    contrast : float
        Of light and dark, 0 to 1.
    unused : float
        Share of the error correction that was not needed.
    check : int
        Check codewords of the symbol.

    Returns
    -------
    grade : Grade
        With its parts in the order of `evqr.grade`.
    """
    strength = np.minimum(q * modules, 1.0)  # below 0 where the sign is wrong
    damage, (axial, grid) = _damage(strength, space), _uneven(pose, space)
    modulation, number = _modulation(strength[~space.known], check)
    return Grade(
        (
            GradedPart("decode", 1.0, 4),
            GradedPart("unused correction", unused, _at_least(unused, UNUSED)),
            GradedPart("fixed pattern damage", damage, _at_most(damage, DAMAGE)),
            GradedPart("modulation", modulation, number),
            GradedPart("contrast", contrast, _at_least(contrast, CONTRAST)),
            GradedPart("axial non-uniformity", axial, _at_most(axial, AXIAL)),
            GradedPart("grid non-uniformity", grid, _at_most(grid, GRID)),
        )
    )


def grade_reading(found: Detection, length_us: float, estimate: CodeEstimate, decoded: Decoded) -> Grade:
    """Grade what was read.

    Parameters
    ----------
    found : Detection
        The code in its newest window.
    length_us : float [us]
        Of that window.
    estimate : CodeEstimate
        The modules that decoded.
    decoded : Decoded
        What they say.

    Returns
    -------
    grade : Grade
        Of the print, as far as its windows show it.
    """
    moved = found.motion.travel_px(length_us) / module_px(found.pose, found.space.shape)
    return grade_of(
        all_modules(estimate.equations, decoded.modules),
        decoded.modules,
        found.space,
        found.pose,
        contrast=contrast_of(float(np.hypot(*found.gain)) / max(moved, 1e-9)),
        unused=decoded.unused_correction,
        check=decoded.check,
    )


def contrast_of(events_an_edge: float) -> float:
    """Give 1 - Rmin / Rmax, of the events that an edge between dark and light causes in a pixel."""
    return 1.0 - float(np.exp(-THRESHOLD * events_an_edge))


def all_modules(equations: NormalEquations, modules: NDArray[np.int8]) -> NDArray[np.float64]:
    """Estimate all modules, those known before as well, near those that were decoded.

    Parameters
    ----------
    equations : NormalEquations
        Of the windows that were decoded, in units of their noise.
    modules : (V, U) int8
        The exact symbol, -1 dark, +1 light.

    Returns
    -------
    q : (V, U) float64
        As of `grade_of`.
    """
    quiet, stencil = quiet_modules(equations.space), equations.stencil.astype(np.float64)
    from_light = np.pad(modules.astype(np.float64) - 1.0, quiet)
    left: NDArray[np.float64] = -equations.rhs.astype(np.float64) - apply_stencils(stencil, from_light)
    # conjugate gradients on (N + DEVIATES) off = left
    off, step = np.zeros_like(left), left.copy()
    power = float((left * left).sum())
    for _ in range(STEPS):
        if power <= 1e-12:
            break
        image = apply_stencils(stencil, step) + DEVIATES * step
        rate = power / float((step * image).sum())
        off += rate * step
        left = left - rate * image
        power, before = float((left * left).sum()), power
        step = left + power / before * step
    rows, columns = modules.shape
    return modules + off[quiet : quiet + rows, quiet : quiet + columns]


def _at_least(value: float, levels: Sequence[float]) -> int:
    return sum(value >= level for level in levels)


def _at_most(value: float, levels: Sequence[float]) -> int:
    return sum(value <= level for level in levels)


def _damage(strength: NDArray[np.floating], space: CodeSpace) -> float:
    """Give the share of wrong modules among those known before, of the worst quarter."""
    half_v, half_u = (space.rows + 1) // 2, (space.columns + 1) // 2
    shares = [0.0]
    for rows in (slice(0, half_v), slice(half_v, None)):
        for columns in (slice(0, half_u), slice(half_u, None)):
            known = space.known[rows, columns]
            if known.any():
                shares.append(float((strength[rows, columns][known] < 0.0).mean()))
    return max(shares)


def _modulation(strength: NDArray[np.floating], check: int) -> tuple[float, int]:
    """Give the modulation that all but as many modules reach as may be wrong, and the grade of all levels."""
    numbers = [0]
    for number, level in enumerate(MODULATION, 1):
        weak = int((strength < level).sum())
        numbers.append(min(number, _at_least(1.0 - 2.0 * weak / check, UNUSED)))
    spare = int((1.0 - UNUSED[3]) * check / 2.0)
    return float(np.sort(strength)[min(spare, len(strength) - 1)]), max(numbers)


def _uneven(pose: NDArray[np.float64], space: CodeSpace) -> tuple[float, float]:
    """Give how much the modules' sides differ, and how far their corners lie from an even grid."""
    u, v = np.arange(space.columns + 1.0), np.arange(space.rows + 1.0)[:, None]
    depth = pose[2, 0] * u + pose[2, 1] * v + pose[2, 2]
    x, y = ((row[0] * u + row[1] * v + row[2]) / depth for row in pose[:2])
    du, dv = u - u.mean(), v - v.mean()
    du_2, dv_2 = float((du * du).mean()), float((dv * dv).mean())
    off_2, sides = np.zeros_like(x), np.zeros(2)
    for at in (x, y):
        along_u, along_v = float((du * at).mean()) / du_2, float((dv * at).mean()) / dv_2
        sides += along_u**2, along_v**2
        off_2 += (at - at.mean() - along_u * du - along_v * dv) ** 2
    side_u, side_v = np.sqrt(sides).tolist()
    mean = (side_u + side_v) / 2.0
    return abs(side_u - side_v) / mean, float(np.sqrt(off_2.max())) / mean
