"""Micro QR codes (ISO/IEC 18004), M1 to M4: one finder pattern, timing along two edges."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from types import MappingProxyType

from evqr.symbol.qr_codewords import roles_of
from evqr.symbol.space import Anchor, CodeSpace, Landmark, Symbology

QUIET_ZONE = 2
SIZES: Mapping[str, tuple[int, int]] = MappingProxyType(
    {"M1": (11, 11), "M2": (13, 13), "M3": (15, 15), "M4": (17, 17)}
)


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
        anchors=(Anchor(Landmark.FINDER_PATTERN, 3.5, 3.5),),
        quiet_zone=QUIET_ZONE,
    )
