"""What damping pulls modules to; the formula is in ``warp_backend/pull.py``."""

from __future__ import annotations

import numpy as np


def pull_modules(seen, q, damping, certainty, rhs_out, unclear_out) -> None:
    """Right-hand side of the next solution, and how many modules of each row are unclear; overwrites."""
    expected = np.clip(certainty * (q + 1), -1, 1)
    rhs_out[:] = seen + damping[:, None, None] * (1 - expected)
    unclear_out[:] = np.count_nonzero(np.abs(expected) < 1, axis=2)
