#!/usr/bin/env python3
"""Find the motion of a code by contrast maximisation, with nothing but NumPy and the kernels.

usage: contrast_numpy.py RECORDING.h5

As contrast_torch.py, with the chain rule by hand: `splat_events` forward, the variance's derivative with
respect to the image, `splat_events_adjoint` back; and with the plainest ascent there is.
"""

import sys

import numpy as np
from recording import Window, report, window_of_arguments

from evqr_kernels import SplatConfig, splat_events, splat_events_adjoint

COARSE_TO_FINE_PX = (4.0, 2.0, 1.0)
FIRST_STEP_PX, LAST_STEP_PX = 2.0, 0.002


def contrast(window: Window, travel: np.ndarray, cfg: SplatConfig) -> tuple[float, np.ndarray]:
    """Variance of the events' image, and its derivative with respect to the travel [px]."""
    events = (window.x, window.y, window.t, window.polarity, window.window_ptr)
    motion = (travel[None] / window.seconds).astype(np.float32)
    image = splat_events(*events, motion, shape=window.shape, cfg=cfg)
    adj_image = (2.0 / image.size) * (image - image.mean())
    _, adj_motion, *_ = splat_events_adjoint(*events, motion, adj_image, cfg=cfg)
    return float(image.var()), adj_motion[0] / window.seconds


def main() -> int:
    """Maximise the contrast."""
    window = window_of_arguments("Contrast maximisation with NumPy.")
    travel = np.zeros(2)
    for epsilon_px in COARSE_TO_FINE_PX:
        cfg, step = SplatConfig(epsilon_px=epsilon_px), FIRST_STEP_PX
        best, slope = contrast(window, travel, cfg)
        while step > LAST_STEP_PX:
            further = travel + step * slope / np.linalg.norm(slope)
            value, slope_there = contrast(window, further, cfg)
            if value > best:
                travel, best, slope = further, value, slope_there
            else:
                step /= 2.0
    return report(travel / window.seconds, window)


if __name__ == "__main__":
    sys.exit(main())
