#!/usr/bin/env python3
"""Measure what a call from PyTorch costs beside its kernels: few events, a small image, one thread.

usage: framework_calls.py [--beside FOLDER] [--rounds 5]

Microseconds of the best hundredth of the calls, forward, and forward with the backward pass; what PyTorch's
own backward pass through one multiplication takes is part of the latter.  With ``--beside``, a folder with
another version of `evqr_kernels`, processes of both alternate, and ratios are printed.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

CALLS = 1000


def best(run: Callable[[], object]) -> float:
    """Give microseconds of the best hundredth of the calls: the others were interrupted."""
    for _ in range(20):
        run()
    times = []
    for _ in range(CALLS):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return 1e6 * statistics.quantiles(times, n=100)[0]


def measure() -> dict[str, float]:
    """Time calls of two operations."""
    import torch

    import evqr_kernels.torch as ours

    torch.set_num_threads(1)
    count, shape = 64, (32, 32)
    random = torch.Generator().manual_seed(0)
    x, y = (30 * torch.rand(count, generator=random) for _ in range(2))
    t, weight = torch.linspace(-1, 1, count), torch.ones(count)
    window_ptr = torch.tensor([0, count], dtype=torch.int32)
    motion = torch.tensor([[1.0, 2.0]])
    moving, heavy = motion.clone().requires_grad_(), weight.clone().requires_grad_()
    events = x, y, t

    def splat(weight: torch.Tensor, motion: torch.Tensor) -> torch.Tensor:
        return ours.splat_events(*events, weight, window_ptr, motion, shape=shape)

    def deposit(weight: torch.Tensor, motion: torch.Tensor) -> torch.Tensor:
        return ours.deposit_events(*events, weight, window_ptr, motion, shape=shape)

    image, cells, one = torch.ones(1, *shape), torch.ones(1, 2, *shape), torch.ones_like(motion)
    return {
        "splat_events": best(lambda: splat(weight, motion)),
        "splat_events, backward": best(lambda: torch.autograd.grad(splat(weight, moving), moving, image)),
        "deposit_events": best(lambda: deposit(weight, motion)),
        "deposit_events, backward": best(lambda: torch.autograd.grad(deposit(heavy, motion), heavy, cells)),
        "a multiplication of PyTorch": best(lambda: motion * one),
        "a multiplication, backward": best(lambda: torch.autograd.grad(moving * one, moving, one)),
    }


def of_process(folder: Path) -> dict[str, float]:
    """Measure the version in a folder."""
    environment = os.environ | {"PYTHONPATH": str(folder)}
    command = [sys.executable, __file__, "--once"]
    return json.loads(subprocess.run(command, env=environment, check=True, capture_output=True).stdout)


def main() -> int:
    """Measure this version, and another one in turn with it."""
    parser = argparse.ArgumentParser(description="What a call from PyTorch costs beside its kernels.")
    parser.add_argument("--beside", type=Path, help="folder with another version of evqr_kernels")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--once", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.once:
        print(json.dumps(measure()))
        return 0
    folders = [Path(__file__).parent.parent, *filter(None, [arguments.beside])]
    rounds = [[of_process(folder) for folder in folders] for _ in range(arguments.rounds)]
    for name in rounds[0][0]:
        ours = min(each[0][name] for each in rounds)
        line = f"{name:28} {ours:7.1f} us"
        if arguments.beside:
            ratios = sorted(each[1][name] / each[0][name] for each in rounds)
            line += f"   beside {min(each[1][name] for each in rounds):7.1f} us"
            line += f"   ratio {statistics.median(ratios):.2f} ({ratios[0]:.2f} to {ratios[-1]:.2f})"
        print(line)
    return 0


if __name__ == "__main__":
    sys.exit(main())
