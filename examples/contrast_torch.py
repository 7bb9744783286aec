#!/usr/bin/env python3
"""Find the motion of a code by contrast maximisation, with PyTorch.

usage: contrast_torch.py RECORDING.h5

Events that are moved back along the right motion fall on top of each other: the image of them has most
contrast, its variance.  `evqr_kernels.torch.splat_events` makes the image and, hand-written, the derivative
of the loss with respect to the motion; the optimiser is PyTorch's.  From standstill, coarse splats first.
"""

import sys

import torch
from recording import report, window_of_arguments

import evqr_kernels.torch
from evqr_kernels import SplatConfig

COARSE_TO_FINE_PX = (4.0, 2.0, 1.0)


def main() -> int:
    """Maximise the contrast."""
    window = window_of_arguments("Contrast maximisation with PyTorch.")
    # from_numpy shares the memory, and so do the kernels: no event is copied
    columns = (window.x, window.y, window.t, window.polarity, window.window_ptr)
    x, y, t, weight, window_ptr = (torch.from_numpy(column) for column in columns)
    travel = torch.zeros(1, 2, requires_grad=True)  # [px] over the window: of the size of one

    for epsilon_px in COARSE_TO_FINE_PX:
        cfg = SplatConfig(epsilon_px=epsilon_px)
        optimiser = torch.optim.LBFGS([travel], lr=0.5, max_iter=30, line_search_fn="strong_wolfe")

        def contrast(cfg: SplatConfig = cfg) -> torch.Tensor:
            motion = travel / window.seconds
            image = evqr_kernels.torch.splat_events(
                x, y, t, weight, window_ptr, motion, shape=window.shape, cfg=cfg
            )
            return image.var()

        blurred = float(contrast().detach())

        def loss(optimiser: torch.optim.Optimizer = optimiser, scale: float = -1.0 / blurred) -> torch.Tensor:
            optimiser.zero_grad()
            value = scale * contrast()
            value.backward()
            return value

        optimiser.step(loss)
    return report(travel.detach().numpy()[0] / window.seconds, window)


if __name__ == "__main__":
    sys.exit(main())
