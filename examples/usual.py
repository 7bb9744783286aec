"""What the examples are measured against: images of events as they are usually written in PyTorch."""

from __future__ import annotations

import time
from collections.abc import Callable

import torch

ROUNDS = 15


def usual_deposit(
    x: torch.Tensor, y: torch.Tensor, weight: torch.Tensor, shape: tuple[int, int]
) -> torch.Tensor:
    """Share events among the four pixels around them, ON and OFF apart: (1, 2, Y, X), by `index_add`."""
    height, width = shape
    inside = (x >= 0) & (y >= 0) & (x < width - 1) & (y < height - 1)
    x, y, weight = x[inside], y[inside], weight[inside]
    column, row = x.detach().floor(), y.detach().floor()
    right, below = x - column, y - row
    first = ((weight < 0) * height + row.long()) * width + column.long()
    image = torch.zeros(2 * height * width, dtype=weight.dtype)
    image = image.index_add(0, first, weight * (1 - right) * (1 - below))
    image = image.index_add(0, first + 1, weight * right * (1 - below))
    image = image.index_add(0, first + width, weight * (1 - right) * below)
    image = image.index_add(0, first + width + 1, weight * right * below)
    return image.view(1, 2, height, width)


def compare(
    ours: Callable[[], torch.Tensor], usual: Callable[[], torch.Tensor], varied: list[torch.Tensor]
) -> float:
    """Time both with their gradients, on one thread, by turns; print and give how many times ours is faster.

    Raises
    ------
    RuntimeError
        If images or gradients differ by more than rounding.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    images = [run().detach() for run in (ours, usual)]
    gradients = [torch.autograd.grad(run().square().sum(), varied) for run in (ours, usual)]
    for one, other in zip((images[0], *gradients[0]), (images[1], *gradients[1]), strict=True):
        if (one - other).abs().max() > 2e-4 * other.abs().max():
            raise RuntimeError("the usual code gives another image")
    times: list[list[float]] = [[], []]
    for _ in range(ROUNDS):
        for run, taken in zip((ours, usual), times, strict=True):
            begin = time.perf_counter()
            torch.autograd.grad(run().square().sum(), varied)
            taken.append(time.perf_counter() - begin)
    torch.set_num_threads(threads)
    # the best of each: on a shared machine the others were interrupted
    ours_ms, usual_ms = (1e3 * min(taken) for taken in times)
    ratio = usual_ms / ours_ms
    print(f"with its gradients {ours_ms:.2f} ms, usual code {usual_ms:.2f} ms: {ratio:.1f} times")
    return ratio
