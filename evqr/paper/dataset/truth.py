"""What is true of a code in a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Modules = NDArray[np.int8]


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """What is true of a code.

    Attributes
    ----------
    text : str
        What the code says.
    modules : (r, r) int8
        -1 dark, +1 light.
    known : (r, r) bool
        Fixed by the version, so that they do not count.
    """

    text: str
    modules: Modules
    known: NDArray[np.bool_]


def edges_of(modules: Modules) -> int:
    """Count the module sides between dark and light, those towards the quiet zone included."""
    ringed = np.pad(modules, 1, constant_values=1) < 0
    return int((ringed[1:] != ringed[:-1]).sum() + (ringed[:, 1:] != ringed[:, :-1]).sum())
