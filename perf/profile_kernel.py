#!/usr/bin/env python3
"""Launch one operation many times on buffers of its own: something for a profiler to look at.

usage: profile_kernel.py OP [--windows 1,8,64,512] [--events 20000] [--side 256] [--dtype float32] [--graph]
                         [--backend warp] [--device cpu] [--launches 20] [--warm-ups 3] [--out FOLDER]

Launches of a backend's method, without checks, allocation or transfers in between; with ``--graph`` recorded
once and replayed, as the reader does.  For example

    nsys profile --capture-range=cudaProfilerApi python perf/profile_kernel.py splat_events --device cuda:0
    ncu --kernel-name regex:splat python perf/profile_kernel.py splat_events --device cuda:0
    perf record python perf/profile_kernel.py splat_events --launches 500

docs/how-to/profiling.md says what to look at.
"""

import argparse
import statistics
import sys
import time

import cases
import limits
import ops
import profilers
from problems import Prepared, Size

PLAIN = cases.SIZES["production"]


def measured(op: str, size: Size, options: argparse.Namespace) -> dict[str, object]:
    """Launch an operation on a batch; give figures."""
    problem = ops.build(op, size, options.dtype)
    prepared = Prepared(problem, options.backend, options.device)
    begin = time.perf_counter()
    prepared()
    prepared.wait()
    first = time.perf_counter() - begin
    if options.graph:
        prepared.record()
    for _ in range(options.warm_ups):
        prepared()
    prepared.wait()
    times, busy = [], []
    with profilers.profiled(options.device):
        for k in range(options.launches):
            began = time.process_time()
            with profilers.range_of(f"{op} {k}"):
                times.append(profilers.seconds(prepared, prepared.wait, options.device, options.backend))
            busy.append(time.process_time() - began)
    median = statistics.median(times)
    moved = problem.bytes / median
    row = {
        "op": op,
        "windows": size.batch,
        "events": size.events,
        "side": size.side,
        "dtype": options.dtype,
        "backend": options.backend,
        "device": options.device,
        "recorded": options.graph,
        "first_ms": round(1e3 * first, 3),
        "median_ms": round(1e3 * median, 4),
        "host_ms": round(1e3 * statistics.median(busy), 4),
        f"million_{problem.unit}s_a_second": round(problem.items / median / 1e6, 2),
        "megabytes": round(problem.bytes / 1e6, 3),
        "million_multiply_adds": round(problem.madds / 1e6, 3),
        "share_of_copy": round(moved / profilers.copy_rate(problem.bytes, options.device), 3),
        "memory_megabytes": round(profilers.used_bytes(options.device) / 1e6, 1),
    }
    if options.device == "cpu":
        rate = problem.madds / median / limits.madd_rate(options.dtype)
        row["share_of_multiply_adds"] = round(rate, 3)
    return row


def main() -> int:
    """Measure batches of the sizes that are asked for; a line each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("op", choices=tuple(ops.PROBLEMS))
    parser.add_argument("--events", type=int, default=PLAIN["events"], help="of a window")
    parser.add_argument("--side", type=int, default=PLAIN["side"], help="of the image [px]")
    parser.add_argument("--dtype", choices=("float32", "float64"), default="float32")
    parser.add_argument("--graph", action="store_true", help="record the launches, and replay them")
    profilers.add_options(parser)
    options = parser.parse_args()
    profilers.require(options.backend, options.device)
    rows = []
    for windows in profilers.batches(options.windows):
        size = Size(windows, options.events, options.side, PLAIN["modules"])
        rows.append(measured(options.op, size, options))
        print(", ".join(f"{name} {value}" for name, value in rows[-1].items()), flush=True)
    profilers.write(f"kernel-{options.op}", options.device, rows, options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
