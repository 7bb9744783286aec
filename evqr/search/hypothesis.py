"""Codes that might be where finder patterns are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from evqr.search.models import sizes
from evqr.symbol.space import CodeSpace, without
from evqr.symbol.symbols import space_of

ROW = np.dtype(
    [("pose", np.float64, (3, 3)), ("size", np.intp), ("peaks", np.intp, (3,)), ("inverted", np.bool_)],
    align=True,
)
"""A hypothesis.  All of it is in one array: Python's lock is let go once where some are picked."""


class Hypotheses:
    """N codes that finder patterns of one window could belong to: a `ROW` each."""

    def __init__(self, table: NDArray[np.void]) -> None:
        self.table = table

    @classmethod
    def of(
        cls,
        size: NDArray[np.intp],
        pose: NDArray[np.float64],
        peaks: NDArray[np.intp],
        inverted: NDArray[np.bool_],
    ) -> Hypotheses:
        """Put columns together."""
        table = np.empty(len(size), ROW)
        table["size"], table["pose"], table["peaks"], table["inverted"] = size, pose, peaks, inverted
        return cls(table)

    @property
    def size(self) -> NDArray[np.intp]:
        """Kind and size of the code (N,): which of `evqr.search.models.sizes`."""
        return self.table["size"]

    @property
    def pose(self) -> NDArray[np.float64]:
        """Code coordinates to px (N, 3, 3), affine."""
        return self.table["pose"]

    @property
    def peaks(self) -> NDArray[np.intp]:
        """The finder patterns (N, 3): at the corner, along u and along v; or three times the only one.

        Of two the second is there twice.
        """
        return self.table["peaks"]

    @property
    def inverted(self) -> NDArray[np.bool_]:
        """Light modules on dark (N,)."""
        return self.table["inverted"]

    def __len__(self) -> int:
        return len(self.table)

    def __getitem__(self, which: slice | NDArray) -> Hypotheses:
        """Give some of them."""
        return Hypotheses(self.table[which])

    @classmethod
    def joined(cls, parts: Sequence[Hypotheses]) -> Hypotheses:
        """Give those of several, one after another."""
        some = [part for part in parts if len(part)]
        if len(some) < 2:
            return (some or parts)[0]
        return cls(np.concatenate([part.table for part in some]))

    @property
    def single(self) -> bool:
        """Whether they have one finder pattern each."""
        return bool(len(self)) and self.peaks[0, 0] == self.peaks[0, 1]

    def space(self, which: int) -> CodeSpace:
        """Give the code space of one."""
        size = sizes()[self.size[which]]
        space = space_of(size.symbology, size.version)
        return space if size.hidden is None else without(space, size.hidden)
