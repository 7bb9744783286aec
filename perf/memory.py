#!/usr/bin/env python3
"""Read a recording of 1 GB with `evqr read` and print the peak memory of the process; exit 1 above 1 GiB.

usage: memory.py [--gigabytes 1] [--max-windows N] [--limit-mib 1024]

The recording is HDF5, made of simulated passes of a code, one after the other.  Three processes of their
own: the command on one pass, for what it takes at least; streaming the whole file alone; the command on the
whole file.  With --max-windows the command stops early, and the output says so.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from multiprocessing import get_context
from pathlib import Path

BYTES_AN_EVENT = 8 + 2 + 2 + 1
PAUSE_US = 5000
STREAM = (
    "import sys; from evqr import open_recording\n"
    "with open_recording(sys.argv[1]) as recording: print(sum(map(len, recording.chunks())), 'events')"
)


def write_recordings(small: Path, large: Path, gigabytes: float) -> int:
    """Write one pass of a code, and as many as fill a size, uncompressed; return how many those are."""
    # Here, and in a process of its own: a process starts with the peak memory of the one that started it.
    import h5py
    import numpy as np

    from evqr.simulate import simulate

    one = simulate("A GIGABYTE", version=2, speed_px_ms=2.0, preset="slow", seed=1).events
    length = int(one.t[-1]) + PAUSE_US
    columns = {"t": one.t, "x": one.x, "y": one.y, "p": (one.p > 0).astype(np.int8)}
    passes = max(1, round(gigabytes * 1e9 / (len(one) * BYTES_AN_EVENT)))
    for path, count in ((small, 1), (large, passes)):
        with h5py.File(path, "w") as file:
            file.attrs["width"], file.attrs["height"] = one.width, one.height
            for name, values in columns.items():
                data = file.create_dataset(
                    f"events/{name}", count * len(values), values.dtype, chunks=(1 << 16,)
                )
                for k in range(count):
                    offset = k * length if name == "t" else 0
                    data[k * len(values) : (k + 1) * len(values)] = values + values.dtype.type(offset)
            file["events/t"].attrs["unit"] = "us"
    return passes


def run(command: list[str]) -> tuple[float, float, list[str]]:
    """Run a process and return its peak memory [MiB], its time [s] and its lines of output."""
    with tempfile.TemporaryFile("w+") as out:
        begin = time.perf_counter()
        process = subprocess.Popen(command, stdout=out)
        _, status, usage = os.wait4(process.pid, 0)  # of this child alone, unlike RUSAGE_CHILDREN
        seconds = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode not in (0, 1):
            sys.exit(f"{' '.join(command[:4])} ... failed with exit status {process.returncode}")
        out.seek(0)
        lines = out.read().splitlines()
    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return usage.ru_maxrss / unit, seconds, lines


def count_read(lines: list[str]) -> int:
    return sum(json.loads(line)["status"] == "read" for line in lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--gigabytes", type=float, default=1.0)
    parser.add_argument(
        "--max-windows", type=int, help="stop `evqr read` after so many windows; default: all"
    )
    parser.add_argument("--limit-mib", type=float, default=1024.0)
    arguments = parser.parse_args()

    read = [sys.executable, "-m", "evqr", "read", "--json"]
    peaks = []
    with tempfile.TemporaryDirectory() as folder:
        small, large = Path(folder) / "one.h5", Path(folder) / "many.h5"
        with get_context("spawn").Pool(1) as pool:
            passes = pool.apply(write_recordings, (small, large, arguments.gigabytes))
        print(f"{large.stat().st_size / 1e9:.2f} GB, {passes} passes of a code")
        stop = ["--max-windows", str(arguments.max_windows)] if arguments.max_windows else []
        whole = f"evqr read, first {arguments.max_windows} windows" if stop else "evqr read, whole file"
        for what, command in (
            ("evqr read, one pass", [*read, str(small)]),
            ("streaming alone", [sys.executable, "-c", STREAM, str(large)]),
            (whole, [*read, str(large), *stop]),
        ):
            peak, seconds, lines = run(command)
            peaks.append(peak)
            outcome = lines[0] if "--json" not in command else f"{count_read(lines)} readings"
            print(f"{what:32s} peak {peak:6.0f} MiB, {seconds:6.1f} s, {outcome}", flush=True)
    print(f"limit {arguments.limit_mib:.0f} MiB: {'ok' if max(peaks) <= arguments.limit_mib else 'MISSED'}")
    return 0 if max(peaks) <= arguments.limit_mib else 1


if __name__ == "__main__":
    sys.exit(main())
