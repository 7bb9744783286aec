"""rMQR codes (ISO/IEC 23941), R7x43 to R17x139: rectangles, one finder pattern, timing along all edges."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from evqr.clock import one_time
from evqr.config import DecodeConfig
from evqr.symbol.decoded import Decoded, DecodeFailure, Effort
from evqr.symbol.qr import EVIDENCE
from evqr.symbol.qr_codewords import roles_of
from evqr.symbol.qr_decode import decode_words
from evqr.symbol.rmqr_tables import ALIGNMENT_COLUMNS, SIZES
from evqr.symbol.space import Anchor, CodeSpace, Landmark, Timing
from evqr.symbology import Symbology

QUIET_ZONE = 2

HEAD_COLUMNS = 18
"""Columns, from the finder pattern on, in which all sizes of a height have the same modules known."""

HEADS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        f"R{rows}": tuple(name for name, (height, _) in SIZES.items() if height == rows)
        for rows in dict.fromkeys(height for height, _ in SIZES.values())
    }
)
"""What sizes of a height begin with, and which they are."""


def anchors(version: str) -> tuple[Anchor, ...]:
    """Return the finder pattern of a version: they all have it at their corner."""
    return (Anchor(Landmark.FINDER_PATTERN, 3.5, 3.5),)


def timing(version: str) -> tuple[Timing, ...]:
    """Return the timing patterns of a version, or of a head: along edges, between alignment patterns."""
    if version in HEADS:
        (rows, _), last, inner, quiet = SIZES[HEADS[version][0]], HEAD_COLUMNS - 1, (), 0
    else:
        rows, last = SIZES[version]
        inner, quiet = ALIGNMENT_COLUMNS[last], QUIET_ZONE
    # corner finder patterns, alignment patterns and the finder sub pattern cross them
    left = 8 if rows == 7 else 0
    above, below = [c - 8 for c in inner], [1 - left, *(c - left for c in inner)]
    lines = [Timing(c + 0.5, 0.5, False, rows, QUIET_ZONE) for c in inner]
    if quiet:
        above.append(last - 10)
        below += [last - left - 4, last - left - 2]
        lines.append(Timing(last - 0.5, 0.5, False, rows, quiet, (1, rows - 4, rows - 2)))
    lines.append(Timing(8.5, 0.5, True, last - 8, quiet, tuple(above)))
    lines.append(Timing(left + 0.5, rows - 0.5, True, last - left, quiet, tuple(k for k in below if k > 0)))
    if rows > 9:
        lines.append(Timing(0.5, 8.5, False, rows - 8, QUIET_ZONE, (rows - 10,)))
    return tuple(lines)


@functools.cache
@one_time()
def space(version: str) -> CodeSpace:
    """Return the code space of a version, or of a head.

    Raises
    ------
    ValueError
        Not a version from R7x43 to R17x139, nor R7 to R17.
    """
    if version in HEADS:
        whole = space(HEADS[version][-1])
        return replace(
            whole,
            version=version,
            known=whole.known[:, :HEAD_COLUMNS].copy(),
            values=whole.values[:, :HEAD_COLUMNS].copy(),
        )
    if version not in SIZES:
        raise ValueError(f"version must be one of {', '.join(SIZES)}, got {version}")
    roles = roles_of(version)
    return CodeSpace(
        symbology=Symbology.RMQR_CODE,
        version=version,
        known=roles.known,
        values=roles.values,
        anchors=anchors(version),
        quiet_zone=QUIET_ZONE,
    )


def decode(
    q: NDArray[np.float64], space: CodeSpace, config: DecodeConfig, effort: Effort
) -> Decoded | DecodeFailure:
    """Decode a grid; see `evqr.symbol.qr_decode.decode_words`."""
    return replace(decode_words(q, space, config, effort, EVIDENCE), mask=None)  # there is but one
