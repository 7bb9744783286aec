"""Codes that might be where finder patterns are, and who makes them up.

One search finds places that look like a finder pattern.  Which codes they could belong to depends on how the
symbols of a symbology carry them: there is a `Layout` for each way, and a `Matcher` for each layout.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from evqr.symbol.space import CodeSpace


class Layout(Enum):
    """How symbols carry their finder patterns, in the order in which they are looked for.

    The next one is only looked for where those before it found nothing that agrees well.
    """

    THREE_CORNERS = "three at the corners of a square, all but the bottom right one"
    SINGLE = "one"


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A code that some finder patterns could belong to.

    Attributes
    ----------
    space : CodeSpace
        Kind and size of the code.
    pose : (3, 3) float64
        Code coordinates to px.
    response : float
        Sum of the responses of its finder patterns.
    inverted : bool
        Light modules on dark.
    patterns : int
        Which finder patterns: hypotheses from the same ones differ in the kind or size of the code.
    """

    space: CodeSpace
    pose: NDArray[np.float64]
    response: float
    inverted: bool
    patterns: int = 0


class Matcher(Protocol):
    """Makes hypotheses of the peaks of one search, which are on the device."""

    def launch(self) -> None:
        """Launch what the device does of it, behind the search."""
        ...

    def read(self) -> list[Hypothesis]:
        """Wait for the device and give hypotheses, best first."""
        ...
