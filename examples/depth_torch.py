#!/usr/bin/env python3
"""Find depth from the events of a moving camera by a sweep of planes, with PyTorch.

usage: depth_torch.py

For a plane at each depth, events are taken back along the homography that the camera's known motion makes of
it, and `evqr_kernels.torch.deposit_events` makes their image.  Where the image is sharpest, the plane is at
its depth.  The events are made here, of two walls, so that depth is known.
"""

import sys

import torch
from usual import compare, usual_deposit

import evqr_kernels.torch

FOCAL_PX, SHAPE = 200.0, (180, 240)
VELOCITY = (1.0, 0.2, 0.5)
"""Of the camera, to the right, down and ahead [m/s]."""

SECONDS, COUNT = 0.06, 20_000
WALLS_M = (1.0, 2.0)
"""On the left and on the right."""

DEPTHS_M = torch.linspace(0.6, 3.0, 25)
WINDOW_PX = 31


def seen(
    x: torch.Tensor, y: torch.Tensor, t: torch.Tensor, inverse_depth: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Give where points at a depth [1/m] are seen a time later: the homography of a plane."""
    right, down, ahead = VELOCITY
    nearer = 1 / (1 - ahead * t * inverse_depth)
    middle = (SHAPE[1] / 2, SHAPE[0] / 2)
    column = (x - middle[0] - FOCAL_PX * right * t * inverse_depth) * nearer + middle[0]
    row = (y - middle[1] - FOCAL_PX * down * t * inverse_depth) * nearer + middle[1]
    return column.contiguous(), row.contiguous()


def made_events() -> tuple[torch.Tensor, ...]:
    """Make events of points on both walls: x, y, t, polarity."""
    random = torch.Generator().manual_seed(2)
    places = torch.rand(500, 2, generator=random) * torch.tensor([SHAPE[1], SHAPE[0]])
    depths = torch.where(places[:, 0] < SHAPE[1] / 2, WALLS_M[0], WALLS_M[1])
    signs = torch.randint(0, 2, (500,), generator=random) * 2.0 - 1
    which = torch.randint(0, 500, (COUNT,), generator=random)
    t = (torch.rand(COUNT, generator=random) - 0.5) * SECONDS
    x, y = seen(*places[which].T, t, 1 / depths[which])
    noise = 0.3 * torch.randn(2, COUNT, generator=random)
    return x + noise[0], y + noise[1], t, signs[which]


def back(
    x: torch.Tensor, y: torch.Tensor, t: torch.Tensor, inverse_depth: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Undo `seen`."""
    right, down, ahead = VELOCITY
    farther = 1 - ahead * t * inverse_depth
    middle = (SHAPE[1] / 2, SHAPE[0] / 2)
    column = (x - middle[0]) * farther + FOCAL_PX * right * t * inverse_depth + middle[0]
    row = (y - middle[1]) * farther + FOCAL_PX * down * t * inverse_depth + middle[1]
    return column.contiguous(), row.contiguous()


def main() -> int:
    """Find each pixel's depth; compare the walls' with the true ones, and an image with the usual code's."""
    x, y, t, polarity = made_events()
    window_ptr = torch.tensor([0, COUNT], dtype=torch.int32)
    still, now = torch.zeros(1, 2), torch.zeros_like(t)

    def image(inverse_depth: torch.Tensor) -> torch.Tensor:
        places = back(x, y, t, inverse_depth)
        return evqr_kernels.torch.deposit_events(*places, now, polarity, window_ptr, still, shape=SHAPE)

    sharp = torch.stack([image(1 / depth).square().sum(dim=1) for depth in DEPTHS_M])
    around = torch.nn.functional.avg_pool2d(sharp, WINDOW_PX, stride=1, padding=WINDOW_PX // 2)[:, 0]
    depth = DEPTHS_M[around.argmax(dim=0)]
    half = SHAPE[1] // 2
    found = [float(part.median()) for part in (depth[:, : half - WINDOW_PX], depth[:, half + WINDOW_PX :])]
    print(f"{COUNT} events, {len(DEPTHS_M)} planes")
    print(f"walls at {found[0]:.2f} and {found[1]:.2f} m, {WALLS_M[0]:.2f} and {WALLS_M[1]:.2f} m true")
    inverse = torch.tensor(0.8, requires_grad=True)
    compare(
        lambda: image(inverse), lambda: usual_deposit(*back(x, y, t, inverse), polarity, SHAPE), [inverse]
    )
    return int(any(abs(one - true) > 0.1 for one, true in zip(found, WALLS_M, strict=True)))


if __name__ == "__main__":
    sys.exit(main())
