"""What was seen of a recording: how much was worked on, and what came nearest to a code."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.values import Value, plain


@dataclass(frozen=True, eq=False, kw_only=True)
class Statistics(Value, Mapping[str, int]):
    """How much of a recording was worked on; also a mapping of its fields.

    Attributes
    ----------
    events : int
        Of the recording, as far as it was read.
    duration_us : int [us]
        From its first event to its last.
    windows : int
        Windows that were searched or followed.
    searches : int
        Searches for a code from cold.
    codes_not_decoded : int
        Codes that were followed and never decoded, each once; what agrees little with a code is none.
    """

    events: int = 0
    duration_us: int = 0
    windows: int = 0
    searches: int = 0
    codes_not_decoded: int = 0

    def __getitem__(self, key: str) -> int:
        if key not in vars(self):
            raise KeyError(key)
        return vars(self)[key]

    def __iter__(self) -> Iterator[str]:
        return iter(vars(self))

    def __len__(self) -> int:
        return len(vars(self))


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate(Value):
    """Something that a code was searched in, and that was not read.

    Attributes
    ----------
    symbol : str
        What it was taken for, in short: QRCode 7.
    score : float
        Its correlation with the modules that such a symbol must have, 0 to 1.
    corners_px : (4, 2) float64 [px]
        Where it was, as of codes that are read.
    """

    symbol: str
    score: float
    corners_px: NDArray[np.float64]

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values.

        Returns
        -------
        record : dict
            By field.
        """
        return {"symbol": self.symbol, "score": plain(self.score, 3), "corners_px": plain(self.corners_px, 3)}


@dataclass(frozen=True, eq=False, kw_only=True)
class Nearest(Value):
    """What came nearest to a code where nothing was read.

    Attributes
    ----------
    t_us : int [us]
        When.
    motion_px_per_s : (2,) float64 [px/s]
        How things moved then.
    candidates : tuple of Candidate
        The best at most, best first, at that time.
    """

    t_us: int
    motion_px_per_s: NDArray[np.float64]
    candidates: tuple[Candidate, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values.

        Returns
        -------
        record : dict
            By field.
        """
        return {**super().to_dict(), "motion_px_per_s": plain(self.motion_px_per_s, 2)}
