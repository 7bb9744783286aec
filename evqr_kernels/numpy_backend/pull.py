"""What damping pulls modules to; the formula is in ``warp_backend/pull.py``."""

from __future__ import annotations

import numpy as np


def pull_modules(seen, q, damping, certainty, rhs_out, unclear_out) -> None:
    """Right-hand side of the next solution, and how many modules of each row are unclear; overwrites."""
    leaning = certainty * (q + 1)
    expected = np.fmax(np.fmin(leaning, 1), -1)  # what is no number is pulled nowhere
    rhs_out[:] = seen + damping[:, None, None] * (1 - expected)
    unclear_out[:] = np.count_nonzero(np.abs(leaning) < 1, axis=2)
