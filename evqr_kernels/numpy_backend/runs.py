"""Runs of one sign along straight lines; the formulas are in ``warp_backend/runs.py``."""

from __future__ import annotations

import numpy as np


def line_runs(image, slope, steep, threshold, most, runs_out) -> None:
    """Greatest sum of a run of each sign along each line; overwrites."""
    lines = runs_out.shape[3]
    runs_out[:] = 0
    for b, a in np.argwhere(threshold > 0):
        seen = image[b].T if steep[a] else image[b]
        across, along = seen.shape
        t = np.arange(along)
        at = (np.arange(lines) - (along if slope[a] > 0 else 0))[:, None] + slope[a] * t
        first = np.floor(at).astype(int)
        wide = np.pad(seen, ((1, 1), (0, 0)))  # with zeros around
        near, far = (wide[np.clip(each + 1, 0, across + 1), t] for each in (first, first + 1))
        e = near + (at - first) * (far - near)
        for s, sign in enumerate((1, -1)):
            excess = np.clip(sign * e / threshold[b, a], -most, most) - 1
            total = np.pad(np.cumsum(excess, axis=1), ((0, 0), (1, 0)))
            gain = total - np.minimum.accumulate(total, axis=1)
            runs_out[b, a, s] = gain.max(axis=1)
