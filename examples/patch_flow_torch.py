#!/usr/bin/env python3
"""Find the optical flow of patches by contrast maximisation, with PyTorch.

usage: patch_flow_torch.py RECORDING.h5

The warp is ours, not the kernels': each event moves by the flow at its place, interpolated between patches.
`evqr_kernels.torch.splat_events` makes the image of the moved events and has gradients in their positions;
PyTorch takes these on to the flow.  Where a patch has few events its neighbours tell.  (`deposit_events` is
sharpest where events stay on whole pixels: an ascent would not leave a flow of zero.)
"""

import sys

import torch
from recording import Window, report, window_of_arguments
from torch.nn.functional import grid_sample

import evqr_kernels.torch
from evqr_kernels import SplatConfig

PATCH_PX = 40
COARSE_TO_FINE_PX = (2.0, 1.0)
SMOOTH = 0.02


def patch_flow(window: Window) -> tuple[torch.Tensor, torch.Tensor]:
    """Give the flow of patches (1, 2, rows, columns) and of events (E, 2), in px over the window."""
    columns = (window.x, window.y, window.t, window.polarity, window.window_ptr)
    x, y, t, weight, window_ptr = (torch.from_numpy(column) for column in columns)
    height, width = window.shape
    part = (t / window.seconds)[:, None]  # of the window, from its middle
    places = torch.stack([2 * (x + 0.5) / width - 1, 2 * (y + 0.5) / height - 1], dim=1)[None, None]
    flow = torch.zeros(1, 2, -(-height // PATCH_PX), -(-width // PATCH_PX), requires_grad=True)

    def of_events() -> torch.Tensor:
        return grid_sample(flow, places, padding_mode="border", align_corners=False)[0, :, 0].T

    def contrast(cfg: SplatConfig) -> torch.Tensor:
        moved_x, moved_y = (torch.stack([x, y]) - (part * of_events()).T).contiguous()
        still, now = torch.zeros(1, 2), torch.zeros_like(t)
        image = evqr_kernels.torch.splat_events(
            moved_x, moved_y, now, weight, window_ptr, still, shape=window.shape, cfg=cfg
        )
        return image.var()

    for epsilon_px in COARSE_TO_FINE_PX:
        cfg = SplatConfig(epsilon_px=epsilon_px)
        optimiser = torch.optim.LBFGS([flow], lr=0.5, max_iter=10, line_search_fn="strong_wolfe")
        blurred = float(contrast(cfg).detach())

        def loss(
            optimiser: torch.optim.Optimizer = optimiser, cfg: SplatConfig = cfg, blurred: float = blurred
        ) -> torch.Tensor:
            optimiser.zero_grad()
            rough = flow.diff(dim=2).square().mean() + flow.diff(dim=3).square().mean()
            value = SMOOTH * rough - contrast(cfg) / blurred
            value.backward()
            return value

        optimiser.step(loss)
    return flow.detach(), of_events().detach()


def main() -> int:
    """Find the flow, and compare its mean over the events with the motion of the recording's code."""
    window = window_of_arguments("Patch flow with PyTorch.")
    flow, of_events = patch_flow(window)
    print(f"{flow.shape[2]} x {flow.shape[3]} patches of {PATCH_PX} px")
    return report(of_events.mean(dim=0).numpy() / window.seconds, window)


if __name__ == "__main__":
    sys.exit(main())
