"""QR codes (ISO/IEC 18004): their sizes, and the modules that all symbols of a size share.

The version alone fixes the function patterns: finders, separators, timing, alignment, the dark module and
version information.  All of it comes from segno, so that the standard's tables are not repeated here.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from evqr.clock import one_time
from evqr.config import DecodeConfig
from evqr.symbol.chance import count_pads, log_padded_contents
from evqr.symbol.decoded import Decoded, DecodeFailure, Effort
from evqr.symbol.qr_codewords import roles_of
from evqr.symbol.qr_decode import Evidence, decode_words
from evqr.symbol.reed_solomon import Symbols
from evqr.symbol.space import Anchor, CodeSpace, Landmark, Timing
from evqr.symbology import Symbology

MIN_VERSION = 1
MAX_VERSION = 40
QUIET_ZONE = 4
SIZES: Mapping[int, tuple[int, int]] = MappingProxyType(
    {version: (17 + 4 * version, 17 + 4 * version) for version in range(MIN_VERSION, MAX_VERSION + 1)}
)


def size_of(version: int) -> int:
    """Return the modules a side of a version.

    Raises
    ------
    ValueError
        Not a version from 1 to 40.
    """
    if version not in SIZES:
        raise ValueError(f"version must be {MIN_VERSION} to {MAX_VERSION}, got {version}")
    return SIZES[version][0]


def version_of(size: int) -> int:
    """Return the version with so many modules a side.

    Raises
    ------
    ValueError
        Not a size that a version has: 21, 25, ... 177.
    """
    version, rest = divmod(size - 17, 4)
    if rest or not MIN_VERSION <= version <= MAX_VERSION:
        raise ValueError(
            f"size must be {size_of(MIN_VERSION)}, {size_of(MIN_VERSION + 1)}, ... {size_of(MAX_VERSION)} "
            f"(17 + 4 version), got {size}"
        )
    return version


def decode(
    q: NDArray[np.float64], space: CodeSpace, config: DecodeConfig, effort: Effort
) -> Decoded | DecodeFailure:
    """Decode a grid; see `evqr.symbol.qr_decode.decode_words`."""
    return decode_words(q, space, config, effort, EVIDENCE)


def _log_contents(data: Symbols, may_end_in_pads: bool) -> float:
    return log_padded_contents(len(data), count_pads(data) if may_end_in_pads else 0)


EVIDENCE = Evidence(log_contents=_log_contents)


def anchors(version: int) -> tuple[Anchor, ...]:
    """Return the finder patterns of a version: at its corner, along u and along v."""
    near, far = 3.5, size_of(version) - 3.5
    return tuple(Anchor(Landmark.FINDER_PATTERN, u, v) for u, v in ((near, near), (far, near), (near, far)))


def timing(version: int) -> tuple[Timing, ...]:
    """Return the timing patterns of a version, between its finder patterns."""
    count = size_of(version) - 16
    return Timing(8.5, 6.5, True, count), Timing(6.5, 8.5, False, count)


@functools.cache
@one_time()
def space(version: int) -> CodeSpace:
    """Return the code space of a version.

    Raises
    ------
    ValueError
        Not a version from 1 to 40.
    """
    finders = anchors(version)
    roles = roles_of(version)
    return CodeSpace(
        symbology=Symbology.QR_CODE,
        version=version,
        known=roles.known,
        values=roles.values,
        anchors=finders,
        quiet_zone=QUIET_ZONE,
    )
