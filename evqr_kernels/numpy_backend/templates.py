"""Matched filters; the formulas are in ``warp_backend/templates.py``."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from evqr_kernels.numpy_backend.levels import parts_of_levels


def correlate_templates(
    image, busy, basis, mix, spans, rows, extent, quiet, first, least, squares_out, floor_out, sums_out,
    response_out, angle_out,
) -> None:  # fmt: skip
    """Correlate an image, padded by n - 1, with a bank of n x n templates; overwrites within the extent."""
    size = len(spans)
    row = np.arange(size)[:, None]
    disc = ((row >= spans[:, 0]) & (row < spans[:, 1])).astype(image.dtype)
    for b, k, part in parts_of_levels(rows, extent):
        bank = disc[..., None] * (basis[b] @ mix[b].T)
        high, wide = response_out[b][part].shape
        if not high * wide:
            continue
        level = image[b, part[0].start :, :][: high + size - 1, : wide + size - 1]
        patches = sliding_window_view(level, (size, size))
        floor = quiet[k] * disc.sum() * (level**2).sum() / max(busy[b], 1)
        response = np.tensordot(patches, bank, axes=2)
        energy = np.tensordot(patches**2, disc, axes=2)
        angle = np.abs(response).argmax(axis=-1)
        best = np.take_along_axis(response, angle[..., None], axis=-1)[..., 0]
        loud = energy > floor
        floor_out[b, k] = floor
        loud &= np.tensordot(patches, disc * basis[b, ..., 0], axes=2) ** 2 >= first**2 * (energy + floor)
        scale = np.sqrt(energy + floor, where=loud, out=np.ones_like(energy))
        response = np.where(loud, best / scale, 0)
        clear = np.abs(response) >= least
        response_out[b][part] = np.where(clear, response, 0)
        angle_out[b][part] = np.where(clear & loud, angle, 0)
