"""Instructions of kernels' machine code, by the loops that they are in.

Compilers unroll loops: how often, the loads tell.  A loop whose source reads three elements a step and whose
machine code has twelve loads does four steps a turn.
"""

from __future__ import annotations

import json
import re
import subprocess
import tempfile
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

FUNCTION = re.compile(r"Function :? ?(?:\w+__locals__)?(\w+?)_cuda_kernel_forward")
INSTRUCTION = re.compile(r"^\s*/\*([0-9a-f]{4,})\*/\s+(.*?)\s*;")
BRANCH = re.compile(r"\bBRA\b.*?\b0x([0-9a-f]+)")
LOAD, ATOMIC = re.compile(r"\bLDG\b"), re.compile(r"\b(?:RED|REDG|ATOM|ATOMG)\b")
TRAP = re.compile(r"\bNOP\b")


@dataclass(frozen=True)
class Code:
    """Instructions of a kernel.

    Attributes
    ----------
    once        in no loop but the one over a thread's indices, which is run once
    around      in loops that have others in them
    inside      in the innermost loop that has most loads
    loads       of global memory in that one
    atomics     in all
    """

    once: int
    around: int
    inside: int
    loads: int
    atomics: int


def read_code(dump: str) -> dict[str, Code]:
    """Read what ``cuobjdump -sass`` prints.

    Parameters
    ----------
    dump : str
        Of any number of kernels.

    Returns
    -------
    code : dict of Code
        By the kernels' names.
    """
    listings: dict[str, list[tuple[int, str]]] = {}
    current: list[tuple[int, str]] = []
    for line in dump.splitlines():
        if name := FUNCTION.search(line):
            current = listings.setdefault(name[1], [])
        elif found := INSTRUCTION.match(line):
            current.append((int(found[1], 16), found[2]))
    return {name: _code(listing) for name, listing in listings.items()}


def _code(listing: list[tuple[int, str]]) -> Code:
    listing = [(at, text) for at, text in listing if not TRAP.search(text)]
    loops: dict[int, int] = {}  # where each begins, and the last of those that jump there
    for at, text in listing:
        target = BRANCH.search(text)
        if target and int(target[1], 16) < at:
            loops[int(target[1], 16)] = at
    ranges = sorted(loops.items())
    whole = max((end - begin for begin, end in ranges), default=0)
    inner = [
        (begin, end)
        for begin, end in ranges
        if not any(b >= begin and e <= end and (b, e) != (begin, end) for b, e in ranges)
    ]
    # Warp's own loop over the indices of a thread has nearly all of the kernel in it
    own = [(b, e) for b, e in ranges if e - b == whole and whole > 0.5 * (listing[-1][0] - listing[0][0])]
    if own and len(ranges) > 1:
        inner = [each for each in inner if each not in own]
    elif own:
        inner, ranges = [], []
    nested = [each for each in ranges if each not in own and each not in inner]

    def among(at: int, which: Iterable[tuple[int, int]]) -> bool:
        return any(begin <= at <= end for begin, end in which)

    def loads_of(loop: tuple[int, int]) -> int:
        return sum(bool(LOAD.search(text)) for at, text in listing if among(at, [loop]))

    step = max(inner, key=lambda loop: (loads_of(loop), loop[1] - loop[0]), default=None)
    return Code(
        once=sum(not among(at, [*inner, *nested]) for at, _ in listing),
        around=sum(among(at, nested) and not among(at, inner) for at, _ in listing),
        inside=sum(among(at, [step]) for at, _ in listing) if step else 0,
        loads=loads_of(step) if step else 0,
        atomics=sum(bool(ATOMIC.search(text)) for _, text in listing),
    )


def compile_kernels(kernels: Iterable[Any], archs: list[int]) -> dict[str, Code]:
    """Compile kernels of Warp for NVIDIA GPUs, without one.

    Parameters
    ----------
    kernels : iterable of warp.Kernel
        Those whose modules are compiled.
    archs : list of int
        90 for sm_90.

    Returns
    -------
    code : dict of Code
        By "module kernel sm_90".
    """
    import portability

    read: dict[str, Code] = {}
    with tempfile.TemporaryDirectory() as folder:
        for module in {kernel.module for kernel in kernels}:
            for arch, cubin in portability.compiled(module, archs, Path(folder)).items():
                command = [portability.cuobjdump(), "-sass", str(cubin)]
                dump = subprocess.run(command, capture_output=True, text=True, check=True).stdout
                read.update(
                    {f"{module.name} {name} sm_{arch}": code for name, code in read_code(dump).items()}
                )
    return read


def key_of(kernel: Any, arch: int) -> str:
    """Name a kernel as `compile_kernels` does."""
    return f"{kernel.module.name} {kernel.func.__name__} sm_{arch}"


def save(path: Path, code: dict[str, Code]) -> None:
    """Write what was read, so that it need not be compiled again."""
    path.write_text(json.dumps({name: asdict(each) for name, each in sorted(code.items())}, indent=1) + "\n")


def load(path: Path) -> dict[str, Code]:
    """Read what `save` wrote."""
    return {name: Code(**each) for name, each in json.loads(path.read_text()).items()}
