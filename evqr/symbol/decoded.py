"""What comes of a module grid: a reading, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evqr.reason import Reason
from evqr.symbol.payload import Payload
from evqr.symbol.space import CodeSpace, Version
from evqr.symbology import Symbology
from evqr.values import Value

Effort = Literal["quick", "full"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Decoded(Value):
    """A symbol, read: what it says, and how it was decoded.

    Attributes
    ----------
    payload : Payload
        What it says.
    space : CodeSpace
        Kind and size of the symbol.
    ec_level : str, optional
        Level of error correction, "L", "M", "Q" or "H"; None where there are no levels.
    mask : int, optional
        Number of the mask; None where there are none.
    mirrored : bool
        The grid was the mirror image of the symbol; a rectangle's pose is mirrored, not its grid.
    errors_corrected : int
        Codewords that error correction changed, erased ones included.
    erasures : int
        Codewords that were erased.
    spare : int
        Unused check codewords, n_check - 2 errors - erasures: the least over the blocks.
    check : int
        Check codewords of the symbol.
    unused_correction : float
        Share of the error correction that was not needed, 0 to 1: the least over the blocks.
    modules : (V, U) int8
        The exact symbol, in the orientation of the grid: -1 dark, +1 light.
    log10_chance : float
        Decimal logarithm of the number of contents expected to agree as well by chance, as worked out in
        `evqr.symbol.chance`.
    confidence : float
        1 / (1 + wrong_grids 10^log10_chance): that the text is right, 0 to 1.
    """

    payload: Payload
    space: CodeSpace
    ec_level: str | None = None
    mask: int | None = None
    mirrored: bool = False
    errors_corrected: int
    erasures: int
    spare: int
    check: int
    unused_correction: float
    modules: NDArray[np.int8]
    log10_chance: float
    confidence: float

    @property
    def text(self) -> str:
        """Its text."""
        return self.payload.text

    @property
    def data(self) -> bytes:
        """Its bytes."""
        return self.payload.data

    @property
    def symbology(self) -> Symbology:
        """Kind of the symbol."""
        return self.space.symbology

    @property
    def version(self) -> Version:
        """Size of the symbol: an int for QR codes, text for others."""
        return self.space.version


@dataclass(frozen=True, kw_only=True)
class DecodeFailure:
    """A grid that does not decode.

    Attributes
    ----------
    reason : Reason
        Why.
    detail : str
        What it was in this case.
    space : CodeSpace
        Kind and size that were taken for granted.
    ec_level : str, optional
        Of the most likely format; None where it is unreadable, or there are no levels.
    mask : int, optional
        Of the most likely format; None where it is unreadable, or there are no masks.
    """

    reason: Reason
    detail: str
    space: CodeSpace
    ec_level: str | None = None
    mask: int | None = None

    def __str__(self) -> str:
        return self.reason.explained(self.detail)
