"""Kernels for callers without Python: machine code, and a header that says how each is launched.

usage: python -m evqr_kernels.export OUT --arch sm_90 [--arch sm_89 ...] [--ptx] [--op NAME ...]

Needs no GPU.  OUT gets a file a module and architecture, CUBIN or PTX, in float32, and ``evqr_kernels.h``:
the structures that kernels take, in plain C, and for every operation its launches in order, each with its
file, entry, axes of threads and arguments.  Scratch and results are the caller's to make, as
`evqr_kernels.operations` tells, and to clear where an operation adds.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import warp as wp

from evqr_kernels.backend import KernelBackend
from evqr_kernels.call import example
from evqr_kernels.operations import OPERATIONS
from evqr_kernels.registry import get_backend
from evqr_kernels.warp_backend.language import launches_of

FOR_EVERYONE = (
    "bin_events",
    "splat_events",
    "splat_events_adjoint",
    "deposit_events",
    "deposit_events_adjoint",
    "voxel_grid",
    "voxel_grid_adjoint",
    "time_surface",
    "event_histogram",
    "lag_operator",
)
"""What is exported unless others are named: from events to images."""

NUMBERS = {wp.float32: "float", wp.int32: "int32_t", int: "int32_t"}
ENTRY = "_cuda_kernel_forward"
"""How the entry of a kernel ends."""

THREADS = 256
"""Of a block, for which modules are compiled."""

HEAD = """\
/* Kernels of evqr_kernels for NVIDIA GPUs, written by `python -m evqr_kernels.export`.

   A launch: cuModuleLoad its file, cuModuleGetFunction its entry, cuLaunchKernel with blocks of
   EVQR_THREADS threads, as many as its bounds have, and pointers to the bounds and to each argument.
   Arrays named `pairs`, `rows` or `blocks` are views of the array before: each entry begins a run of two or
   more, and the last axis has so many entries less. */
#ifndef EVQR_KERNELS_H
#define EVQR_KERNELS_H
#include <stddef.h>
#include <stdint.h>

#define EVQR_THREADS {threads}
#define EVQR_DIMENSIONS {dimensions}

/* An array on the device; strides in bytes. */
typedef struct {{
    uint64_t data, gradient;
    int32_t shape[EVQR_DIMENSIONS], strides[EVQR_DIMENSIONS];
    uint16_t dimensions, flags;
}} evqr_array;

/* How many threads a launch has along its axes: their product is `size`; `step` is 1. */
{bounds}
typedef struct {{
    const char *operation, *file, *entry;
    int axes;               /* of its bounds: evqr_bounds_1 to evqr_bounds_4 */
    const char *arguments;  /* "kind name, ...", in order, behind the bounds */
}} evqr_launch;

static const evqr_launch EVQR_LAUNCHES[] = {{
"""


def bounds(axes: int) -> str:
    """Declare the bounds of launches with so many axes."""
    return f"typedef struct {{ uint32_t shape[{axes}]; size_t size, step; }} evqr_bounds_{axes};\n"


@contextlib.contextmanager
def as_on_a_gpu(architecture: int) -> Iterator[None]:
    """Let launchers take the CPU for a GPU, for as long as they launch nothing."""
    device: Any = wp.get_device("cpu")
    kind, plain, before = type(device), type(device).is_cpu, device.arch
    kind.is_cpu, device.arch = property(lambda _: False), architecture
    try:
        yield
    finally:
        kind.is_cpu, device.arch = plain, before


def kernels_of(backend: KernelBackend, op: str, architecture: int) -> list[wp.Kernel]:
    """List the kernels that an operation launches on a GPU, in order."""
    run = example(backend, "cpu", op, {})
    with as_on_a_gpu(architecture):
        return [kernel for kernel, _ in launches_of(run)]


def said(kind: Any) -> str:
    """Name the kind of an argument in C: an array, a number, or several of one."""
    if isinstance(kind, wp.array):
        return "evqr_array"
    if kind in NUMBERS:
        return NUMBERS[kind]
    return f"{NUMBERS[kind._wp_scalar_type_]}[{kind._length_}]"  # a vector


def compiled(module: wp.Module, architecture: int, out: Path, *, ptx: bool) -> tuple[str, list[str]]:
    """Compile a module; give its file in a folder, and its entries."""
    with tempfile.TemporaryDirectory() as folder:
        (path,) = wp.compile_aot_module(
            module, arch=architecture, module_dir=folder, use_ptx=ptx, strip_hash=True
        )
        path = Path(shutil.copy(path, out / Path(path).name.removeprefix("wp_")))
    names = re.findall(rf"[A-Za-z_]\w*{ENTRY}".encode(), path.read_bytes())
    return path.name, sorted({name.decode() for name in names})


def export(out: Path, architectures: Sequence[int], ops: Sequence[str], *, ptx: bool) -> int:
    """Write the files; give how many launches the header has.

    Parameters
    ----------
    out : Path
        Folder; made if it is not there.
    architectures : sequence of int
        90 for sm_90.
    ops : sequence of str
        Names of operations.
    ptx : bool
        PTX, which drivers compile, rather than machine code.

    Returns
    -------
    launches : int
        One an architecture.
    """
    out.mkdir(parents=True, exist_ok=True)
    backend = get_backend("warp")
    dimensions = len(wp.array(shape=0, dtype=wp.float32, device="cpu").__ctype__().shape)
    lines = [
        HEAD.format(
            threads=THREADS,
            dimensions=dimensions,
            bounds="".join(bounds(axes) for axes in range(1, dimensions + 1)),
        )
    ]
    count = 0
    for architecture in architectures:
        # all before one is compiled: a module is compiled with the kernels that it has by then
        launches = [(op, kernel) for op in ops for kernel in kernels_of(backend, op, architecture)]
        modules = dict.fromkeys(kernel.module for _, kernel in launches)
        files = {module: compiled(module, architecture, out, ptx=ptx) for module in modules}
        for op, kernel in launches:
            file, entries = files[kernel.module]
            entry = next(e for e in entries if e.endswith(f"__{kernel.key.split('__')[-1]}{ENTRY}"))
            takes = ", ".join(f"{said(a.type)} {a.label}" for a in kernel.adj.args)
            axes = kernel.adj.kernel_dim
            lines.append(f'    {{"{op}", "{file}",\n     "{entry}",\n     {axes}, "{takes}"}},\n')
        count += len(launches)
    lines.append("};\n\n#endif\n")
    (out / "evqr_kernels.h").write_text("".join(lines))
    return count


def main(arguments: Sequence[str] | None = None) -> int:
    """Export what the command line names."""
    parser = argparse.ArgumentParser(
        prog="python -m evqr_kernels.export", description="Kernels without Python."
    )
    parser.add_argument("out", type=Path, metavar="OUT", help="folder")
    parser.add_argument("--arch", action="append", required=True, help="sm_90, say; may be given again")
    parser.add_argument(
        "--op", action="append", choices=sorted(OPERATIONS), help="by default, events to images"
    )
    parser.add_argument("--ptx", action="store_true", help="PTX rather than CUBIN")
    given = parser.parse_args(arguments)
    architectures = []
    for name in given.arch:
        digits = name.removeprefix("sm_")
        if not digits.isdigit():
            parser.error(f"--arch must be like sm_90, got {name}")
        architectures.append(int(digits))
    ops = given.op or FOR_EVERYONE
    count = export(given.out, architectures, ops, ptx=given.ptx)
    print(f"{count} launches of {len(ops)} operations for {', '.join(given.arch)} in {given.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
