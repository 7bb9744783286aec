"""What is known of a symbol before it is read: its kind and size, where its modules are and which are fixed.

The fixed modules (finder patterns, separators, timing and the like) anchor the pose, and they need not be
estimated.  How the others carry the content is the business of the symbology's own file.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.symbology import Symbology

Version = int | str
"""Of a symbol: 1 to 40 for QR codes, text for others (M2, R11x27, 22x22, F4)."""


SEPARATED = 4.5
"""Half of the width of a finder pattern and its separator [modules]."""


class Landmark(str, Enum):
    """What the search looks for."""

    FINDER_PATTERN = "finder pattern"
    """squares of 7, 5 and 3 modules in one another: dark, light, dark"""
    BULLS_EYE = "bull's eye"
    """squares of 9, 7, 5, 3 and 1 modules in one another: dark and light in turn"""
    SOLID_CORNER = "solid corner"
    """two sides of dark modules that meet; the other two are dark and light in turn"""


@dataclass(frozen=True)
class Anchor:
    """Where a symbol has something that the search looks for.

    Attributes
    ----------
    kind : Landmark
        What it is.
    u, v : float [modules]
        Its centre, column and row from the outer corner of the top-left module.
    """

    kind: Landmark
    u: float
    v: float


@dataclass(frozen=True)
class Timing:
    """Modules in a line, dark and light in turn, the first and the last of them dark.

    Attributes
    ----------
    u, v : float [modules]
        Centre of the first, column and row from the outer corner of the top-left module.
    along_u : bool
        Whether the line runs along u, or along v.
    count : int
        Modules of the line.
    quiet : int
        Modules of quiet zone that are known to lie behind its end; before it, and behind it where there are
        none, is a separator.
    dark : tuple of int
        Modules of the line that are dark out of turn, because other patterns cross it.
    """

    u: float
    v: float
    along_u: bool
    count: int
    quiet: int = 0
    dark: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class CodeSpace:
    """A kind of symbol in one size; equal where symbology, version and what is hidden are.

    Attributes
    ----------
    symbology : Symbology
        What it is.
    version : int or str
        Which size of it: an int for QR codes, text for others.
    known : (V, U) bool
        Modules that are the same in all symbols of the kind and size.
    values : (V, U) int8
        -1 dark, +1 light where known, 0 elsewhere.
    anchors : tuple of Anchor
        What the search looks for.
    quiet_zone : int [modules]
        Width of the light margin that the standard asks for.
    hidden : int, optional
        Which finder pattern of the symbol is not seen: its modules are not known, and it is none of the
        anchors.  Default: none.

    Raises
    ------
    ValueError
        The arrays do not fit together.
    """

    symbology: Symbology
    version: Version
    known: NDArray[np.bool_] = field(compare=False, repr=False)
    values: NDArray[np.int8] = field(compare=False, repr=False)
    anchors: tuple[Anchor, ...] = field(compare=False, repr=False)
    quiet_zone: int = field(compare=False, repr=False)
    hidden: int | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.known.ndim != 2 or self.values.shape != self.known.shape:
            raise ValueError(
                f"known and values must have one shape (V, U), got {self.known.shape}, {self.values.shape}"
            )
        if ((self.values != 0) != self.known).any():
            raise ValueError("values must be -1 or +1 where known, and 0 elsewhere")
        closed(self.known)
        closed(self.values)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        closed(self.known)  # arrays come out of a pickle writable
        closed(self.values)

    def __str__(self) -> str:
        return f"{self.symbology} {self.version}"

    @property
    def single_pattern(self) -> bool:
        """Whether a single finder pattern is all that the search looks for."""
        return [anchor.kind for anchor in self.anchors] == [Landmark.FINDER_PATTERN]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of modules (V, U)."""
        rows, columns = self.known.shape
        return rows, columns

    @property
    def rows(self) -> int:
        """Modules from top to bottom, V."""
        return self.known.shape[0]

    @property
    def columns(self) -> int:
        """Modules from left to right, U."""
        return self.known.shape[1]

    @property
    def size(self) -> int:
        """Modules of the longer side."""
        return max(self.known.shape)


@functools.lru_cache(maxsize=256)
def without(space: CodeSpace, hidden: int) -> CodeSpace:
    """Return a code space of which one finder pattern is not seen.

    Parameters
    ----------
    space : CodeSpace
        Of all that the kind and size shows.
    hidden : int
        Which of its anchors is not seen, a finder pattern: its modules and those of its separator, which are
        under the same stain or out of view, are not known.
    """
    pattern = space.anchors[hidden]
    rows, columns = (
        slice(max(0, round(at - SEPARATED)), round(at + SEPARATED)) for at in (pattern.v, pattern.u)
    )
    known, values = space.known.copy(), space.values.copy()
    known[rows, columns], values[rows, columns] = False, 0
    anchors = tuple(anchor for k, anchor in enumerate(space.anchors) if k != hidden)
    return replace(space, known=known, values=values, anchors=anchors, hidden=hidden)


def closed(array: NDArray) -> NDArray:
    """Return the array, closed for writing: it is shared by all who ask."""
    array.flags.writeable = False
    return array
