"""Blocks of threads as Vulkan's driver for CPUs runs them: only there is seen what a barrier is for.

usage: python -m tests.kernels.blocks_on_vulkan [--op align_poses] [--lanes 32 --lanes 64]

Compares each kernel with the specification as it is, where it must agree, and without one of its barriers,
where it must not.  Needs a process of its own: Taichi runs on one device.  Exit 1 when something is wrong.
"""

import argparse
import sys
import warnings
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

import evqr_kernels
from evqr_kernels import OPERATIONS
from evqr_kernels.taichi_backend import align_blocks, solve_blocks
from evqr_kernels.taichi_backend.language import ti

from . import cases
from .test_align import together

LANES = 32, 64, 128


EXACT = 2e-3
"""Largest error of a kernel that lacks nothing, in float32."""


@dataclass
class Barriers:
    """The barriers of a kernel.

    Attributes
    ----------
    missing : int or None
        The one that is left out, from 0.
    count : int
        How many there are.
    """

    missing: int | None = None
    count: int = 0


@contextmanager
def leaving_out():
    """Count the barriers of a kernel while it is compiled, and leave one of them out."""
    barriers, blocks = Barriers(), ti.simt.block
    sync, mem_sync = blocks.sync, blocks.mem_sync

    def barrier():
        barriers.count += 1
        if barriers.count - 1 != barriers.missing:
            mem_sync()
            sync()

    blocks.sync, blocks.mem_sync = barrier, lambda: None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # of functions that are not Taichi's
            yield barriers
    finally:
        blocks.sync, blocks.mem_sync = sync, mem_sync


def with_lanes(op, lanes):
    """Choose so many lanes of a block for an operation."""
    variants = [replace(each, lanes=lanes) if each.lanes > 1 else each for each in OPERATIONS[op].variants]
    object.__setattr__(OPERATIONS[op], "variants", tuple(variants))


def solve_code(backend, device):
    """Give modules of two codes."""
    arguments = cases.systems(np.random.default_rng(20), np.float32, (19, 17))
    names = [a.name for a in OPERATIONS["solve_code"].inputs]
    given = dict(zip([*names, "start"], arguments, strict=True))
    return evqr_kernels.solve_code(**given, max_iterations=9, tolerance=1e-3, backend=backend, device=device)


def align_poses(backend, device):
    """Give poses of two codes."""
    # one step, which would make good what the one before did wrong; damped, so that the diagonal matters
    options = {"max_iterations": 1, "damping": 0.5, "tolerance": 0.0}
    return together(backend, np.float32, [0, 1, 1, 0, 1], device, **options)


CALLS = {
    "solve_code": (solve_code, solve_blocks.make_solve_blocks),
    "align_poses": (align_poses, align_blocks.make_align_blocks),
}
"""By operation: what is called, and what builds its kernel."""


def errors_of(op, lanes):
    """Yield the barrier that is missing, None at first, and the largest error without it."""
    call, make = CALLS[op]
    expected = call("numpy", "cpu")
    with_lanes(op, lanes)
    with leaving_out() as barriers:
        missing = None
        while missing is None or missing < barriers.count:
            make.cache_clear()
            barriers.missing, barriers.count = missing, 0
            errors = [
                np.abs(one - other).max(initial=0) / np.abs(other).max(initial=1e-30)
                for one, other in zip(call("taichi", "vulkan"), expected, strict=True)
            ]
            yield missing, max(np.nan_to_num(errors, nan=np.inf))
            missing = 0 if missing is None else missing + 1


def main():
    """Print, judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--op", action="append", choices=CALLS)
    parser.add_argument("--lanes", action="append", type=int)
    arguments = parser.parse_args()
    wrong = 0
    for op in arguments.op or CALLS:
        for lanes in arguments.lanes or LANES:
            for missing, error in errors_of(op, lanes):
                right = (error < EXACT) == (missing is None)
                wrong += not right
                what = "as it is" if missing is None else f"without barrier {missing}"
                print(
                    f"{op}, {lanes} lanes, {what}: error {error:.2g}{'' if right else ', WRONG'}", flush=True
                )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
