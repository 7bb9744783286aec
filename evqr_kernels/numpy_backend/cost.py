"""Cost of a residual; the formulas are in ``warp_backend/cost.py``."""

from __future__ import annotations

import numpy as np

from evqr_kernels.numpy_backend.residual import brightness_residual, brightness_residual_adjoint


def brightness_cost(luminance, events_image, motion, mask, rows_out, cost_out) -> None:
    """Half the weighted sum of squared residuals; overwrites."""
    residual = np.empty_like(luminance)
    brightness_residual(luminance, events_image, motion, residual)
    cost_out[:] = luminance.dtype.type(0.5) * (mask * residual * residual).sum(axis=(1, 2))


def brightness_cost_adjoint(
    luminance, events_image, motion, mask, adj_cost, rows_out, adj_luminance_out, adj_events_image_out,
    adj_motion_out,
) -> None:  # fmt: skip
    """Adjoint of `brightness_cost` in luminance, events' image and motion; overwrites."""
    residual = np.empty_like(luminance)
    brightness_residual(luminance, events_image, motion, residual)
    adj_events_image_out[:] = adj_cost[:, None, None] * mask * residual
    brightness_residual_adjoint(
        luminance, motion, adj_events_image_out, rows_out, adj_luminance_out, adj_motion_out
    )
