"""Images made ready for a search; the definitions are in ``warp_backend/images.py``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def clip_outliers(image, factor, rows_out, limit_out, image_out, busy_out) -> None:
    """Clip at a multiple of the mean magnitude of what is not 0; overwrites."""
    rows_out[..., 0], rows_out[..., 1] = np.abs(image).sum(axis=2), (image != 0).sum(axis=2)
    total, count = rows_out.sum(axis=1).T
    busy_out[:] = count
    limit_out[:] = factor * total / np.maximum(count, 1)
    high = limit_out[:, None, None]
    # of what is not a number neither comparison holds: it stays, and is no limit
    image_out[:] = np.where(image > high, high, np.where(image < -high, -high, image))


def reduce_image(image, ratio, rows_out, image_out) -> None:
    """Sum an image over coarser pixels; overwrites."""
    rows = _coverage(image_out.shape[1], image.shape[1], ratio).astype(image.dtype)
    columns = _coverage(image_out.shape[2], image.shape[2], ratio).astype(image.dtype)
    image_out[:] = rows @ image @ columns.T


def mix_images(images, image_idx, weight, images_out) -> None:
    """Mix images; overwrites."""
    for n, m in enumerate(image_idx):
        images_out[n] = np.tensordot(weight[n], images[m], axes=1)


def _coverage(coarse: int, fine: int, ratio: float) -> NDArray[np.float64]:
    """(coarse, fine) share of each fine pixel that a coarse one covers."""
    near = np.arange(coarse)[:, None] * ratio
    pixel = np.arange(fine)
    return np.clip(np.minimum(near + ratio, pixel + 1) - np.maximum(near, pixel), 0.0, None)
