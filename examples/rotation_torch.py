#!/usr/bin/env python3
"""Find a camera's rotation from events by contrast maximisation, with PyTorch.

usage: rotation_torch.py

The warp is ours: each event's ray is turned back by the angular velocity times its time.
`evqr_kernels.torch.deposit_events` makes the image of the turned events, and its gradients in their positions
go on through the warp.  The events are made here, so that the rotation is known.
"""

import sys

import torch
from usual import compare, usual_deposit

import evqr_kernels.torch

FOCAL_PX, SHAPE = 200.0, (180, 240)
TRUE = torch.tensor([0.8, -1.2, 2.0])
"""Angular velocity about the axes to the right, down and ahead [rad/s]."""

SECONDS, COUNT, TOLERANCE = 0.05, 20_000, 0.02


def turned(x: torch.Tensor, y: torch.Tensor, angle: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Give where pixels are seen after small turns (3, E) of the camera [rad]."""
    u, v = (x - SHAPE[1] / 2) / FOCAL_PX, (y - SHAPE[0] / 2) / FOCAL_PX
    right, down, ahead = angle
    depth = 1 + down * u - right * v
    column = (u - down + ahead * v) / depth
    row = (v + right - ahead * u) / depth
    return FOCAL_PX * column + SHAPE[1] / 2, FOCAL_PX * row + SHAPE[0] / 2


def made_events() -> tuple[torch.Tensor, ...]:
    """Make events of points that the camera turns past: x, y, t, polarity."""
    random = torch.Generator().manual_seed(4)
    places = torch.rand(400, 2, generator=random) * torch.tensor([SHAPE[1], SHAPE[0]])
    signs = torch.randint(0, 2, (400,), generator=random) * 2.0 - 1
    which = torch.randint(0, 400, (COUNT,), generator=random)
    t = (torch.rand(COUNT, generator=random) - 0.5) * SECONDS
    x, y = turned(*places[which].T, TRUE[:, None] * t)
    noise = 0.3 * torch.randn(2, COUNT, generator=random)
    return x + noise[0], y + noise[1], t, signs[which]


def main() -> int:
    """Find the rotation; compare it with the true one, and the image with the usual code's."""
    x, y, t, polarity = made_events()
    window_ptr = torch.tensor([0, COUNT], dtype=torch.int32)
    still, now = torch.zeros(1, 2), torch.zeros_like(t)
    rotation = torch.zeros(3, requires_grad=True)

    def moved() -> tuple[torch.Tensor, torch.Tensor]:
        back = turned(x, y, -rotation[:, None] * t)
        return back[0].contiguous(), back[1].contiguous()

    def image() -> torch.Tensor:
        return evqr_kernels.torch.deposit_events(*moved(), now, polarity, window_ptr, still, shape=SHAPE)

    def blurred() -> torch.Tensor:
        return torch.nn.functional.avg_pool2d(image(), 5, stride=1)

    optimiser = torch.optim.LBFGS([rotation], lr=0.5, max_iter=40, line_search_fn="strong_wolfe")

    def loss(make=blurred) -> torch.Tensor:
        optimiser.zero_grad()
        value = -make().square().mean()
        value.backward()
        return value

    optimiser.step(loss)
    found = rotation.detach()
    error = float((found - TRUE).norm() / TRUE.norm())
    print(f"{COUNT} events: found {found.numpy().round(3)}, true {TRUE.numpy()} rad/s, {error:.1%} apart")
    compare(image, lambda: usual_deposit(*moved(), polarity, SHAPE), [rotation])
    return int(error > TOLERANCE)


if __name__ == "__main__":
    sys.exit(main())
