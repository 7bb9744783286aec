"""What the two targets for profilers share: their options, ranges, timers, and where figures go."""

from __future__ import annotations

import argparse
import contextlib
import csv
import ctypes
import ctypes.util
import importlib.util
import json
import re
import resource
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import limits
import machine

from evqr_kernels import BackendUnavailable, get_backend

COPIED = 1 << 28
"""Bytes of the copy that a GPU's memory is measured by."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what both targets take."""
    parser.add_argument("--windows", default="8", help="in a batch; several with commas: 1,8,64,512")
    parser.add_argument("--backend", choices=("numpy", "warp", "taichi"), default="warp")
    parser.add_argument("--device", default="cpu", help="cpu, cuda:0, ...")
    parser.add_argument("--launches", type=int, default=20, help="that are measured, between start and stop")
    parser.add_argument("--warm-ups", type=int, default=3, help="before the profiler is started")
    parser.add_argument("--out", type=Path, help="folder for a JSON and a CSV file named after the device")


def require(backend: str, device: str) -> None:
    """End with a line unless the backend has the device."""
    try:
        devices = get_backend(backend).devices()
    except BackendUnavailable as error:
        sys.exit(str(error))
    if device not in devices:
        sys.exit(f"--device must be one of {', '.join(devices)} for {backend} on this machine, got {device}")


def batches(windows: str) -> list[int]:
    """Give the numbers of windows that the option lists, or end with a line."""
    if not re.fullmatch(r"[1-9]\d*(,[1-9]\d*)*", windows):
        sys.exit(f"--windows must be whole numbers with commas, as in 1,8,64, got {windows}")
    return [int(count) for count in windows.split(",")]


@contextlib.contextmanager
def range_of(name: str) -> Iterator[None]:
    """Name a part for NVIDIA's profilers, where the package `nvtx` is installed."""
    if importlib.util.find_spec("nvtx") is None:
        yield
        return
    import nvtx  # pyright: ignore[reportMissingImports]

    with nvtx.annotate(name, domain="evqr"):
        yield


@contextlib.contextmanager
def profiled(device: str) -> Iterator[None]:
    """Start and stop CUDA's profiler, for ``nsys --capture-range=cudaProfilerApi``."""
    found = ctypes.util.find_library("cudart") if device.startswith("cuda") else None
    runtime = ctypes.CDLL(found) if found else None
    if runtime:
        runtime.cudaProfilerStart()
    try:
        yield
    finally:
        if runtime:
            runtime.cudaProfilerStop()


def seconds(run: Callable[[], object], wait: Callable[[], None], device: str, backend: str) -> float:
    """Time a call: on a GPU under Warp between two events of the device, elsewhere by the clock."""
    if backend == "warp" and device.startswith("cuda"):
        import warp as wp

        with wp.ScopedDevice(device):
            events: list[Any] = [wp.Event(enable_timing=True) for _ in range(2)]
            wp.record_event(events[0])
            run()
            wp.record_event(events[1])
            return 1e-3 * wp.get_event_elapsed_time(*events)
    wait()
    begin = time.perf_counter()
    run()
    wait()
    return time.perf_counter() - begin


def copy_rate(moved: int, device: str) -> float:
    """Give the bytes a second that a plain copy moves on a device."""
    if not device.startswith("cuda"):
        return limits.copy_rate(min(1 << max(moved, 1).bit_length(), limits.LARGE))
    import warp as wp

    one, other = (wp.zeros(COPIED // 4, dtype=wp.float32, device=device) for _ in range(2))
    copies = [seconds(lambda: wp.copy(one, other), lambda: None, device, "warp") for _ in range(5)]
    return 2 * COPIED / statistics.median(copies)


def used_bytes(device: str) -> int:
    """Give the memory that is in use: on a GPU of Warp's pool, elsewhere the process's largest so far."""
    if device.startswith("cuda"):
        import warp as wp

        return int(wp.get_mempool_used_mem_current(device))
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def write(name: str, device: str, rows: Sequence[dict[str, Any]], folder: Path | None) -> None:
    """Write rows of figures to a JSON and a CSV file named after the device."""
    if folder is None:
        return
    about = machine.describe(device)
    called = about["processor"]
    if device.startswith("cuda"):
        import warp as wp

        called = wp.get_device(device).name
    stem = f"{name}-{re.sub('[^A-Za-z0-9]+', '-', called).strip('-')}"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{stem}.json").write_text(json.dumps({"machine": about, "rows": rows}, indent=1) + "\n")
    with (folder / f"{stem}.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    print(f"{folder / stem}.json and .csv")
