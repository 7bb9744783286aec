"""Codes that might be where finder patterns are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.search.models import sizes
from evqr.symbol.space import CodeSpace
from evqr.symbol.symbols import space_of


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """N codes that finder patterns of one window could belong to.

    Attributes
    ----------
    size : (N,) intp
        Kind and size of the code: which of `evqr.search.models.sizes`.
    pose : (N, 3, 3) float64
        Code coordinates to px, affine.
    peaks : (N, 3) intp
        The finder patterns: at the corner, along u and along v; three times the same where there is one.
    inverted : (N,) bool
        Light modules on dark.
    """

    size: NDArray[np.intp]
    pose: NDArray[np.float64]
    peaks: NDArray[np.intp]
    inverted: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.size)

    def __getitem__(self, which: slice | NDArray) -> Hypotheses:
        """Give some of them."""
        return Hypotheses(self.size[which], self.pose[which], self.peaks[which], self.inverted[which])

    @classmethod
    def joined(cls, parts: Sequence[Hypotheses]) -> Hypotheses:
        """Give those of several, one after another."""
        some = [part for part in parts if len(part)]
        if len(some) < 2:
            return (some or parts)[0]
        columns = zip(*((part.size, part.pose, part.peaks, part.inverted) for part in some), strict=True)
        return cls(*(np.concatenate(column) for column in columns))

    @property
    def single(self) -> bool:
        """Whether they have one finder pattern each."""
        return bool(len(self)) and self.peaks[0, 0] == self.peaks[0, 1]

    def space(self, which: int) -> CodeSpace:
        """Give the code space of one."""
        size = sizes()[self.size[which]]
        return space_of(size.symbology, size.version)
