"""Reading multiplies no matrices with BLAS and calls no LAPACK: its threads belong to whoever set them up.

OpenBLAS starts a thread a core, and they spin when another program has the core: a product of two small
matrices then takes a hundred times as long.  Read from the source, and shown on a recording.  The NumPy
backend of the kernels, their specification, is apart: nobody reads with it who cares for time.
"""

import ast
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from evqr.demo import demo_recording

ROOT = Path(__file__).parents[1]
NOT_READING = {"paper", "simulate"}
INTO_BLAS = {
    "dot", "vdot", "inner", "matmul", "matvec", "vecmat", "vecdot", "tensordot", "linalg", "correlate",
    "convolve", "polyfit", "cov", "corrcoef",
}  # fmt: skip
"""Names of NumPy's that lead there; ``np.einsum`` does only when it is told to optimize."""


def into_blas(source):
    """Lines of a source that lead to BLAS, or to LAPACK."""
    for node in ast.walk(ast.parse(source)):
        product = isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult)
        named = isinstance(node, ast.Attribute) and node.attr in INTO_BLAS
        imported = isinstance(node, ast.ImportFrom | ast.Import) and any(
            set(f"{getattr(node, 'module', '')}.{name.name}".split(".")) & INTO_BLAS
            for name in node.names
            if (getattr(node, "module", None) or name.name).split(".")[0] == "numpy"
        )
        optimized = isinstance(node, ast.keyword) and node.arg == "optimize"
        if product or named or imported or optimized:
            yield node.lineno if hasattr(node, "lineno") else node.value.lineno


@pytest.mark.parametrize(
    "line",
    ["c = a @ b", "a @= b", "np.linalg.inv(a)", "a.dot(b)", "from numpy.linalg import inv",
     "import numpy.linalg", "np.einsum('ij,jk', a, b, optimize=True)"],
)  # fmt: skip
def test_a_line_that_leads_to_blas_is_seen(line):
    assert list(into_blas(f"x = 1\n{line}")) == [2]


def test_no_line_of_what_reads_leads_to_blas():
    sources = [
        path
        for path in sorted((ROOT / "evqr").rglob("*.py"))
        if path.relative_to(ROOT / "evqr").parts[0] not in NOT_READING
    ]
    assert len(sources) > 80
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in sources
        for line in into_blas(path.read_text(encoding="utf-8"))
    ]
    assert not found, f"multiply without BLAS, as evqr/geometry.py does: {', '.join(found)}"


TRAPS = r"""
import ctypes, faulthandler, mmap, re, sys
from pathlib import Path

import numpy as np
import numpy.linalg._umath_linalg

faulthandler.enable()
maps = Path("/proc/self/maps").read_text().split()
libraries = sorted({path for path in maps if "openblas" in path})
callers = sorted({path for path in maps if re.search(r"_multiarray_umath|_umath_linalg", path)})
called = re.compile(rb"scipy_[a-z0-9_]+?64_(?=\0)")
names = {name for path in callers for name in called.findall(Path(path).read_bytes())}
if not libraries or not names:
    sys.exit("no OpenBLAS of NumPy's own")
openblas, libc = ctypes.CDLL(libraries[0]), ctypes.CDLL(None)
for name in sorted(names):
    at = ctypes.cast(getattr(openblas, name.decode()), ctypes.c_void_p).value
    page = at - at % mmap.PAGESIZE
    everything = mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC
    if libc.mprotect(ctypes.c_void_p(page), ctypes.c_size_t(2 * mmap.PAGESIZE), everything):
        sys.exit("code cannot be written here")
    ctypes.memmove(at, b"\x0f\x0b", 2)  # an instruction that there is not
print(len(names), "traps", flush=True)
"""
"""Ends a process that enters a routine of BLAS or LAPACK that NumPy uses, and says where in Python it was."""

READ = """
import os
from pathlib import Path

def state():
    tasks = Path("/proc/self/task")
    return len(list(tasks.iterdir())), dict(os.environ)

before = state()
from evqr import open_recording, read_codes

with open_recording({path!r}) as recording:
    print([reading.text for reading in read_codes(recording).readings])
print("threads and environment as before:", state() == before)
"""


def trapped(what):
    """Run with traps in all routines of OpenBLAS."""
    if platform.machine() != "x86_64" or not sys.platform.startswith("linux"):
        pytest.skip("traps are made for Linux on x86-64")
    run = subprocess.run([sys.executable, "-c", TRAPS + what], capture_output=True, text=True)
    if run.returncode == 1 and ("OpenBLAS" in run.stderr or "written" in run.stderr):
        pytest.skip(run.stderr.strip())
    return run


@pytest.mark.parametrize(
    "product", ["np.eye(2) @ np.eye(2)", "np.ones(3) @ np.ones(3)", "np.linalg.inv(np.eye(2))"]
)
def test_a_process_with_traps_does_not_survive_a_product(product):
    run = trapped(product)
    assert " traps" in run.stdout
    assert run.returncode < 0 and "Illegal instruction" in run.stderr


def test_reading_enters_no_routine_of_blas_starts_no_thread_and_sets_no_variable():
    with demo_recording() as path:
        run = trapped(READ.format(path=str(path)))
    assert run.returncode == 0, run.stderr
    assert "Read in passing, 8 px/ms" in run.stdout
    assert "threads and environment as before: True" in run.stdout
