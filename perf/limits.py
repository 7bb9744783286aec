"""What one thread of this machine can do at most: bytes moved and multiply-adds a second.

An operation's bound is the larger of the two times that its bytes and its multiply-adds take at these rates;
the fraction reached is that time over the one measured.  Bytes that fit a cache move faster than others, so
that the copy is as large as what the operation touches.
"""

import time
from collections.abc import Callable
from functools import cache

import numpy as np
import warp as wp
from problems import Problem

from evqr_kernels.warp_backend.language import module_of, vector

LARGE = 1 << 28
"""Bytes that are in no cache."""

LANES = 128
STEPS = 4096
ROUNDS = 15


def _seconds(run: Callable[[], object], least: float = 2e-3) -> float:
    """Shortest time of a call: what the machine can do, not what it does beside other work."""
    run()
    count, taken = 1, 0.0
    best = float("inf")
    while taken < least:
        count *= 2
        begin = time.perf_counter()
        for _ in range(count):
            run()
        taken = time.perf_counter() - begin
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        for _ in range(count):
            run()
        best = min(best, (time.perf_counter() - begin) / count)
    return best


@cache
def copy_rate(size: int) -> float:
    """Bytes read and written a second by a plain copy that touches ``size`` bytes."""
    source = np.ones(max(size // 8, 1), np.float32)
    target = np.empty_like(source)
    return 2 * source.nbytes / _seconds(lambda: np.copyto(target, source))


@cache
def _make_multiply_adds(dtype: type) -> wp.Kernel:
    vec = vector(LANES, dtype)

    @wp.kernel(module=module_of("perf_limits", dtype))
    def multiply_adds(factor: wp.array(dtype=dtype), out: wp.array(dtype=vec)):
        by = factor[0]
        total = out[0]
        for _step in range(STEPS):
            total = by * total + out[1]
        out[2] = total

    return multiply_adds


def multiply_adds(dtype: str, times: int = 1) -> Callable[[], None]:
    """Make a call that does ``times * LANES * STEPS``, on independent chains in vector registers."""
    kind = {"float32": wp.float32, "float64": wp.float64}[dtype]
    factor = wp.array([0.5], dtype=kind, device="cpu")
    out = wp.zeros(3, dtype=vector(LANES, kind), device="cpu")
    command = wp.launch(
        _make_multiply_adds(kind), times, inputs=[factor], outputs=[out], device="cpu", record_cmd=True
    )

    def run() -> None:
        command.launch()
        assert out.ptr and factor.ptr  # a command has their addresses only

    return run


def control(dtype: str) -> Callable[[], None]:
    """Make a call of some milliseconds that shares nothing with others: what the machine has for threads."""
    return multiply_adds(dtype, 1000)


@cache
def madd_rate(dtype: str) -> float:
    """Multiply-adds a second of one thread."""
    return LANES * STEPS / _seconds(multiply_adds(dtype))


def least_seconds(problem: Problem, dtype: str) -> tuple[float, str]:
    """Give the time that a problem takes at the least, and what bounds it: "copy" or "multiply-add"."""
    moved = problem.bytes / copy_rate(min(1 << problem.bytes.bit_length(), LARGE))
    computed = problem.madds / madd_rate(dtype)
    return max((moved, "copy"), (computed, "multiply-add"))
