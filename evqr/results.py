"""What flows between the stages: events, poses, readings.

Conventions (README, "Conventions"): x is the column and y the row, integers are pixel centres; time stamps
are int64 microseconds; polarity is -1 (darker) or +1 (brighter).  Code coordinates (u, v) are (column, row)
in modules from the outer corner of the top-left module, so module (i, j) covers [j, j + 1] x [i, i + 1].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray


class ReadStatus(str, Enum):
    """How an attempt ended."""

    READ = "read"
    NO_READ = "no_read"
    NO_CODE = "no_code"
    ERROR = "error"


@dataclass(frozen=True)
class CodeReading:
    """One code that passed, read.

    Attributes
    ----------
    text, data                the payload, as text and as bytes
    symbology                 "QRCode", "MicroQRCode"
    version                   of the symbol: 1 to 40, or text (M2)
    ec_level, mask            "L" "M" "Q" "H", 0 to 7; None where the symbology has none
    t_first_us, t_last_us     event time of first and last sight [us]
    t_read_us                 event time at which it first decoded [us]
    windows                   windows of events that were used until it decoded
    corners_px : (4, 2)       outer corners, from the top-left one clockwise, at ``t_read_us`` [px]
    motion_px_per_s : (2,)    velocity in the image [px/s]
    confidence                0 to 1
    errors_corrected          codewords that error correction changed
    modules : (r, r) int8     the symbol as decoded: -1 dark, +1 light
    estimate : (r, r) float32 the modules as estimated before decoding, same signs
    compute_ms                milliseconds by stage, and "total"
    """

    text: str
    data: bytes
    symbology: str
    version: int | str
    ec_level: str | None
    mask: int | None
    t_first_us: int
    t_last_us: int
    t_read_us: int
    windows: int
    corners_px: NDArray[np.float64]
    motion_px_per_s: NDArray[np.float64]
    confidence: float
    errors_corrected: int
    modules: NDArray[np.int8] = field(repr=False)
    estimate: NDArray[np.float32] = field(repr=False)
    compute_ms: Mapping[str, float]


@dataclass(frozen=True)
class WindowReading:
    """One window of events, read alone and from cold.

    Attributes
    ----------
    status                    READ, NO_READ (a code was found, but does not decode) or NO_CODE
    reason                    why not, in words; "" when read
    window                    index of the window
    t_start_us, t_end_us      bounds of the window [us]
    n_events                  events in it
    text, version             None while unknown
    modules : (r, r) float32  estimate, < 0 dark, > 0 light; None without a code
    motion_px_per_s : (2,)    velocity in the image [px/s]; None without a code
    affine : (2, 3)           W of the paper: (column, row, 1) in px to (u, v) with integers at module centres
    """

    status: ReadStatus
    reason: str
    window: int
    t_start_us: int
    t_end_us: int
    n_events: int
    text: str | None = None
    version: int | None = None
    modules: NDArray[np.float32] | None = None
    motion_px_per_s: NDArray[np.float64] | None = None
    affine: NDArray[np.float64] | None = None
    stage_one_iterations: int = 0
    stage_two_iterations: int = 0
    compute_ms: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ReadResult:
    """All that one recording gave.

    Attributes
    ----------
    status     READ when something was read, NO_READ otherwise, ERROR for a source that could not be read
    reason     why nothing was read, or the error; "" when something was read
    readings   one a code, in order of ``t_read_us``
    seen       what was seen: events, duration_us, windows searched, codes found but not decoded, ...
    compute_ms milliseconds by stage over the whole recording, and "total"
    source     the path, or "" for arrays
    """

    status: ReadStatus
    reason: str
    readings: tuple[CodeReading, ...]
    seen: Mapping[str, Any]
    compute_ms: Mapping[str, float]
    source: str = ""
