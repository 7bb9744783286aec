#!/usr/bin/env python3
"""Read windows many times: something for a profiler to look at.

usage: profile_window.py [--ways cold,tracked] [--windows 1,8,64] [--backend warp] [--device cpu]
                         [--launches 20] [--warm-ups 3] [--out FOLDER]

The demo recording's window, so many times at once: cold with nothing known but its motion, tracked with the
code of the window before.  Times are those of a call of the solver, host included, without decoding.  For
example

    nsys profile --capture-range=cudaProfilerApi python perf/profile_window.py --device cuda:0 --windows 64
    py-spy record --native -- python perf/profile_window.py --launches 200

docs/how-to/profiling.md says what to look at.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import counting
import pipeline
import profilers

from evqr.events.batch import EventBatch
from evqr.fit.detection import NotFound
from evqr.solver import Solver

WAYS = ("cold", "tracked")


def calls(solver: Solver, windows: int) -> dict[str, Callable[[], list[Any]]]:
    """Make what reads so many windows at once, from cold and followed."""
    (job,) = pipeline.prepare(counting.demo(), solver)
    assert job.before is not None
    window, before = job.buffer.window(job.start_us, job.start_us + job.window_us), job.before
    batch = EventBatch.of([window] * windows)
    return {
        "cold": lambda: solver.find(batch, [before.motion] * windows),
        "tracked": lambda: solver.follow(batch, [before] * windows),
    }


def measured(way: str, windows: int, solver: Solver, options: argparse.Namespace) -> dict[str, object]:
    """Read a batch again and again; give figures."""
    run = calls(solver, windows)[way]
    begin = time.perf_counter()
    results = run()
    first = time.perf_counter() - begin
    for _ in range(options.warm_ups):
        run()
    times, busy = [], []
    with profilers.profiled(options.device):
        for k in range(options.launches):
            begin, began = time.perf_counter(), time.process_time()
            with profilers.range_of(f"{way} {k}"):
                run()
            times.append(time.perf_counter() - begin)
            busy.append(time.process_time() - began)
    median = statistics.median(times)
    return {
        "way": way,
        "windows": windows,
        "found": sum(not isinstance(result, NotFound) for result in results),
        "backend": options.backend,
        "device": options.device,
        "first_ms": round(1e3 * first, 1),
        "median_ms": round(1e3 * median, 3),
        "host_ms": round(1e3 * statistics.median(busy), 3),
        "windows_a_second": round(windows / median, 1),
        "memory_megabytes": round(profilers.used_bytes(options.device) / 1e6, 1),
    }


def main() -> int:
    """Measure batches of the sizes that are asked for; a line each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--ways", default="cold,tracked", help="some of cold and tracked, with a comma")
    profilers.add_options(parser)
    options = parser.parse_args()
    profilers.require(options.backend, options.device)
    ways = options.ways.split(",")
    if not set(ways) <= set(WAYS):
        sys.exit(f"--ways must be some of {', '.join(WAYS)}, got {options.ways}")
    solver = Solver(backend=options.backend, device=options.device)
    rows = []
    for way in ways:
        for windows in profilers.batches(options.windows):
            rows.append(measured(way, windows, solver, options))
            print(", ".join(f"{name} {value}" for name, value in rows[-1].items()), flush=True)
    profilers.write("window", options.device, rows, options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
