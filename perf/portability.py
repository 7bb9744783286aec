#!/usr/bin/env python3
"""Compile every Warp kernel for every NVIDIA architecture, without a GPU, and check what each one needs.

usage: portability.py [--dtype float32 --dtype float64] [--arch 90 ...] [--module NAME ...] [--all]

Kernels are found in `evqr_kernels.warp_backend`: whatever a ``make_..`` function builds that says that it
returns a kernel, adjoints included.  Each is compiled ahead of time to machine code (CUBIN), whose registers,
stack, local memory accesses (spills among them: without any there is none) and atomic instructions cuobjdump
tells; of kernels with a block of threads a window also their shared memory and barriers.  Budgets,
architectures, the variants that are built and known exceptions are in portability.json.  An
exception states what is allowed instead and why: it guards against more of the same.

Prints a line a kernel and precision, the worst of all architectures (--all: a line each).  Exit 1 when a
kernel passes its budget, or needs no exception that it has.  Needs ``pip install "evqr[portability]"``.
"""

import argparse
import fnmatch
import importlib
import inspect
import itertools
import json
import pkgutil
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import warp as wp

import evqr_kernels.warp_backend as backend
from evqr_kernels import SplatConfig, get_backend

SETTINGS = Path(__file__).with_suffix(".json")
KERNEL = re.compile(r"Function :? ?(?:\w+__locals__)?(\w+?)_cuda_kernel_forward")
USAGE = re.compile(r"REG:(\d+) STACK:(\d+)(?: SHARED:(\d+))?")
LOCAL, ATOMIC = re.compile(r"\b(?:STL|LDL)\b"), re.compile(r"\b(?:RED|REDG|ATOM|ATOMG)\b")
BARRIER = re.compile(r"\bBAR\.SYNC")

MEASURES = ("registers", "stack", "local", "atomics", "shared", "barriers")

OF_KERNELS = ("atomics", "shared", "barriers")
"""What the kernels that portability.json names need more of than others, of which most need none."""


@dataclass
class Usage:
    """What one kernel needs on one architecture."""

    variant: str  # of the kernel's module: file and what it was built for
    kernel: str
    dtype: str
    arch: int
    registers: int = 0  # a thread
    stack: int = 0  # bytes a thread
    local: int = 0  # instructions that load from or store to the stack or spilled registers
    atomics: int = 0  # instructions, copies of unrolled loops included
    shared: int = 0  # bytes a block
    barriers: int = 0  # instructions, likewise


def factories() -> Iterator[tuple[str, Any]]:
    """Functions of the backend that build a kernel, with the name of their file."""
    for info in pkgutil.iter_modules(backend.__path__):
        module = importlib.import_module(f"{backend.__name__}.{info.name}")
        for name, make in inspect.getmembers(module, callable):
            built_here = name.startswith("make_") and make.__module__ == module.__name__
            if built_here and inspect.signature(make).return_annotation is wp.Kernel:
                yield info.name, make


def build(dtype: Any, variants: dict[str, Any], cpu_only: dict[str, str]) -> dict[wp.Module, str]:
    """Build all kernels of one precision; the modules that they are in, each with its file.

    ``variants``: values of parameters, each combined with each; under a file's name those that go together.
    """
    modules = {}
    for file, make in factories():
        names = list(inspect.signature(make).parameters)[1:]
        for together in variants.get(file, [{}]):
            given = {**variants, **{f"{file}.{name}": [value] for name, value in together.items()}}
            choices = [given.get(f"{file}.{name}", given.get(name)) for name in names]
            if None in choices:
                missing = names[choices.index(None)]
                sys.exit(f"{SETTINGS.name}: variants must give values for {file}.{missing}")
            for values in itertools.product(*choices):
                arguments = [SplatConfig(**value) if isinstance(value, dict) else value for value in values]
                kernel = make(dtype, *arguments)
                if kernel.func.__name__ not in cpu_only:
                    modules[kernel.module] = file
    return modules


def compiled(module: wp.Module, archs: list[int], folder: Path) -> dict[int, Path]:
    """Compile a module; the CUBIN of each architecture."""
    paths = wp.compile_aot_module(module, arch=archs, module_dir=folder, use_ptx=False, strip_hash=True)
    return dict(zip(archs, (Path(path) for path in paths), strict=True))


def cuobjdump() -> str:
    """Where the program is: on the path, or where NVIDIA's package puts it."""
    on_path = shutil.which("cuobjdump")
    if on_path:
        return on_path
    try:
        nvidia = importlib.import_module("nvidia")
        return str(next(path for root in nvidia.__path__ for path in Path(root).glob("*/bin/cuobjdump*")))
    except (ImportError, StopIteration):
        sys.exit('cuobjdump is not installed: pip install "evqr[portability]"')


