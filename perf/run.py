#!/usr/bin/env python3
"""Time operations, the pipeline, threads, and their rivals, side by side.

usage: run.py --op NAME ...|all [--backend warp] [--device cpu] [--dtype float32] [--case NAME ...]
       run.py --pipeline [--threads] [--recordings DIR | --case NAME ...] [--device cpu]
       [--rounds N] [--format human|csv|json] [--save] [--base FILE]
       run.py --pipeline --against REF [as above, without --threads]
       run.py --processes start|busy|jobs ... [--against REF] [--rounds N] [...]

--op        operations (perf/ops.py) beside the same in numba, torch, SciPy, OpenCV and event libraries
            (perf/peers.py), interleaved; an adjoint beside its operation.  Compilation, first launch and
            steady state apart; throughput, and the share reached of what copies and multiply-adds allow
            (perf/limits.py).  Cases: small, production; growth, the exponent of time over items; threads,
            one thread against two, and against Taichi on two; by default all but small.
            Required, Warp on one thread in float32: splat and render no slower than numba; adjoints at
            most 2.5 times their operation; the cost with its gradients 4 times as fast as torch; two
            threads 1.8 times one; Taichi within 1.5 times of Warp, both on two threads.
--pipeline  per window: cold, tracked, and the rivals (perf/pipeline.py), interleaved, on simulated scenes
            (perf/cases.py) or on recordings that carry their truth; ratios from pairs on the same window.
            Required: cold no slower than (a) integrate; tracked 4 times as fast as (a) and 20 times as
            (b) descent.
--against   cold and tracked windows of this tree and of another commit in pairs (perf/against.py), on scenes
            with and without a code; and that commit against itself, which shows the run's noise.  REF gets a
            work tree and an environment of its own, kept for the next time.  Required: on windows with a code
            REF's time at least 0.95 of this tree's, and everywhere REF's text or the right one; REF's time
            on a window with a code at least half of this tree's on one without, and twice of it on noise; a
            code in a ninth of a view of 1280 x 720 px takes this tree 1.3 times as long as in one of
            640 x 480, at most.
--processes whole processes of `evqr read` (perf/processes.py), of this tree and of REF: start, to the first
            record of the demo, and beyond imports and the load of the kernels; busy, with a neighbour that
            never rests on one of two cores; jobs, --jobs 2 on many recordings.  Required: 0.2 s beyond;
            1.3 times as long as without the neighbour; 1.7 times as fast as with --jobs 1.
--threads   windows a second with one and with two threads.  Required: 1.7 times as many.

No other time is printed unless what is timed agrees with the NumPy specification: an operation and its rivals
on a small problem, the pipeline on a known scene that must be read.  Ratios are medians of pairs, others over
ours: more than 1 is faster.  --base compares with a saved run.  Exit 1 when a requirement is missed.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is imported: one thread is timed
os.environ["RAYON_NUM_THREADS"] = "1"
os.environ["POLARS_MAX_THREADS"] = "1"

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import cases
import machine
import ops
import table
from table import Row
from tqdm import tqdm

if TYPE_CHECKING:
    from pipeline import Recording

OP_CASES = (*cases.SIZES, "growth", "threads")
AGAINST_CASES = (*cases.PIPELINE, *cases.WITHOUT_CODE, *cases.VIEWS)
AGAINST_ROUNDS = 5


def time_reader(arguments: argparse.Namespace, about: dict[str, str]) -> list[Row]:
    """Time the pipeline or threads, after the gate."""
    import reader_times

    first_ms = reader_times.check(arguments.device)
    compiled, cached = reader_times.load_seconds(arguments.device)
    about["load"] = f"{compiled:.1f} s with nothing compiled, {cached:.1f} s with all of it cached"
    about["first window"] = f"{first_ms:.0f} ms, cold, tables and buffers made in it"
    rows: list[Row] = []
    if arguments.pipeline:
        recordings = recordings_of(arguments, cases.PIPELINE)
        rows += reader_times.time_pipeline(recordings, arguments.device, arguments.rounds or 3)
    if arguments.threads:
        rows += reader_times.time_threads(arguments.device)
    return rows


def time_against(arguments: argparse.Namespace, about: dict[str, str]) -> list[Row]:
    """Time the pipeline against that of another commit."""
    import against

    recordings = recordings_of(arguments, AGAINST_CASES)
    facts, rows = against.time_against(
        arguments.against, recordings, arguments.device, arguments.rounds or AGAINST_ROUNDS
    )
    about |= facts
    return rows


def time_processes(arguments: argparse.Namespace, about: dict[str, str]) -> list[Row]:
    """Time whole processes."""
    import processes

    facts, rows = processes.time_processes(arguments.processes, arguments.against, arguments.rounds)
    about |= facts
    return rows


def recordings_of(arguments: argparse.Namespace, names: Iterable[str]) -> list[Recording]:
    """Give what the pipeline is timed on: recordings, the cases asked for, or all of them."""
    import reader_times

    if arguments.recordings:
        found = map(reader_times.recorded, sorted(arguments.recordings.glob("*.h5")))
        return [recording for recording in found if recording is not None]
    return [reader_times.simulated(name) for name in arguments.case or names]


def time_ops(arguments: argparse.Namespace, about: dict[str, str]) -> list[Row]:
    """Gate and time operations."""
    import limits
    import op_times

    names = list(ops.PROBLEMS) if "all" in arguments.op else arguments.op
    chosen = arguments.case or OP_CASES[1:]
    target = op_times.Target(arguments.backend, arguments.device, arguments.dtype)
    rounds = arguments.rounds or 11
    about["backend"] = f"{target.backend}, {target.dtype}"
    about["limits"] = (
        f"one thread copies {limits.copy_rate(limits.LARGE) / 1e9:.1f} GB/s (in no cache) and "
        f"does {limits.madd_rate(target.dtype) / 1e9:.1f} thousand million multiply-adds a second"
    )
    about["not there"] = op_times.skipped(names)
    rows: list[Row] = []
    for op in tqdm(names, disable=len(names) == 1):
        op_times.check(op, target)
        for case in chosen:
            if case in cases.SIZES:
                rows += op_times.time_op(op, case, target, rounds)
        if "growth" in chosen:
            rows += op_times.time_growth(op, target, max(3, rounds // 3))
        if (
            "threads" in chosen
            and op in cases.THREADED
            and (target.backend, target.device) == ("warp", "cpu")
        ):
            rows += op_times.time_threads(op, target, rounds)
    return sorted(rows, key=lambda r: ("op ms", "ratio", "growth", "threads").index(str(r["part"])))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--op", nargs="+", metavar="NAME", choices=("all", *ops.PROBLEMS))
    parser.add_argument("--pipeline", action="store_true")
    parser.add_argument("--threads", action="store_true")
    parser.add_argument("--processes", nargs="+", metavar="KIND", choices=("start", "busy", "jobs"))
    parser.add_argument("--against", metavar="REF", help="a commit to time the pipeline against, bab4626 say")
    parser.add_argument("--recordings", type=Path, metavar="DIR", help="of .h5 files with their truth")
    parser.add_argument("--case", nargs="+", metavar="NAME", choices=(*OP_CASES, *AGAINST_CASES))
    parser.add_argument(
        "--backend", choices=("numpy", "warp", "taichi"), default="warp", help="of operations"
    )
    parser.add_argument("--dtype", choices=("float32", "float64"), default="float32")
    parser.add_argument("--rounds", type=int)
    parser.add_argument("--format", choices=("human", "csv", "json"), default="human")
    parser.add_argument("--device", default="cpu")
    parser.add_argument(
        "--save",
        action="store_true",
        help="also as a file in perf/results/DEVICE, named after date, commit and case",
    )
    parser.add_argument("--base", type=Path, metavar="FILE", help="a saved run to compare with")
    arguments = parser.parse_args()
    of_reader = arguments.pipeline or arguments.threads
    if [bool(arguments.op), of_reader, bool(arguments.processes)].count(True) != 1:
        parser.error("name what to time: --op, or --pipeline, --threads or both, or --processes")
    if arguments.against and (arguments.op or arguments.threads):
        parser.error("--against is for --pipeline, without --threads, and for --processes")
    if arguments.case and arguments.processes:
        parser.error("--processes has no cases")
    allowed = OP_CASES if arguments.op else AGAINST_CASES if arguments.against else tuple(cases.PIPELINE)
    for case in set(arguments.case or ()) - set(allowed):
        parser.error(f"--case must be one of {', '.join(allowed)} here, got {case!r}")

    about = machine.describe(arguments.device)
    measure = time_ops if arguments.op else time_against if arguments.against else time_reader
    measure = time_processes if arguments.processes else measure
    rows = measure(arguments, about)
    if arguments.base:
        table.compare(rows, arguments.base)
    write = {"human": table.as_human, "csv": table.as_csv, "json": table.as_json}[arguments.format]
    print(write(about, rows), end="")
    if arguments.save:
        labels = ("operations", *(arguments.case or ())) if arguments.op else ()
        labels = ("against", arguments.against, *(arguments.case or ())) if arguments.against else labels
        table.save(arguments.device, about, rows, *labels)
    return 0 if all(map(table.met, rows)) else 1


if __name__ == "__main__":
    sys.exit(main())
