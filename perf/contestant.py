#!/usr/bin/env python3
"""One operation of one backend in a process of its own: for what is once a process.

usage: contestant.py BACKEND DEVICE OP DTYPE BATCH EVENTS SIDE MODULES

Prints the seconds of the first launch, compilation included; then, for each line on standard input, the
seconds of a launch.  Ends with its input.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path

import ops
import timing
from problems import Prepared, Size


class Contestant:
    """The process, seen from another: ``first`` is the time of its first launch [s]."""

    def __init__(
        self, backend: str, device: str, op: str, dtype: str, size: Size, environment: dict[str, str]
    ) -> None:
        command = [sys.executable, __file__, backend, device, op, dtype, *map(str, astuple(size))]
        self._process = subprocess.Popen(
            command,
            env={**os.environ, **environment},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self.first = self._answer()

    def _answer(self) -> float:
        assert self._process.stdout is not None
        for line in self._process.stdout:  # libraries greet on standard output
            if line.startswith("seconds "):
                return float(line.split()[1])
        raise RuntimeError(f"{' '.join(map(str, self._process.args[2:5]))} ended with {self._process.wait()}")

    def measure(self) -> float:
        """Let it measure; give seconds a launch."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return self._answer()

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


@contextlib.contextmanager
def contestant(
    backend: str, device: str, op: str, dtype: str, size: Size, **environment: str
) -> Iterator[Contestant]:
    """Start a process, and end it at the end."""
    process = Contestant(backend, device, op, dtype, size, environment)
    try:
        yield process
    finally:
        process.close()


def first_launches(backend: str, device: str, op: str, dtype: str, size: Size) -> tuple[float, float]:
    """Time the first launch in a process [s]: with nothing in the cache of kernels, and with this one."""
    with tempfile.TemporaryDirectory() as cache:
        caches = {"WARP_CACHE_PATH": cache, "TI_OFFLINE_CACHE_FILE_PATH": str(Path(cache, "taichi"))}
        cold, warm = (_first(backend, device, op, dtype, size, caches) for _ in range(2))
    return cold, warm


def _first(backend: str, device: str, op: str, dtype: str, size: Size, caches: dict[str, str]) -> float:
    with contestant(backend, device, op, dtype, size, **caches) as process:
        return process.first


def main() -> None:
    backend, device, op, dtype, *size = sys.argv[1:]
    prepared = Prepared(ops.build(op, Size(*map(int, size)), dtype), backend, device)
    prepared.wait()
    begin = time.perf_counter()
    prepared()
    prepared.wait()
    print(f"seconds {time.perf_counter() - begin}", flush=True)
    measure = None
    for _ in sys.stdin:
        if measure is None:
            prepared.record()
            measure = timing.measured(prepared, prepared.wait)
        print(f"seconds {measure()}", flush=True)


if __name__ == "__main__":
    main()
