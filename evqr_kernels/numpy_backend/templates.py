"""Matched filters at reduced resolution; the formulas are in ``warp_backend/templates.py``."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray


def reduce_image(image, ratio, rows_out, image_out) -> None:
    """Sum an image over coarser pixels; overwrites."""
    rows = _coverage(image_out.shape[1], image.shape[1], ratio).astype(image.dtype)
    columns = _coverage(image_out.shape[2], image.shape[2], ratio).astype(image.dtype)
    image_out[:] = rows @ image @ columns.T


def _coverage(coarse: int, fine: int, ratio: float) -> NDArray[np.float64]:
    """(coarse, fine) share of each fine pixel that a coarse one covers."""
    near = np.arange(coarse)[:, None] * ratio
    pixel = np.arange(fine)
    return np.clip(np.minimum(near + ratio, pixel + 1) - np.maximum(near, pixel), 0.0, None)


def correlate_templates(image, bank, disc, floor, response_out, angle_out) -> None:
    """Correlate an image, padded by n - 1, with a bank of n x n templates; overwrites."""
    batch, height, width = response_out.shape
    patches = sliding_window_view(image, disc.shape, axis=(1, 2))[:, :height, :width]
    for b in range(batch):
        response = np.tensordot(patches[b], bank, axes=2)
        energy = np.tensordot(patches[b] ** 2, disc, axes=2)
        angle = np.abs(response).argmax(axis=-1)
        best = np.take_along_axis(response, angle[..., None], axis=-1)[..., 0]
        loud = energy >= floor[b]
        scale = np.sqrt(energy + floor[b], where=loud, out=np.ones_like(energy))
        response_out[b] = np.where(loud, best / scale, 0)
        angle_out[b] = np.where(loud, angle, 0)
