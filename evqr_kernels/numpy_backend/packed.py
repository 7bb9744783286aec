"""Events of eight bytes to images; the formulas are in ``warp_backend/packed.py``."""

from __future__ import annotations

import numpy as np

from evqr_kernels.numpy_backend.lag import deposit_window


def bin_packed_events(x, y, stamp, window_ptr, reduction, image_out) -> None:
    """Count the polarities of events into pixels of ``reduction`` px; accumulates."""
    dtype = image_out.dtype.type
    scale, half = dtype(1.0 / reduction), dtype(0.5)
    for (first, last), image in zip(window_ptr, image_out, strict=True):
        row, column = (
            ((positions[first:last].astype(dtype) + half) * scale).astype(int) for positions in (y, x)
        )
        use = (row < image.shape[0]) & (column < image.shape[1])
        np.add.at(image, (row[use], column[use]), _polarity(stamp[first:last][use]).astype(dtype))


def deposit_packed_events(x, y, stamp, window_ptr, t_ref, motion, frame, extent, deposit_out) -> None:
    """Share events among the cells around them, ON and OFF apart; accumulates."""
    dtype = deposit_out.dtype
    for b, (first, last) in enumerate(window_ptr):
        height, width = extent[b]
        t = (stamp[first:last] - (np.uint32(t_ref[b]) << np.uint32(1))).view(np.int32) >> 1
        weight = _polarity(stamp[first:last]).astype(dtype)
        columns, rows = (positions[first:last].astype(dtype) for positions in (x, y))
        cells = deposit_out[b, :, :height, :width]
        deposit_window(columns, rows, t.astype(dtype), weight, motion[b], frame[b], cells)


def _polarity(stamp):
    return 2 * (stamp & 1).astype(int) - 1
