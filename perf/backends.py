#!/usr/bin/env python3
"""Read recordings with every backend; exit 1 when one reads another text than Warp does.

usage: backends.py RECORDING... [--backend NAME ...] [--device cpu] [--max-windows N]

The device is Taichi's alone: "vulkan", say; the others run on the CPU.  A time is that of one read, and
has no compilation in it.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is imported: backends are compared on the same cores

import argparse
import sys
import time
from pathlib import Path

import machine

import evqr


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING")
    parser.add_argument("--backend", action="append", help="default: taichi and numpy")
    parser.add_argument("--device", default="cpu", help="of Taichi")
    parser.add_argument(
        "--max-windows", type=int, help="of each recording; default: all that the reader takes"
    )
    arguments = parser.parse_args()

    for name, value in machine.describe(arguments.device).items():
        print(f"{name:12s} {value}")
    config = evqr.ReadConfig(max_windows=arguments.max_windows)
    backends = ["warp", *(arguments.backend or ("taichi", "numpy"))]
    devices = {name: arguments.device if name == "taichi" else "cpu" for name in backends}
    for name in backends:
        evqr.Solver(backend=name, device=devices[name])  # compiles

    differ = 0
    for path in arguments.recordings:
        found = {}
        for name in backends:
            begin = time.perf_counter()
            result = evqr.read_codes(path, config=config, backend=name, device=devices[name])
            seconds = time.perf_counter() - begin
            found[name] = sorted(reading.text for reading in result.readings)
            same = "" if found[name] == found["warp"] else "   DIFFERS"
            print(f"{path.stem:16s} {name:8s} {seconds:7.2f} s   {found[name]}{same}", flush=True)
        differ += any(texts != found["warp"] for texts in found.values())
    print(f"{len(arguments.recordings) - differ} of {len(arguments.recordings)} recordings read alike")
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main())
