"""Images made ready for a search; the definitions are in ``warp_backend/images.py``."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def clip_outliers(image, factor, rows_out, limit_out, image_out, busy_out) -> None:
    """Clip at a multiple of the mean magnitude of what is not 0; overwrites."""
    # one after another, so that zeros around an image make no difference
    rows_out[..., 0], rows_out[..., 1] = _added(np.abs(image)), (image != 0).sum(axis=2)
    total, count = _added(rows_out.transpose(2, 0, 1))
    busy_out[:] = count
    limit_out[:] = factor * total / np.maximum(count, 1)
    high = limit_out[:, None, None]
    # of what is not a number neither comparison holds: it stays, and is no limit
    image_out[:] = np.where(image > high, high, np.where(image < -high, -high, image))


def reduce_image(image, ratio, rows_out, image_out) -> None:
    """Sum an image over coarser pixels; overwrites."""
    _, high, wide = image_out.shape
    image_out[:] = _reduced(_reduced(image, high, ratio).swapaxes(1, 2), wide, ratio).swapaxes(1, 2)


def mix_images(images, image_idx, weight, images_out) -> None:
    """Mix images; overwrites."""
    for n, m in enumerate(image_idx):
        images_out[n] = np.tensordot(weight[n], images[m], axes=1)


def _added(values: NDArray) -> NDArray:
    """Sum over the last axis, from the first entry on."""
    return np.cumsum(values, axis=-1)[..., -1] if values.shape[-1] else values.sum(axis=-1)


def _reduced(image: NDArray, count: int, ratio: float) -> NDArray:
    """Sum (B, Y, X) over so many coarser rows: the fine ones that each covers, one after another."""
    fine, near = image.shape[1], np.arange(count) * ratio
    total = np.zeros((len(image), count, image.shape[2]), image.dtype)
    for k in range(math.ceil(ratio) + 1):
        row = near.astype(int) + k
        share = np.clip(np.minimum(near + ratio, row + 1) - np.maximum(near, row), 0.0, None)
        inside = np.flatnonzero((row < fine) & (share > 0))
        total[:, inside] += share[inside, None].astype(image.dtype) * image[:, row[inside]]
    return total
