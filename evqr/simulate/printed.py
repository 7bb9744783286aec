"""The symbols to be printed, from segno."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import segno
from numpy.typing import NDArray

from evqr.errors import UsageError
from evqr.simulate.config import CodePlacement

#: Width of the light margin that the standard asks for [modules].
QUIET_MODULES = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Symbol:
    """A QR code and where it is printed.

    Attributes
    ----------
    placement : CodePlacement
    version, ec_level, mask
    modules : (n, n) uint8    1 = dark; of the symbol, not of an inverted print
    """

    placement: CodePlacement
    version: int
    ec_level: str
    mask: int
    modules: NDArray[np.uint8]

    @property
    def size_px(self) -> float:
        """Width without the quiet zone [px]."""
        return len(self.modules) * self.placement.module_px


def make_symbol(placement: CodePlacement) -> Symbol:
    """Encode a placement's text; raise UsageError where the version cannot hold it."""
    p = placement
    try:
        code = segno.make(p.text, version=p.version, error=p.ec, mask=p.mask, micro=False, boost_error=False)
    except segno.DataOverflowError:
        asked = "any version" if p.version is None else f"version {p.version}"
        raise UsageError(
            f"simulate: the text of {len(p.text)} characters does not fit {asked} at level {p.ec}; "
            "take a higher version, a lower level or a shorter text"
        ) from None
    return Symbol(
        placement=p,
        version=int(code.version),
        ec_level=str(code.error),
        mask=int(code.mask),
        modules=np.array(code.matrix, np.uint8),
    )
