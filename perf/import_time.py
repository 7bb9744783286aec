#!/usr/bin/env python3
"""Print what `import evqr` and `import evqr_kernels` cost beyond `import numpy`.

usage: import_time.py [--rounds 15] [--limit 0.2]

Each import is timed in a fresh interpreter, in turns with numpy so that a busy machine slows both alike;
the cost is the median of the paired differences.  Exit 1 when a cost passes the limit (seconds).
"""

import argparse
import statistics
import subprocess
import sys

PACKAGES = ("evqr", "evqr_kernels")
TIMER = "import time; t = time.perf_counter(); import {}; print(time.perf_counter() - t)"


def seconds(imports: str) -> float:
    command = [sys.executable, "-c", TIMER.format(imports)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--limit", type=float, default=0.2, help="seconds")
    arguments = parser.parse_args()

    for package in (
        "numpy",
        *PACKAGES,
    ):  # so that no round has to write byte code or find files on a cold disk
        seconds(package)
    costs: dict[str, list[float]] = {package: [] for package in PACKAGES}
    numpy_alone = []
    for _ in range(arguments.rounds):
        base = seconds("numpy")
        numpy_alone.append(base)
        for package in PACKAGES:
            costs[package].append(seconds(f"numpy, {package}") - base)

    print(f"import numpy            {statistics.median(numpy_alone):7.3f} s  (median of {arguments.rounds})")
    too_slow = False
    for package, differences in costs.items():
        low, cost, high = statistics.quantiles(differences, n=4)
        too_slow |= cost > arguments.limit
        print(f"  + {package:18s}  {cost:+7.3f} s  (quartiles {low:+.3f} to {high:+.3f})")
    return 1 if too_slow else 0


if __name__ == "__main__":
    sys.exit(main())