def usages(cubin: Path, variant: str, dtype: str, arch: int) -> Iterator[Usage]:
    """Read what each kernel of a CUBIN needs."""

    def dump(option: str) -> str:
        command = [cuobjdump(), option, str(cubin)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    found: dict[str, Usage] = {}
    current = None
    for line in (dump("--dump-resource-usage") + dump("-sass")).splitlines():
        if name := KERNEL.search(line):
            current = found.setdefault(name[1], Usage(variant, name[1], dtype, arch))
        elif current and (numbers := USAGE.search(line)):
            current.registers, current.stack, current.shared = (
                int(number or 0) for number in numbers.groups()
            )
        elif current:
            current.local += bool(LOCAL.search(line))
            current.atomics += bool(ATOMIC.search(line))
            current.barriers += bool(BARRIER.search(line))
    if not found:
        sys.exit(f"cuobjdump tells of no kernel in {cubin.name}")
    yield from found.values()


def worst(rows: list[Usage]) -> list[Usage]:
    """Fold architectures: the most of each measure."""
    folded: dict[tuple[str, str, str], Usage] = {}
    for row in rows:
        most = folded.setdefault(
            (row.variant, row.kernel, row.dtype), Usage(row.variant, row.kernel, row.dtype, row.arch)
        )
        for measure in MEASURES:
            if getattr(row, measure) > getattr(most, measure):
                setattr(most, measure, getattr(row, measure))
    return list(folded.values())


def limits(row: Usage, settings: dict[str, Any]) -> dict[str, int]:
    """Budget of a kernel: of its precision, wider if it makes a matrix or accumulates, or its exception."""
    budget = dict(settings["budgets"][row.dtype])
    if row.kernel in settings["matrices"]["kernels"]:
        budget["registers"] = settings["matrices"][row.dtype]
    for measure in OF_KERNELS:
        budget[measure] = settings[measure][row.dtype].get(row.kernel, budget.get(measure, 0))
    exception = settings["exceptions"].get(exception_of(row, settings), {})
    return {**budget, **{name: exception[name] for name in budget if name in exception}}


def exception_of(row: Usage, settings: dict[str, Any]) -> str | None:
    """Name the exception that a kernel has: a pattern of "variant kernel dtype"."""
    name = f"{row.variant} {row.kernel} {row.dtype}"
    return next((pattern for pattern in settings["exceptions"] if fnmatch.fnmatch(name, pattern)), None)


def complaints(rows: list[Usage], settings: dict[str, Any]) -> list[str]:
    """Tell what passes a budget on some architecture, and which exceptions nothing needs."""
    found, seen, needed = [], set(), set()
    for row in rows:
        seen.add(exception_of(row, settings))
        plain = limits(row, {**settings, "exceptions": {}})
        for measure, limit in limits(row, settings).items():
            value = getattr(row, measure)
            if value > plain[measure]:
                needed.add(exception_of(row, settings))
            if value > limit:
                name = f"{row.variant} {row.kernel} {row.dtype} sm_{row.arch}"
                found.append(f"{name}: {value} {measure}, the budget is {limit}")
    unneeded = sorted(name for name in seen - needed if name is not None)
    return found + [f"{name}: the exception is not needed any more" for name in unneeded]


def table(rows: list[Usage], settings: dict[str, Any], *, with_arch: bool) -> str:
    """Lines to print."""
    lines = [
        f"{'variant':26} {'kernel':28} {'dtype':8} {'arch':>5} "
        f"{'regs':>5} {'stack':>6} {'local':>6} {'atomics':>8} {'shared':>7} {'barriers':>9}"
    ]
    for row in sorted(rows, key=lambda row: (row.dtype, row.variant, row.kernel, row.arch)):
        arch = row.arch if with_arch else "all"
        exception = "  exception" if exception_of(row, settings) else ""
        lines.append(
            f"{row.variant:26} {row.kernel:28} {row.dtype:8} {arch:>5} {row.registers:5} {row.stack:6} "
            f"{row.local:6} {row.atomics:8} {row.shared:7} {row.barriers:9}{exception}"
        )
    return "\n".join(lines)


def main() -> int:
    """Compile, print, judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--dtype", action="append", choices=("float32", "float64"))
    parser.add_argument("--arch", action="append", type=int, help="90 for sm_90; default: portability.json")
    parser.add_argument("--module", action="append", help="files of the backend; default: all")
    parser.add_argument("--all", action="store_true", help="a line for each architecture")
    arguments = parser.parse_args()
    settings = json.loads(SETTINGS.read_text())
    wp.config.log_level = wp.LOG_ERROR
    get_backend("warp")

    begin, rows = time.perf_counter(), []
    with tempfile.TemporaryDirectory() as folder:
        for dtype in arguments.dtype or settings["architectures"]:
            archs = arguments.arch or settings["architectures"][dtype]
            modules = build(getattr(wp, dtype), settings["variants"], settings["cpu_only"])
            for module, file in modules.items():
                if arguments.module and file not in arguments.module:
                    continue
                variant = module.name.removeprefix("evqr_kernels_").removesuffix(f"_{dtype}")
                for arch, cubin in compiled(module, archs, Path(folder)).items():
                    rows += usages(cubin, variant, dtype, arch)
    rows = [row for row in rows if row.kernel not in settings["cpu_only"]]
    print(table(rows if arguments.all else worst(rows), settings, with_arch=arguments.all))
    for name, reason in settings["cpu_only"].items():
        print(f"not for GPUs: {name}: {reason}")
    for name, exception in settings["exceptions"].items():
        print(f"exception: {name}: {exception['reason']}")
    wrong = complaints(rows, settings)
    if not (arguments.module or arguments.dtype):
        met = {exception_of(row, settings) for row in rows}
        wrong += [f"{name}: no kernel has this name" for name in settings["exceptions"] if name not in met]
    kernels = len({(row.variant, row.kernel, row.dtype) for row in rows})
    archs = ", ".join(f"sm_{arch}" for arch in sorted({row.arch for row in rows}))
    print(f"{kernels} kernels for {archs} in {time.perf_counter() - begin:.0f} s")
    for complaint in wrong:
        print(f"OVER BUDGET: {complaint}" if "budget is" in complaint else f"STALE: {complaint}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
