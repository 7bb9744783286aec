#!/usr/bin/env python3
"""Make a voxel grid of events for a network, with PyTorch, and train with it.

usage: voxel_grid_torch.py RECORDING.h5

`evqr_kernels.columns` takes events as a recording has them; `evqr_kernels.torch.voxel_grid` shares each among
the planes of time around it, and has gradients in the weights and the times.
"""

import argparse
import sys

import h5py
import torch

import evqr_kernels.torch
from evqr_kernels import columns

BINS = 5
STEPS = 8


def read(path: str) -> tuple[evqr_kernels.Columns, tuple[int, int]]:
    """Read the events of a recording by columns, and the sensor's rows and columns."""
    with h5py.File(path) as file:
        events = {name: file["events"][name][:] for name in "xytp"}
        return columns(events), (int(file.attrs["height"]), int(file.attrs["width"]))


def main() -> int:
    """Predict the next plane from the planes before it, with weights of ON and OFF events that are learnt."""
    parser = argparse.ArgumentParser(description="A voxel grid for a network, with PyTorch.")
    parser.add_argument("recording", help=".h5 file with events")
    events, shape = read(parser.parse_args().recording)
    x, y, t, polarity = (torch.from_numpy(column) for column in events)
    window_ptr = torch.tensor([0, len(x)], dtype=torch.int32)
    span = torch.tensor([[float(t.min()), float(t.max())]])

    mass = torch.ones(2, requires_grad=True)  # of ON and of OFF events
    layer = torch.nn.Conv2d(BINS - 1, 1, kernel_size=5, padding=2)
    optimiser = torch.optim.Adam([mass, *layer.parameters()], lr=0.02)
    losses = []
    for _ in range(STEPS):
        optimiser.zero_grad()
        weight = polarity * torch.where(polarity < 0, mass[1], mass[0])
        grid = evqr_kernels.torch.voxel_grid(x, y, t, weight, window_ptr, span, bins=BINS, shape=shape)
        grid = grid / grid.std()  # what networks like
        loss = (layer(grid[:, :-1]) - grid[:, -1:]).square().mean()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    print(f"{len(x)} events, a grid of {tuple(grid.shape)}")
    print(f"loss {losses[0]:.3f}, after {STEPS} steps {losses[-1]:.3f}")
    return int(not losses[-1] < 0.9 * losses[0])


if __name__ == "__main__":
    sys.exit(main())
