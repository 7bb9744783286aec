"""rMQR codes (ISO/IEC 23941), R7x43 to R17x139: rectangles, one finder pattern, timing along all edges."""

from __future__ import annotations

import functools
from dataclasses import replace

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


def anchors(version: str) -> tuple[Anchor, ...]:
    """Return the finder pattern of a version: they all have it at their corner."""
    return (Anchor(Landmark.FINDER_PATTERN, 3.5, 3.5),)


def timing(version: str) -> tuple[Timing, ...]:
    """Return the timing patterns of a version: along its edges, and between its alignment patterns."""
    rows, columns = SIZES[version]
    inner = ALIGNMENT_COLUMNS[columns]
    # corner finder patterns, alignment patterns and the finder sub pattern cross them
    lines = [
        Timing(8.5, 0.5, True, columns - 8, QUIET_ZONE, (*(c - 8 for c in inner), columns - 10)),
        Timing(columns - 0.5, 0.5, False, rows, QUIET_ZONE, (1, rows - 4, rows - 2)),
        *(Timing(c + 0.5, 0.5, False, rows, QUIET_ZONE) for c in inner),
    ]
    left = 8 if rows == 7 else 0
    crossed = (*(c - left for c in inner), columns - left - 4, columns - left - 2, *(() if left else (1,)))
    lines.append(Timing(left + 0.5, rows - 0.5, True, columns - left, QUIET_ZONE, crossed))
    if rows > 9:
        lines.append(Timing(0.5, 8.5, False, rows - 8, QUIET_ZONE, (rows - 10,)))
    return tuple(lines)


@functools.cache
@one_time()
def space(version: str) -> CodeSpace:
    """Return the code space of a version.

    Raises
    ------
    ValueError
        Not a version from R7x43 to R17x139.
    """
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
