"""Matched filters; the formulas are in ``warp_backend/templates.py``."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view


def correlate_templates(
    image, busy, basis, mix, spans, quiet, least, squares_out, floor_out, sums_out, response_out, angle_out
) -> None:
    """Correlate an image, padded by n - 1, with a bank of n x n templates; overwrites."""
    if not response_out.size:
        return
    batch, height, width = response_out.shape
    size = len(spans)
    row = np.arange(size)[:, None]
    disc = ((row >= spans[:, 0]) & (row < spans[:, 1])).astype(image.dtype)
    bank = disc[..., None] * (basis @ mix.T)
    patches = sliding_window_view(image, (size, size), axis=(1, 2))[:, :height, :width]
    for b in range(batch):
        floor = quiet * disc.sum() * (image[b] ** 2).sum() / max(busy[b], 1)
        response = np.tensordot(patches[b], bank, axes=2)
        energy = np.tensordot(patches[b] ** 2, disc, axes=2)
        angle = np.abs(response).argmax(axis=-1)
        best = np.take_along_axis(response, angle[..., None], axis=-1)[..., 0]
        loud = energy > floor
        scale = np.sqrt(energy + floor, where=loud, out=np.ones_like(energy))
        floor_out[b] = floor
        response = np.where(loud, best / scale, 0)
        clear = np.abs(response) >= least
        response_out[b] = np.where(clear, response, 0)
        angle_out[b] = np.where(clear & loud, angle, 0)
