#!/usr/bin/env python3
"""Launch one operation many times on buffers of its own: something for a profiler to look at.

usage: profile_kernel.py OP [--case production] [--launches 20] [--backend warp] [--device cpu]
                         [--dtype float32]

Unrecorded launches of a backend's method, without checks, allocation or transfers in between.  For example

    ncu --kernel-name regex:splat python perf/profile_kernel.py splat_events --device cuda:0
    perf record python perf/profile_kernel.py splat_events --launches 500
"""

import argparse
import statistics
import sys
import time

import cases
import ops
from problems import Prepared, Size


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("op", choices=tuple(ops.PROBLEMS))
    parser.add_argument("--case", choices=tuple(cases.SIZES), default="production")
    parser.add_argument("--launches", type=int, default=20)
    parser.add_argument("--backend", choices=("numpy", "warp", "taichi"), default="warp")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--dtype", choices=("float32", "float64"), default="float32")
    arguments = parser.parse_args()

    problem = ops.build(arguments.op, Size(**cases.SIZES[arguments.case]), arguments.dtype)
    prepared = Prepared(problem, arguments.backend, arguments.device)
    times, busy = [], []
    for _ in range(arguments.launches + 1):
        prepared.wait()
        begin, began = time.perf_counter(), time.process_time()
        prepared()
        prepared.wait()
        times.append(time.perf_counter() - begin)
        busy.append(time.process_time() - began)
    first, *steady = times
    print(f"{arguments.op} on {arguments.device}: first launch {1e3 * first:.1f} ms (compiled if need be)")
    if steady:
        median = statistics.median(steady)
        rate = problem.items / median / 1e6
        processor = 1e3 * statistics.median(busy[1:])
        print(f"then {1e3 * median:.3f} ms, {processor:.3f} ms of them on a processor of the host: ", end="")
        print(f"{rate:.1f} million {problem.unit}s a second")
    return 0


if __name__ == "__main__":
    sys.exit(main())
