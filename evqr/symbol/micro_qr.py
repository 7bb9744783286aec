"""Micro QR codes (ISO/IEC 18004), M1 to M4: one finder pattern, timing along two edges, one block."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from evqr.config import DecodeConfig
from evqr.reason import Reason
from evqr.symbol.decoded import Decoded, DecodeFailure, Effort
from evqr.symbol.qr_codewords import HALF_CODEWORDS, roles_of
from evqr.symbol.qr_decode import Evidence, decode_words
from evqr.symbol.reed_solomon import Symbols
from evqr.symbol.space import Anchor, CodeSpace, Landmark, Timing
from evqr.symbology import Symbology

QUIET_ZONE = 2
M1_DIGITS = 5
"""Most that M1 holds, and it holds nothing but digits."""

SIZES: Mapping[str, tuple[int, int]] = MappingProxyType(
    {"M1": (11, 11), "M2": (13, 13), "M3": (15, 15), "M4": (17, 17)}
)


def anchors(version: str) -> tuple[Anchor, ...]:
    """Return the finder pattern of a version: they all have it at their corner."""
    return (Anchor(Landmark.FINDER_PATTERN, 3.5, 3.5),)


def timing(version: str) -> tuple[Timing, ...]:
    """Return the timing patterns of a version, along two of its edges."""
    count = SIZES[version][0] - 8
    return Timing(8.5, 0.5, True, count, QUIET_ZONE), Timing(0.5, 8.5, False, count, QUIET_ZONE)


@functools.cache
def space(version: str) -> CodeSpace:
    """Return the code space of a version.

    Raises
    ------
    ValueError
        Not a version from M1 to M4.
    """
    if version not in SIZES:
        raise ValueError(f"version must be one of {', '.join(SIZES)}, got {version}")
    roles = roles_of(version)
    return CodeSpace(
        symbology=Symbology.MICRO_QR_CODE,
        version=version,
        known=roles.known,
        values=roles.values,
        anchors=anchors(version),
        quiet_zone=QUIET_ZONE,
    )


def decode(
    q: NDArray[np.float64], space: CodeSpace, config: DecodeConfig, effort: Effort
) -> Decoded | DecodeFailure:
    """Decode a grid; see `evqr.symbol.qr_decode.decode_words`.

    M1 has just enough evidence where it counts as contents only what can be written, one to five digits in
    the one way that an encoder writes them; so nothing else is accepted.
    """
    outcome = decode_words(q, space, config, effort, _evidence(space))
    if isinstance(outcome, Decoded) and space.version == "M1" and not _as_written(outcome):
        return DecodeFailure(
            reason=Reason.NO_CONTENT, detail=f"mask {outcome.mask}", space=space, mask=outcome.mask
        )
    return outcome


@functools.cache
def _evidence(space: CodeSpace) -> Evidence:
    def log_contents(data: Symbols, may_end_in_pads: bool) -> float:
        if space.version == "M1":
            return math.log(sum(10**n for n in range(1, M1_DIGITS + 1)))
        return math.log(2.0) * (8 * len(data) - (4 if space.version in HALF_CODEWORDS else 0))

    return Evidence(log_contents=log_contents, format_counts=True)


def _as_written(decoded: Decoded) -> bool:
    """Whether an encoder writes the content of an M1 symbol so: mask, padding and all."""
    import segno

    if len(decoded.text) > M1_DIGITS or not decoded.text.isdecimal():
        return False
    symbol = segno.make(decoded.text, version="M1", mask=decoded.mask)
    return np.array_equal(np.array(symbol.matrix, dtype=bool), decoded.modules < 0)
